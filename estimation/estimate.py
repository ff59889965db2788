"""What every estimator returns: never a bare number."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from robot_io.types import BoolArray, FloatArray


class Identifiability(StrEnum):
    """Whether the data determine the parameters."""

    GOOD = "good"
    WEAK = "weak"  # some parameter is known only roughly; `note` says which and what to do
    NONE = "none"  # some parameter could be anything


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter's value with its uncertainty.

    Attributes:
        name: such as "stiffness".
        unit: SI.
        value: best estimate.
        std_err: standard error, NaN if the method has none.
        interval: 95 % confidence interval (lower, upper).
        at_bound: whether an inner parameter ended at a bound of its search: the data say no value.
    """

    name: str
    unit: str
    value: float
    std_err: float
    interval: tuple[float, float]
    at_bound: bool = False


@dataclass(frozen=True)
class Estimate:
    """The outcome of one estimation.

    Attributes:
        estimator: its registered name.
        parameters: in the order of the model.
        inliers: samples used in the final fit, shape (n,).
        residuals: effort minus prediction, shape (n,).
        condition_number: of the scaled columns.
        identifiability: see `Identifiability`.
        note: one sentence for the reader.
        covariance: of the parameters, shape (m, m); NaN where unknown.
        history: for recursive estimators, gains after each sample, shape (n, p); else None.
        details: method-specific figures, such as trials or skipped subsets.
        unphysical: gains that lie outside what is physical with their whole intervals.
    """

    estimator: str
    parameters: tuple[ParameterEstimate, ...]
    inliers: BoolArray
    residuals: FloatArray
    condition_number: float
    identifiability: Identifiability
    note: str
    covariance: FloatArray
    history: FloatArray | None = None
    details: dict[str, float] = field(default_factory=dict)
    unphysical: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> ParameterEstimate:
        """The parameter called `name`.

        Raises:
            KeyError: there is none.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def rmse(self) -> float:
        """Root mean square of the residuals over all samples."""
        return float(np.sqrt(np.mean(self.residuals**2)))
