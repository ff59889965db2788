"""RANSAC with the paper's settings, all subsets at once."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from estimation.estimate import Estimate
from estimation.estimator import Estimator
from estimation.fit.irls import Loss
from estimation.regression import Regression
from estimation.statistics.least_squares import solve
from estimation.statistics.noise_level import robust_sigma
from estimation.statistics.subsets import solve_subsets
from estimation.statistics.uncertainty import Covariance, sandwich
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray, IntArray

_FAR_ABOVE = 100.0  # times the noise: no sample is beyond
_FAR_BELOW = 0.45  # threshold over noise under which refining ends too far from where it converges
_BLOCK = 1 << 16  # residuals held at once: they stay in the processor's cache


@dataclass
class Ransac(Estimator):
    """The largest set of samples that agree within a threshold, and least squares on it.

    The paper takes a threshold of 0.01 (in the effort's unit) whatever the noise. Where the noise is much
    larger, few samples lie within it and most of the information is lost; `robust` finds its own scale.

    Source: M. A. Fischler, R. C. Bolles, Random Sample Consensus, Comm. ACM 24 (1981); settings of the paper,
    sec. VI-B; refinement: O. Chum, J. Matas, J. Kittler, Locally Optimized RANSAC (2003).
    """

    threshold: float = 0.01  # largest residual of an inlier, in the effort's unit
    subset: int = 5  # samples in a random subset
    trials: int = 1000  # number of subsets
    refinements: int = 100  # how often, at most, the inliers are chosen anew after the fit to them

    name = "ransac"
    loss = Loss.CAUCHY

    def __post_init__(self) -> None:
        """Check the settings. InputError: a setting makes no sense."""
        if not self.threshold > 0:
            raise InputError(f"ransac: threshold {self.threshold} must be positive")
        if self.trials < 1 or self.subset < 1 or self.refinements < 0:
            raise InputError(f"ransac: {self.trials} trials of {self.subset} samples make no sense")

    def fit(self, regression: Regression, *, rng: np.random.Generator) -> Estimate:
        size = max(self.subset, regression.columns.shape[1])
        subsets = solve_subsets(regression.columns, regression.effort, size, self.trials, rng)
        counts = self._inlier_counts(regression, subsets.gains)
        gains, inliers = self._refine(regression, subsets.gains[int(np.argmax(counts))])
        residuals = regression.effort - regression.columns @ gains
        rivals = subsets.gains[counts >= counts.max() - np.sqrt(counts.max())]
        details = {
            "trials": float(self.trials),
            "skipped_subsets": float(subsets.skipped),
            "inlier_share": float(np.mean(inliers)),
        }
        covariance = self._covariance(regression, residuals, rivals - gains)
        return self._estimate(regression, gains, covariance, inliers=inliers, details=details)

    def _inlier_counts(self, regression: Regression, gains: FloatArray) -> IntArray:
        """Number of inliers of each candidate, shape (trials,)."""
        design = np.column_stack([regression.columns, regression.effort]).T.copy()
        signed = np.column_stack([gains, -np.ones(len(gains))])
        block = max(1, _BLOCK // design.shape[1])
        counts = np.empty(len(gains), dtype=np.int64)
        for first in range(0, len(gains), block):
            distance = signed[first : first + block] @ design
            np.abs(distance, out=distance)
            counts[first : first + block] = np.count_nonzero(distance < self.threshold, axis=1)
        return counts

    def _refine(self, regression: Regression, gains: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Fit the inliers, choose them anew, and so on until they stay the same."""
        inliers = self._inliers(regression, gains)
        for _ in range(self.refinements + 1):
            if np.count_nonzero(inliers) <= regression.columns.shape[1]:
                raise InputError(
                    f"ransac: only {np.count_nonzero(inliers)} of {len(inliers)} samples agree within "
                    f"{self.threshold:g}; raise the threshold to about the noise, or take 'robust'"
                )
            fitted = regression.select(inliers)
            gains = solve(fitted.columns, fitted.effort).gains
            before, inliers = inliers, self._inliers(regression, gains)
            if np.array_equal(before, inliers):
                break
        return gains, before

    def _inliers(self, regression: Regression, gains: FloatArray) -> BoolArray:
        return np.abs(regression.effort - regression.columns @ gains) < self.threshold

    def _covariance(self, regression: Regression, residuals: FloatArray, rivals: FloatArray) -> Covariance:
        """That of the refined fit, or the spread of the subsets that did as well.

        The fit to the inliers alone would state errors many times too small wherever the threshold is below
        the noise, for the samples near the threshold count too: moving the gains a little swaps some of them
        for others. With Gaussian noise of standard deviation s that takes 2 t phi(t), t = threshold / s, off
        the slope of the score. Far below the noise the refined fit is no better than the subset that it began
        from, and `rivals` (m, p), the subsets whose inlier counts are within one standard deviation of the
        best, show how far that one may lie.
        """
        inside = np.abs(residuals) < self.threshold
        ratio = min(self.threshold / max(robust_sigma(residuals), np.finfo(float).tiny), _FAR_ABOVE)
        slope = ndtr(ratio) - ndtr(-ratio) - 2 * ratio * np.exp(-0.5 * ratio**2) / np.sqrt(2 * np.pi)
        score = np.where(inside, residuals, 0.0)
        refined = sandwich(regression.columns, score, np.full(len(score), slope), regression.run)
        spread = Covariance(rivals.T @ rivals / max(1, len(rivals)), refined.degrees_of_freedom)
        enough = len(rivals) > rivals.shape[1] + 1
        smaller = np.all(spread.std_err < refined.std_err)
        return spread if ratio < _FAR_BELOW and enough and smaller else refined
