"""Drivers of the simulated robot; the robot file names them like any others."""
