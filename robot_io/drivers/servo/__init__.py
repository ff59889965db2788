"""Servos on a half-duplex serial line: code common to all makers."""
