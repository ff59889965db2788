"""The guard between controller and drives: limits, plausibility checks, and the safe stop."""

from palpate.robot_io.guard.guard import Guard
from palpate.robot_io.guard.limits import Limits, SafeState

__all__ = ["Guard", "Limits", "SafeState"]
