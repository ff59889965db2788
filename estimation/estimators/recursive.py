"""Recursive least squares and related online estimators."""

import numpy as np

from palpate.estimation.assessment import assemble
from palpate.estimation.estimate import Estimate
from palpate.estimation.estimator import OnlineEstimator
from palpate.estimation.model import Regression
from palpate.estimation.statistics.noise import sum_covariance
from palpate.estimation.statistics.uncertainty import Covariance
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

INITIAL_VARIANCE = 1e8  # variance of a gain before the first sample; allows a stiffness of 10 000 N/m
_INITIAL_EFFORT = 1e3  # root mean square effort that any gain may contribute, if all samples are known
_NEGLIGIBLE = 1e-9  # relative influence of a sample on the gains below which earlier samples are ignored


class RecursiveEstimator(OnlineEstimator):
    """Kalman-like update of the gains; a subclass may change the covariance after each sample.

    With row h, effort y, gains g, and covariance P (in units in which the noise has variance 1):

        error = y - h g;  K = P h / (forgetting + h P h);  g += K error;  P = next(P - K h P)

    Args:
        variance: initial variance of each gain relative to the noise variance. `fit` knows all samples, and
            starts with a larger variance for gains that have little effect on the effort.
    """

    forgetting = 1.0

    def __init__(self, variance: float = INITIAL_VARIANCE) -> None:
        if not variance > 0:
            raise InputError(f"{self.name}: variance {variance} must be positive")
        self.variance = variance
        self.start(0)

    def _next_covariance(self, updated: FloatArray, error: float) -> FloatArray:
        """Return the covariance (p, p) for the next sample, given the updated one and this sample's error."""
        return updated

    def start(self, gain_count: int) -> None:
        self._begin(np.full(gain_count, self.variance))

    def _begin(self, variance: FloatArray) -> None:
        self._gains = np.zeros(len(variance))
        self._kalman_gain = np.zeros(len(variance))
        self._initial_variance = variance
        self._covariance = np.diag(variance)

    def update(self, row: FloatArray, effort: float) -> FloatArray:
        spread = self._covariance.dot(row)
        error = effort - float(row.dot(self._gains))
        self._kalman_gain = spread / (self.forgetting + float(row.dot(spread)))
        self._gains = self._gains + self._kalman_gain * error
        updated = self._covariance - self._kalman_gain[:, None] * spread
        self._covariance = self._next_covariance(updated, error)
        return self._gains

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        """See `Estimator.fit`; the estimate is the gains after the last sample."""
        rows, efforts = regression.columns, regression.effort.tolist()
        count, gain_count = rows.shape
        column_rms = np.sqrt(np.mean(rows**2, axis=0))
        std = _INITIAL_EFFORT / np.where(column_rms > 0, column_rms, 1.0)
        self._begin(np.maximum(self.variance, std**2))
        kalman_gains = np.empty((count, gain_count))
        for index in range(count):
            gains = self.update(rows[index], efforts[index])
            kalman_gains[index] = self._kalman_gain
        residuals = regression.effort - regression.columns @ gains
        # Sensitivity (n, p) of the last gains to each sample's noise: each later sample t multiplies an error
        # of the gains by (I - K_t h_t).
        transition, sensitivities = np.eye(gain_count), np.zeros_like(kalman_gains)
        scale = np.abs(kalman_gains[-1]).max()
        for index in range(count - 1, -1, -1):
            sensitivity = transition @ kalman_gains[index]
            sensitivities[index] = sensitivity
            transition = transition - sensitivity[:, None] * rows[index]
            if np.abs(sensitivity).max() < _NEGLIGIBLE * scale and np.abs(transition).max() < _NEGLIGIBLE:
                break
        summed = sum_covariance(sensitivities * residuals[:, None], regression.run)
        covariance = Covariance(summed.matrix, max(1.0, summed.effective_count - gain_count))
        return assemble(self.name, regression, gains, covariance)


