"""Feetech STS servos: bus, protocol, tables and settings."""
