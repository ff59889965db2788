"""What RANSAC's settings do: errors over the Cramer-Rao bound on the motion of a probing run."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimation.estimate_channel import fitting_rows
from estimation.estimators.ransac import Ransac
from estimation.regression import Regression
from estimation.statistics.uncertainty import cramer_rao
from palpate.runs.hidden_effects import SURFACE, truth_of
from palpate.sweep.case import Row
from palpate.sweep.works.probing import contact_channel, probed
from robot_io.errors import InputError
from robot_io.types import FloatArray


def ransac_errors(parameters: Mapping[str, Any], seed: int) -> list[Row]:
    """Root mean square errors of k and c over their bounds, from so many draws of the noise; one row.

    Motion and surface are known exactly, so that all that differs is the setting. `outliers_percent` of the
    samples are off by up to the largest force; the bound is that of the samples without them.
    """
    ticks, scenario = probed(parameters, seed)
    truth, channel = truth_of(scenario), contact_channel(ticks)
    rows = fitting_rows(channel)
    surface_m = channel.surface.position_m - truth[SURFACE] if channel.surface else 0.0
    columns = np.column_stack([channel.position[rows] + surface_m, channel.velocity[rows]])
    gains = np.array([truth["stiffness.k"], truth["damping.c"]])
    force_n = columns @ gains
    sigma_n = np.hypot(parameters["noise_std_n"], parameters["noise_percent"] / 100 * force_n)
    bound = cramer_rao(columns, sigma_n)
    ransac = Ransac(**parameters["settings"])
    errors: list[FloatArray] = []
    shares: list[float] = []
    for draw in range(parameters["draws"]):
        rng = np.random.default_rng([seed, draw])
        noisy_n = force_n + sigma_n * rng.standard_normal(len(force_n))
        wrong = rng.random(len(force_n)) < parameters["outliers_percent"] / 100
        noisy_n[wrong] += rng.uniform(-1, 1, np.count_nonzero(wrong)) * force_n.max()
        problem = Regression(columns, noisy_n, ("k", "c"), ("N/m", "N s/m"), run=channel.run[rows])
        try:
            found = ransac.fit(problem, rng=rng)
        except InputError:  # hardly a sample agrees with another
            errors.append(gains)
            shares.append(0.0)
            continue
        errors.append(np.array([found["k"].value, found["c"].value]) - gains)
        shares.append(float(np.mean(found.inliers)))
    k, c = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    conditions = {key: parameters[key] for key in ("noise_percent", "outliers_percent")}
    result = {"k_over_bound": float(k), "c_over_bound": float(c), "inlier_share": float(np.mean(shares))}
    return [conditions | parameters["settings"] | result]
