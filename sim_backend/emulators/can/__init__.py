"""Emulated motors on a CAN bus."""