class Rls(RecursiveEstimator):
    """Recursive least squares; all samples keep the same weight.

    Source: L. Ljung, T. Söderström, Theory and Practice of Recursive Identification (1983), sec. 2.2.
    """

    name = "rls"


class Ewrls(RecursiveEstimator):
    """Exponentially weighted recursive least squares: a sample t steps ago has weight forgetting^t.

    Without excitation the covariance would grow without limit, so that noise would change the gains strongly.
    It therefore stops growing at its initial size.

    Source: A. Haddadi, K. Hashtrudi-Zaad, Real-Time Identification of Hunt-Crossley Models, IEEE T-RO 28
    (2012).

    Args:
        forgetting: factor on the weight of past samples per step, in (0, 1]; 0.999 at 1 kHz is a memory of
            about 1 s.
        variance: variance of each gain at the start.
    """

    name = "ewrls"

    def __init__(self, forgetting: float = 0.999, variance: float = INITIAL_VARIANCE) -> None:
        if not 0.0 < forgetting <= 1.0:
            raise InputError(f"ewrls: forgetting {forgetting} must be above 0 and at most 1")
        super().__init__(variance)
        self.forgetting = forgetting

    def _next_covariance(self, updated: FloatArray, error: float) -> FloatArray:
        grown: FloatArray = updated / self.forgetting
        return grown if np.all(np.diag(grown) <= self._initial_variance) else updated


class Sprls(RecursiveEstimator):
    """Self-perturbing recursive least squares: beta * nint(gamma * error^2) * I is added to the covariance.

    nint is the nearest integer, so the term is zero for small errors and acts on large errors (gamma *
    error^2 >= 1/2): it reactivates the filter after a change. The paper states that the term acts when the
    error gets too small. This contradicts the formula that it cites; this class follows the formula. With
    beta = 0 the method is RLS.

    Source: D. J. Park, B. E. Jun, Self-Perturbing Recursive Least Squares Algorithm with Fast Tracking
    Capability, Electronics Letters 28 (1992); beta and gamma of the paper, sec. VI-C.

    Args:
        beta: design constant, at least 0; 20 in the paper.
        gamma: sensitivity gain, at least 0, per squared effort; 1 in the paper.
        variance: variance of each gain at the start.
    """

    name = "sprls"

    def __init__(self, beta: float = 20.0, gamma: float = 1.0, variance: float = INITIAL_VARIANCE) -> None:
        if beta < 0 or gamma < 0:
            raise InputError(f"sprls: beta {beta} and gamma {gamma} must not be negative")
        super().__init__(variance)
        self.beta = beta
        self.gamma = gamma

    def _next_covariance(self, updated: FloatArray, error: float) -> FloatArray:
        perturbation = self.beta * round(self.gamma * error * error)
        return updated + perturbation * np.eye(len(updated)) if perturbation else updated


_SLACK = 1.0  # allowance of CUSUM per sample [standard deviations]
_FORGETTING = 0.998  # forgetting factor of noise and column norms, per sample
_WARM_UP = 20  # samples after a start that are not tested
_CLIP_SIGMAS = 4.0  # standard deviations at which an error is clipped
_ROUNDING2 = 1e-18  # rounding relative to the squared effort


