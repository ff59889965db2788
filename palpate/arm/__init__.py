"""Arms: where they are found, emulated, probed, calibrated."""
