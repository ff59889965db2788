"""The error in one part of the data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """The error in one part of the data."""

    label: str  # such as "moving in" or "0.01 to 0.05 m/s"
    samples: int  # how many
    rmse: float  # root mean square of the residual
    mean: float  # mean of the residual; positive where the measurement is above the model
    energy: float  # share of the whole squared error
    excess: float  # rmse over the noise floor
