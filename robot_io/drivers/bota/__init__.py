"""Bota Systems' force-torque sensors with a serial interface: protocol and sensor."""
