"""Stands between the controller and the drives: limits, witnesses of what is wrong, and the safe stop."""

from robot_io.guard.guard import Guard, Trip
from robot_io.guard.limits import Limits, SafeState

__all__ = ["Guard", "Limits", "SafeState", "Trip"]
