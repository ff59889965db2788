"""Force sensors on a serial port: the port, and one file for each protocol."""
