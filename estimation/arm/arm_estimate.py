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
        covariance: for noise that is correlated in time, shape (p, p); NaN where nothing is known.
        white: as if it were not, shape (p, p); the ratio says how many samples are independent.
        samples: rows that were fitted to.
    """

    covariance: FloatArray
    white: FloatArray
    samples: int

    def part(self, first: int, count: int) -> "Uncertainty":
        """Of `count` neighbouring parameters."""
        rows = slice(first, first + count)
        return Uncertainty(self.covariance[rows, rows], self.white[rows, rows], self.samples)

    def of(self, combinations: FloatArray) -> "Uncertainty":
        """Of linear combinations (m, p) of the parameters."""
        covariance, white = (
            combinations @ matrix @ combinations.T for matrix in (self.covariance, self.white)
        )
        return Uncertainty(covariance, white, self.samples)

    @property
    def std_err(self) -> FloatArray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))

    def intervals(self, values: FloatArray) -> FloatArray:
        """95 % intervals of these values (p,), shape (p, 2), by Student's t for as many samples as count."""
        freedom = self.samples * np.diag(self.white) / np.diag(self.covariance)
        quantile = stats.t.ppf(0.5 + CONFIDENCE / 2, np.clip(freedom, 1.0, self.samples))
        reach = quantile * self.std_err
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
        uncertainty = self.uncertainty.part(0, len(self.inertial)).of(self.base_parameters.grouping)
        errors, intervals = uncertainty.std_err, uncertainty.intervals(self.base)
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
        return self.uncertainty.part(first, len(values)).intervals(values)
