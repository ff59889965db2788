"""What a motion says of an arm, and how certain it is."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from estimation.arm.base_parameters import BaseParameters
from estimation.arm.rows import ArmRows
from estimation.estimate import ParameterEstimate
from estimation.statistics.uncertainty import CONFIDENCE
from robot_io.types import FloatArray


@dataclass(frozen=True)
class Uncertainty:
    """Of all parameters (inertial, shared, each joint's own), p of them.

    Attributes:
        covariance: for noise that is correlated in time, shape (p, p).
        white: as if it were not, shape (p, p); the ratio says how many samples are independent.
        samples: rows that were fitted to.
    """

    covariance: FloatArray
    white: FloatArray
    samples: int

    def std_err(self, combination: FloatArray) -> FloatArray:
        """Standard errors of linear combinations (m, p), shape (m,)."""
        return np.sqrt(_variance(combination, self.covariance))

    def intervals(self, values: FloatArray, combination: FloatArray) -> FloatArray:
        """95 % intervals of linear combinations (m, p) of these values (m,), shape (m, 2)."""
        variance, white = (_variance(combination, matrix) for matrix in (self.covariance, self.white))
        freedom = np.clip(self.samples * white / variance, 1.0, self.samples)
        reach = stats.t.ppf(0.5 + CONFIDENCE / 2, freedom) * np.sqrt(variance)
        return np.column_stack([values - reach, values + reach])


@dataclass(frozen=True)
class ArmEstimate:
    """What a motion says of an arm.

    Attributes:
        inertial: phi, ten parameters a link, physically consistent, shape (10 joints,).
        base_parameters: which combinations of them show.
        shared: gains of the shared columns, shape (c,).
        own: gains of each joint's own columns, one array (k_j,) a joint.
        sigma: noise of each joint, shape (joints,) [N m].
        uncertainty: of (inertial, shared, own); what the data do not determine is as uncertain as the URDF.
        data_share: of each inertial parameter, how much of the URDF's variance the data took away, shape
            (10 joints,): 1 is determined, 0 is the URDF's value.
        determined: combinations of inertial parameters that the data know better than the URDF; at most b.
    """

    inertial: FloatArray
    base_parameters: BaseParameters
    shared: FloatArray
    own: tuple[FloatArray, ...]
    sigma: FloatArray
    uncertainty: Uncertainty
    data_share: FloatArray
    determined: int

    @property
    def base(self) -> FloatArray:
        """Base parameters, shape (b,)."""
        return np.asarray(self.base_parameters.grouping @ self.inertial)

    @property
    def base_estimates(self) -> tuple[ParameterEstimate, ...]:
        """The base parameters with their uncertainty."""
        combination = np.zeros((len(self.base), len(self.uncertainty.covariance)))
        combination[:, : len(self.inertial)] = self.base_parameters.grouping
        errors = self.uncertainty.std_err(combination)
        intervals = self.uncertainty.intervals(self.base, combination)
        names, units = self.base_parameters.names, self.base_parameters.units
        return tuple(
            ParameterEstimate(name, unit, float(value), float(error), (float(low), float(high)))
            for name, unit, value, error, (low, high) in zip(
                names, units, self.base, errors, intervals, strict=True
            )
        )

    @property
    def inertial_intervals(self) -> FloatArray:
        """95 % intervals of the inertial parameters, shape (10 joints, 2)."""
        return self._intervals(self.inertial, 0)

    @property
    def shared_intervals(self) -> FloatArray:
        """95 % intervals of the shared gains, shape (c, 2)."""
        return self._intervals(self.shared, len(self.inertial))

    @property
    def own_intervals(self) -> tuple[FloatArray, ...]:
        """95 % intervals of each joint's own gains, one array (k_j, 2) a joint."""
        starts = len(self.inertial) + len(self.shared) + np.cumsum([0, *map(len, self.own)])
        return tuple(
            self._intervals(own, int(first)) for own, first in zip(self.own, starts[:-1], strict=True)
        )

    def predict(self, rows: ArmRows) -> FloatArray:
        """Torques, shape (n, joints) [N m]."""
        own = np.column_stack([columns @ gains for columns, gains in zip(rows.own, self.own, strict=True)])
        return np.asarray(rows.regressor @ self.base + rows.shared @ self.shared + own)

    def _intervals(self, values: FloatArray, first: int) -> FloatArray:
        combination = np.eye(len(self.uncertainty.covariance))[first : first + len(values)]
        return self.uncertainty.intervals(values, combination)


def _variance(combination: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("mp,pq,mq->m", combination, covariance, combination))
