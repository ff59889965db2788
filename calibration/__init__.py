"""Estimate the errors of a robot's devices as calibrations, which robot_io applies."""
