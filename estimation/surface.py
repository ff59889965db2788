"""Where the surface of an object was found."""

from dataclasses import dataclass

FEWEST_STEPS = 4.0  # of an encoder over which a press has a slope: half a step at either end is a quarter


@dataclass(frozen=True)
class Surface:
    """A surface along the press direction."""

    position_m: float  # coordinate along the press direction, in the frame of the tip positions [m]
    std_err_m: float  # its standard error [m]; NaN if there is none
    # The least coordinate at which the touch still allows it; -inf if nothing is known [m].
    highest_m: float = float("-inf")
    deepest_m: float = float("inf")  # the greatest; inf if nothing is known [m]
