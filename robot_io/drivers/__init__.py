"""Drivers of real devices; a new one is one new file here."""
