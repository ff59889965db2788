"""Hunt-Crossley in milliseconds, though a third of the samples may be wrong."""

import numpy as np

from estimation.contact_estimator import ContactEstimator, ContactLaw, check_samples
from estimation.fit.irls import IrlsResult, irls
from robot_io.errors import InputError
from robot_io.types import FloatArray

_EXPONENTS = np.array([0.7, 0.85, 1.0, 1.15, 1.3, 1.45, 1.6, 1.8, 2.0, 2.25, 2.5, 3.0])
_PAIRS = 60  # a start; none of them clean at 40 % outliers with probability 1e-12
_START_SAMPLES = 200
_FEWEST = 10  # samples


class RobustHuntCrossley(ContactEstimator):
    """MM estimate of ln k, b / k and n together, with weights that follow the noise.

    The start is the least median of squares over pairs of samples, each solved for k and b at a dozen
    exponents at once; a few biweight steps lead from there to the efficient estimate, see `m_steps`. It is
    what `robust` is for a linear model; the surface must be known.

    Source: V. J. Yohai, High Breakdown-Point and High Efficiency Robust Estimates for Regression, Ann. Stat.
    15 (1987).
    """

    name = "robust_hunt_crossley"

    def fit(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, *, rng: np.random.Generator
    ) -> ContactLaw:
        settled, unit_m = self.settle(depth_m, speed_m_s, force_n, rng)
        log_push, ratio, n = settled.values.tolist()
        k = float(np.exp(log_push)) / unit_m**n
        return ContactLaw(k, ratio * k, n, n)

    def settle(
        self, depth_m: FloatArray, speed_m_s: FloatArray, force_n: FloatArray, rng: np.random.Generator
    ) -> tuple[IrlsResult, float]:
        """The estimate of ln(k u^n), b / k and n with its residuals, and the unit of depth u [m]."""
        check_samples(self.name, depth_m, speed_m_s, force_n)
        touching = depth_m > 0.0
        if np.count_nonzero(touching) < _FEWEST:
            raise InputError(f"{self.name}: {np.count_nonzero(touching)} samples in contact are too few")
        speed, force = speed_m_s[touching], force_n[touching]
        unit_m = float(np.median(depth_m[touching]))
        log_depth = np.log(depth_m[touching] / unit_m)

        def evaluate(values: FloatArray) -> tuple[FloatArray, FloatArray]:
            spring = np.exp(values[0] + values[2] * log_depth)
            predicted = spring * (1.0 + values[1] * speed)
            return predicted, np.column_stack([predicted, spring * speed, predicted * log_depth])

        start = _least_median(log_depth, speed, force, rng)
        return irls(evaluate, force, start), unit_m


def _least_median(
    log_depth: FloatArray, speed: FloatArray, force: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Ln k, b / k and n of the pair and exponent that leave the smallest median of residuals, shape (3,)."""
    one, two = rng.integers(len(force), size=(2, _PAIRS))
    some = rng.permutation(len(force))[:_START_SAMPLES]
    springs = np.exp(_EXPONENTS[:, None] * log_depth)
    # At a given exponent F / d^n = k + b v: a line through two points.
    push = force / springs
    apart = speed[two] - speed[one]
    slopes = (push[:, two] - push[:, one]) / np.where(np.abs(apart) > 0.0, apart, np.inf)
    levels = push[:, one] - slopes * speed[one]
    left = np.abs(
        force[some] - springs[:, None, some] * (levels[..., None] + slopes[..., None] * speed[some])
    )
    middle = left.shape[-1] // 2
    medians = np.partition(left, middle, axis=-1)[..., middle]
    medians[levels <= 0.0] = np.inf
    if not np.isfinite(medians).any():
        raise InputError("robust_hunt_crossley: no two samples agree with a positive stiffness")
    at = np.unravel_index(int(np.argmin(medians)), medians.shape)
    return np.array([np.log(levels[at]), slopes[at] / levels[at], _EXPONENTS[at[0]]])
