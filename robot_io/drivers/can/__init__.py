"""CAN: the adapter, and what motors of every protocol share."""
