"""Dynamixel servos of the X series: bus, protocol, tables and settings."""