class _Noise:
    """Noise model variance = floor + share * effort^2, from exponentially weighted squared errors."""

    def __init__(self) -> None:
        self._count = self._square = self._fourth = self._errors = self._products = 0.0
        self._floor = self._share = 0.0

    def variance(self, effort: float) -> float:
        """Return the variance of the noise at a predicted effort [effort^2], at least that of rounding.

        Args:
            effort: predicted effort.
        """
        return self._floor + self._share * effort * effort + _ROUNDING2 * effort * effort

    @property
    def mean_variance(self) -> float:
        """Weighted mean variance of the samples so far."""
        return self._errors / self._count if self._count else 0.0

    def update(self, error: float, effort: float, *, clip: bool) -> None:
        """Update the noise model by one error.

        Args:
            error: measured minus predicted effort.
            effort: predicted effort.
            clip: whether the error may be an outlier and is limited to four standard deviations.
        """
        square, error2 = effort * effort, error * error
        if clip:
            error2 = min(error2, _CLIP_SIGMAS**2 * self.variance(effort))
        self._count = _FORGETTING * self._count + 1.0
        self._square = _FORGETTING * self._square + square
        self._fourth = _FORGETTING * self._fourth + square * square
        self._errors = _FORGETTING * self._errors + error2
        self._products = _FORGETTING * self._products + error2 * square
        # Least squares for share and floor, both nonnegative.
        determinant = self._count * self._fourth - self._square * self._square
        if determinant > 1e-6 * self._count * self._fourth:
            self._share = (self._count * self._products - self._square * self._errors) / determinant
        self._share = min(max(self._share, 0.0), self._errors / self._square if self._square else 0.0)
        self._floor = max((self._errors - self._share * self._square) / self._count, 0.0)


class CusumRls(Rls):
    """Recursive least squares that restarts when a CUSUM test detects a change.

    For every gain, Page's CUSUM adds up the normalized products of column and error minus an allowance, for
    both signs. Without a change the sums return to zero, and the estimate is recursive least squares with a
    variance in proportion to 1/n. After a change, one sum reaches its limit within a few samples and the
    covariance is reset. The noise is estimated online, with a part that grows with the effort.

    Source: E. S. Page, Continuous Inspection Schemes, Biometrika 41 (1954); F. Gustafsson, Adaptive Filtering
    and Change Detection (2000), ch. 5.

    Args:
        limit: limit of the sums, in standard deviations; a lower limit gives more false alarms, a higher one
            later alarms.
        variance: variance of each gain at the start.
    """

    name = "cusum_rls"

    def __init__(self, limit: float = 30.0, variance: float = INITIAL_VARIANCE) -> None:
        if not limit > 0.0:
            raise InputError(f"cusum_rls: limit {limit} must be positive")
        self.limit = limit
        super().__init__(variance)

    def _begin(self, variance: FloatArray) -> None:
        super()._begin(variance)
        self._size2 = [0.0] * len(variance)
        self._noise = _Noise()
        self.changes = 0  # number of changes detected since the start
        self._restart()

    def _restart(self) -> None:
        self._samples = 0
        self._up = [0.0] * len(self._size2)
        self._down = self._up.copy()

    def update(self, row: FloatArray, effort: float) -> FloatArray:
        error = effort - float(row.dot(self._gains))
        row_values = row.tolist()
        self._samples += 1
        weight = max(1.0 - _FORGETTING, 1.0 / self._samples)
        self._size2 = [
            size2 + weight * (column * column - size2)
            for size2, column in zip(self._size2, row_values, strict=True)
        ]
        if self._samples > _WARM_UP:
            noise_is_known = self._samples > 2 * _WARM_UP or self.changes > 0
            if noise_is_known:
                prediction_variance = self._noise.mean_variance * float(row.dot(self._covariance.dot(row)))
                variance = self._noise.variance(effort - error) + prediction_variance
                noise = max(variance, 0.0) ** 0.5  # rounding may make the variance negative
                standardized = min(max(error / noise, -_CLIP_SIGMAS), _CLIP_SIGMAS) if noise > 0.0 else 0.0
                for index, (column, size2) in enumerate(zip(row_values, self._size2, strict=True)):
                    increment = standardized * column / size2**0.5 if size2 > 0.0 else 0.0
                    self._up[index] = max(self._up[index] + increment - _SLACK, 0.0)
                    self._down[index] = max(self._down[index] - increment - _SLACK, 0.0)
                if max(*self._up, *self._down) > self.limit:
                    self._covariance = np.diag(self._initial_variance)
                    self.changes += 1
                    self._restart()
            self._noise.update(error, effort - error, clip=noise_is_known)
        return super().update(row, effort)
