"""Where the surface of an object was found."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Surface:
    """A surface along the press direction.

    Attributes:
        position_m: coordinate along the press direction, in the frame of the tip positions [m].
        std_err_m: its standard error [m]; NaN if there is none.
    """

    position_m: float
    std_err_m: float
