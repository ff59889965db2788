"""What threshold, subset and number of trials do to RANSAC (the paper's future work)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from estimation.accuracy.press import Noise, Press
from estimation.estimators.ransac import Ransac
from robot_io.errors import InputError


@dataclass(frozen=True)
class MapCell:
    """One setting of RANSAC and how it did.

    Attributes:
        threshold_n: largest residual of an inlier [N].
        subset: samples in a subset.
        trials: number of subsets.
        k_over_bound: root mean square error of the stiffness over the Cramer-Rao bound; NaN if it failed.
        c_over_bound: of the damping.
        failed: share of draws in which it found no consensus.
    """

    threshold_n: float
    subset: int
    trials: int
    k_over_bound: float
    c_over_bound: float
    failed: float


def ransac_map(
    press: Press,
    noise: Noise,
    *,
    thresholds_n: Sequence[float],
    subsets: Sequence[int],
    trials: Sequence[int],
    draws: int,
) -> list[MapCell]:
    """Every combination of settings, on the same `draws` draws of the noise (seeds 0, 1 ...)."""
    readings = [press.regression(press.read(noise, np.random.default_rng(seed))) for seed in range(draws)]
    bound, cells = press.bound(noise), []
    for threshold_n, subset, count in product(thresholds_n, subsets, trials):
        errors = []
        for seed, reading in enumerate(readings):
            try:
                found = Ransac(threshold_n, subset, count).fit(reading, rng=np.random.default_rng(seed))
            except InputError:
                continue
            errors.append([parameter.value for parameter in found.parameters] - press.truth)
        over = np.sqrt(np.mean(np.square(errors), axis=0)) / bound if errors else np.full(2, np.nan)
        failed = 1.0 - len(errors) / draws
        cells.append(MapCell(threshold_n, subset, count, float(over[0]), float(over[1]), failed))
    return cells
