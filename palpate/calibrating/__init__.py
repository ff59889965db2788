"""Calibrations of an arm from the command line: its bench, the runs, and what comes of them."""
