"""Motions that a controller follows."""
