"""Emulated devices for the drivers, written from the protocols' manuals."""
