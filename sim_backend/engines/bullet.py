"""The one place that imports PyBullet, which greets on stderr meanwhile."""

from robot_io.captured import STDERR, captured

with captured([], STDERR):
    import pybullet as bullet

__all__ = ["bullet"]
