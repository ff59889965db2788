"""The error in one part of the data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """The error in one part of the data.

    Attributes:
        label: such as "moving in" or "0.01 to 0.05 m/s".
        samples: how many.
        rmse: root mean square of the residual.
        mean: mean of the residual; positive where the measurement is above the model.
        excess: rmse over the noise floor.
    """

    label: str
    samples: int
    rmse: float
    mean: float
    excess: float
