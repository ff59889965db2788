"""Runs of an arm, real, emulated or simulated: how it is found, opened, probed and calibrated."""
