"""Random sample consensus, over all samples or preemptive."""

import random
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy

from palpate.estimation.assessment import assemble
from palpate.estimation.estimate import Estimate
from palpate.estimation.estimator import Estimator
from palpate.estimation.estimators.recursive import INITIAL_VARIANCE, Rls
from palpate.estimation.fit.irls import Loss
from palpate.estimation.model import Regression
from palpate.estimation.statistics.least_squares import solve, solve_subsets
from palpate.estimation.statistics.noise import MAD_TO_SIGMA, robust_sigma
from palpate.estimation.statistics.uncertainty import Covariance, sandwich
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray

_MAX_RATIO = 100.0  # ratio of threshold to noise above which all samples are inliers
_MIN_RATIO = 0.45  # ratio of threshold to noise below which the refinement does not converge
_BLOCK = 1 << 16  # residuals held at once, so that they stay in the processor's cache
_INLIER_SIGMAS = 2.5  # inlier threshold in standard deviations of the noise
_PILOT_SAMPLES = 400  # samples on which the subsets' quantiles are compared
_QUANTILE = 0.4  # quantile of the absolute residuals: up to 60 % of the samples may be outliers
_ROUNDING = 1e-9  # share of the effort below which residuals are rounding errors


@dataclass
class Ransac(Estimator):
    """RANSAC: the largest set of samples that agree within a threshold, refined by least squares.

    The default threshold is 2.5 standard deviations of the noise, estimated first by the least quantile of
    the subsets' absolute residuals, then by the residuals within that threshold. The paper takes 0.01 N for
    any noise; if the noise is much larger, few samples are within the threshold and most of the information
    is lost.

    Source: M. A. Fischler, R. C. Bolles, Random Sample Consensus, Comm. ACM 24 (1981); settings of the paper,
    sec. VI-B; scale: P. J. Rousseeuw, A. M. Leroy, Robust Regression and Outlier Detection (1987), ch. 5;
    refinement: O. Chum, J. Matas, J. Kittler, Locally Optimized RANSAC (2003).
    """

    threshold: float | None = None  # largest residual of an inlier, in the effort's unit; None: see above
    subset: int = 5  # samples in a random subset
    trials: int = 1000  # number of subsets
    refinements: int = 100  # largest number of refits to newly selected inliers

    name = "ransac"
    loss = Loss.CAUCHY

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            InputError: a setting is outside its valid range.
        """
        if self.threshold is not None and not self.threshold > 0:
            raise InputError(f"ransac: threshold {self.threshold} must be positive")
        if self.trials < 1 or self.subset < 1 or self.refinements < 0:
            raise InputError(
                f"ransac: trials {self.trials} and subset {self.subset} must be at least 1, refinements "
                f"{self.refinements} at least 0"
            )

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        size = max(self.subset, regression.columns.shape[1])
        candidates = solve_subsets(regression.columns, regression.effort, size, self.trials, rng)
        threshold = self.threshold
        if threshold is None:  # in proportion to the noise
            columns, effort = regression.columns, regression.effort
            least = _ROUNDING * float(np.sqrt(np.mean(effort**2))) or 1.0
            rows = rng.permutation(len(effort))[:_PILOT_SAMPLES]
            quantiles = np.quantile(np.abs(candidates @ columns[rows].T - effort[rows]), _QUANTILE, axis=1)
            best = int(np.argmin(quantiles))
            sigma = float(quantiles[best] / scipy.special.ndtri((1.0 + _QUANTILE) / 2.0))
            gains, inliers = self._refine(regression, candidates[best], max(_INLIER_SIGMAS * sigma, least))
            residual = (effort - columns @ gains)[inliers]
            sigma = float(np.sqrt(np.sum(residual**2) / max(1, len(residual) - columns.shape[1])))
            threshold = max(_INLIER_SIGMAS * sigma, least)
        # Count the inliers of each candidate, shape (trials,).
        design = np.column_stack([regression.columns, regression.effort]).T.copy()
        signed = np.column_stack([candidates, -np.ones(len(candidates))])
        block = max(1, _BLOCK // design.shape[1])
        counts = np.empty(len(candidates), dtype=np.int64)
        for first in range(0, len(candidates), block):
            distance = signed[first : first + block] @ design
            np.abs(distance, out=distance)
            counts[first : first + block] = np.count_nonzero(distance < threshold, axis=1)
        gains, inliers = self._refine(regression, candidates[int(np.argmax(counts))], threshold)
        residuals = regression.effort - regression.columns @ gains
        best_subsets = candidates[counts >= counts.max() - np.sqrt(counts.max())]
        details = {
            "threshold": threshold,
            "trials": float(self.trials),
            "skipped_subsets": float(self.trials - len(candidates)),
            "inlier_share": float(np.mean(inliers)),
        }
        covariance = _covariance(regression, residuals, best_subsets - gains, threshold)
        return assemble(self.name, regression, gains, covariance, inliers=inliers, details=details)

    def _refine(
        self, regression: Regression, gains: FloatArray, threshold: float
    ) -> tuple[FloatArray, BoolArray]:
        """Fit the inliers and select them again until they no longer change."""
        inliers = _inliers(regression, gains, threshold)
        for _ in range(self.refinements + 1):
            if np.count_nonzero(inliers) <= regression.columns.shape[1]:
                raise InputError(
                    f"ransac: only {np.count_nonzero(inliers)} of {len(inliers)} samples agree within "
                    f"{threshold:g}; raise the threshold to about the noise, or use 'robust'"
                )
            fitted = regression.select(inliers)
            gains = solve(fitted.columns, fitted.effort)
            before, inliers = inliers, _inliers(regression, gains, threshold)
            if np.array_equal(before, inliers):
                break
        return gains, before


def _inliers(regression: Regression, gains: FloatArray, threshold: float) -> BoolArray:
    return np.abs(regression.effort - regression.columns @ gains) < threshold


def _covariance(
    regression: Regression, residuals: FloatArray, deviations: FloatArray, threshold: float
) -> Covariance:
    """Return the covariance of the refined fit, or the spread of the subsets that fit equally well.

    If the threshold is below the noise, the usual covariance of the fit to the inliers is many times too
    small, because a small change of the gains exchanges samples near the threshold. For Gaussian noise of
    standard deviation s, this reduces the slope of the score by 2 t phi(t), t = threshold / s. Far below the
    noise the refined fit is no better than its initial subset. The error is then the spread of `deviations`
    (m, p) of the subsets whose inlier counts are within one standard deviation of the best.
    """
    inside = np.abs(residuals) < threshold
    ratio = min(threshold / max(robust_sigma(residuals), np.finfo(float).tiny), _MAX_RATIO)
    slope = (
        scipy.special.ndtr(ratio)
        - scipy.special.ndtr(-ratio)
        - 2 * ratio * np.exp(-0.5 * ratio**2) / np.sqrt(2 * np.pi)
    )
    score = np.where(inside, residuals, 0.0)
    refined = sandwich(regression.columns, score, np.full(len(score), slope), regression.run)
    spread = Covariance(deviations.T @ deviations / max(1, len(deviations)), refined.degrees_of_freedom)
    has_enough = len(deviations) > deviations.shape[1] + 1
    is_smaller = np.all(spread.std_err < refined.std_err)
    return spread if ratio < _MIN_RATIO and has_enough and is_smaller else refined


_HYPOTHESES = 24
_INTERVAL = 6  # samples between two new hypotheses
_MEMORY = 150  # samples from which hypotheses are drawn
_STEP = 0.03  # step of a running median per sample
_LEAD = 0.4  # ratio of medians below which another hypothesis replaces the estimate
_PREEMPTIVE_CUT = 4.0  # standard deviations
_SEED = 1


class PreemptiveRansac(Rls):
    """Recursive least squares of the inliers, with a pool of hypotheses that can replace the estimate.

    Every few samples, a random minimal subset of recent samples gives a new hypothesis, which replaces the
    worst one of the pool. Each sample updates the running median of every hypothesis' errors. The recursive
    estimate is a member of the pool. Only its inliers update it, and it restarts at a hypothesis whose median
    is clearly smaller. Each sample takes the same time.

    Source: D. Nister, Preemptive RANSAC for Live Structure and Motion Estimation, ICCV 2003.

    Args:
        threshold: largest error of an inlier [effort]; None for four times the noise, estimated from the
            running median.
        variance: variance of each gain at the start.
    """

    name = "preemptive_ransac"

    def __init__(self, threshold: float | None = None, variance: float = INITIAL_VARIANCE) -> None:
        if threshold is not None and not threshold > 0.0:
            raise InputError(f"preemptive_ransac: threshold {threshold} must be positive")
        self.threshold = threshold
        super().__init__(variance)

    def _begin(self, variance: FloatArray) -> None:
        super()._begin(variance)
        count = len(variance)
        self._pool = np.zeros((_HYPOTHESES, count))  # the first is the recursive estimate
        self._medians = np.zeros(_HYPOTHESES)
        self._rows = np.zeros((_MEMORY, count))
        self._efforts = np.zeros(_MEMORY)
        self._samples = 0
        self._random = random.Random(_SEED)  # noqa: S311, no secret

    def update(self, row: FloatArray, effort: float) -> FloatArray:
        index = self._samples % _MEMORY
        self._rows[index], self._efforts[index] = row, effort
        self._samples += 1
        distance = np.abs(self._pool.dot(row) - effort)
        is_start = self._samples <= 2 * len(row)
        if is_start:
            self._medians = np.maximum(self._medians, abs(effort))
        else:
            self._medians *= np.where(distance > self._medians, 1.0 + _STEP, 1.0 - _STEP)
            if self._samples % _INTERVAL == 0:
                best_index = int(self._medians.argmin())
                if self._medians[best_index] < _LEAD * self._medians[0]:
                    self._gains = self._pool[best_index].copy()
                    self._pool[0], self._medians[0] = self._gains, self._medians[best_index]
                    self._covariance = np.diag(self._initial_variance)
                rows = self._random.sample(range(min(self._samples, _MEMORY)), len(self._gains))
                worst_index = 1 + int(self._medians[1:].argmax())
                with suppress(np.linalg.LinAlgError):  # samples that determine nothing
                    self._pool[worst_index] = np.linalg.solve(self._rows[rows], self._efforts[rows])
                    self._medians[worst_index] = 2.0 * self._medians[0]
        limit = self.threshold or _PREEMPTIVE_CUT * MAD_TO_SIGMA * float(self._medians[0])
        if is_start or float(distance[0]) <= limit:
            self._pool[0] = super().update(row, effort)
        else:
            self._kalman_gain = np.zeros(len(row))
        return self._gains
