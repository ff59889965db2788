"""What every estimator returns: never a bare number."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from palpate.robot_io.types import BoolArray, FloatArray


class Identifiability(StrEnum):
    """Whether the data determine all parameters; it says nothing of the model."""

    GOOD = "good"
    WEAK = "weak"  # some parameter is known only roughly; `note` says which and what to do
    NONE = "none"  # some parameter could be anything


class Determined(StrEnum):
    """Whether the data determine one parameter."""

    YES = "yes"
    ROUGHLY = "roughly"  # the standard error is more than a quarter of the value
    NO = "no"  # the 95 % interval contains zero, or there is none


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter's value with its uncertainty."""

    name: str  # such as "stiffness"
    unit: str  # SI
    value: float  # best estimate
    std_err: float  # standard error, NaN if the method has none
    interval: tuple[float, float]  # 95 % confidence interval (lower, upper)
    at_bound: bool = False  # whether an inner parameter ended at a bound of its search: the data say no value
    determined: Determined = Determined.YES  # by the data

    @property
    def half_interval(self) -> float:
        """Half the length of the 95 % interval; NaN if there is none."""
        return (self.interval[1] - self.interval[0]) / 2.0


@dataclass(frozen=True)
class Estimate:
    """The outcome of one estimation."""

    estimator: str  # its registered name
    parameters: tuple[ParameterEstimate, ...]  # in the order of the model
    inliers: BoolArray  # samples used in the final fit, shape (n,)
    residuals: FloatArray  # effort minus prediction, shape (n,)
    condition_number: float  # of the scaled columns
    identifiability: Identifiability  # see `Identifiability`
    note: str  # one sentence for the reader
    covariance: FloatArray  # of the parameters, shape (m, m); NaN where unknown
    # For recursive estimators, gains after each sample, shape (n, p); else None.
    history: FloatArray | None = None
    # Method-specific figures, such as trials or skipped subsets.
    details: dict[str, float] = field(default_factory=dict)
    unphysical: tuple[str, ...] = ()  # gains that lie outside what is physical with their whole intervals

    def __getitem__(self, name: str) -> ParameterEstimate:
        """The parameter called `name`. KeyError: there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def rmse(self) -> float:
        """Root mean square of the residuals over all samples."""
        return float(np.sqrt(np.mean(self.residuals**2)))
