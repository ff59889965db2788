"""Finds out how a robot's devices differ from what they say, and writes it down; robot_io applies it."""
