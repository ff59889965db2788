"""Emulated force sensors on a serial line."""
