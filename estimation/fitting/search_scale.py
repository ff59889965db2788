"""Inner parameters as a search sees them: of order one, by difference or by ratio, within bounds."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.effect import Parameter
from robot_io.types import BoolArray, FloatArray

_LEAST_RATIO = 1e-3  # of the typical range: how near to zero a search by ratio may come


@dataclass(frozen=True)
class SearchScale:
    """Maps named inner parameters to a vector and back.

    Attributes:
        parameters: by "effect.parameter".
    """

    parameters: Mapping[str, Parameter]

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Shape (q,), within the bounds."""
        raw = [_forth(p, _inside(p, values[name])) for name, p in self.parameters.items()]
        lower, upper = self.bounds
        return np.asarray(np.clip(np.array(raw), lower, upper))

    def values(self, vector: FloatArray) -> dict[str, float]:
        """Parameters by name."""
        return {
            name: _inside(p, _back(p, float(number)))
            for (name, p), number in zip(self.parameters.items(), vector, strict=True)
        }

    def rates(self, vector: FloatArray) -> FloatArray:
        """Change of each parameter with its search variable, shape (q,)."""
        rates = [_rate(p, float(number)) for p, number in zip(self.parameters.values(), vector, strict=True)]
        return np.array(rates)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the vector, each of shape (q,)."""
        lower = [_forth(p, _least(p)) for p in self.parameters.values()]
        upper = [_forth(p, p.upper) for p in self.parameters.values()]
        return np.array(lower), np.array(upper)

    def at_bound(self, vector: FloatArray) -> BoolArray:
        """Which parameters ended at a bound, shape (q,), boolean."""
        lower, upper = self.bounds
        near = 1e-6 * (upper - lower)
        ended: BoolArray = (vector <= lower + near) | (vector >= upper - near)
        return ended


def _least(parameter: Parameter) -> float:
    if not parameter.log:
        return parameter.lower
    return max(parameter.lower, _LEAST_RATIO * parameter.typical[0])


def _inside(parameter: Parameter, value: float) -> float:
    return float(np.clip(value, _least(parameter), parameter.upper))


def _forth(parameter: Parameter, value: float) -> float:
    low, high = parameter.typical
    if parameter.log:
        return float(np.log(value / low) / np.log(high / low))
    return (value - low) / (high - low)


def _back(parameter: Parameter, number: float) -> float:
    low, high = parameter.typical
    if parameter.log:
        return float(low * np.exp(number * np.log(high / low)))
    return low + number * (high - low)


def _rate(parameter: Parameter, number: float) -> float:
    low, high = parameter.typical
    return float(np.log(high / low)) * _back(parameter, number) if parameter.log else high - low
