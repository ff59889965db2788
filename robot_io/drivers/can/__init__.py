"""CAN: the adapter, and code that motors of every protocol share."""
