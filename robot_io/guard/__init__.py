"""The guard between controller and drives: limits, plausibility checks, and the safe stop."""

from robot_io.guard.guard import Guard
from robot_io.guard.limits import Limits, SafeState

__all__ = ["Guard", "Limits", "SafeState"]
