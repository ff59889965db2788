"""Servos on a half-duplex serial line: what is the same whoever made them."""
