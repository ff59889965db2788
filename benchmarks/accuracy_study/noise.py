"""Noise that grows with the force, 0 to 10 % (paper, section VI-C), against the Cramer-Rao bound."""

import tempfile
from pathlib import Path

import numpy as np

from accuracy_study.grid import probe
from estimation.estimate_channel import fitting_rows
from estimation.estimator import Estimator
from estimation.estimators import ESTIMATORS
from estimation.estimators.ransac import Ransac
from estimation.estimators.sprls import Sprls
from estimation.regression import Regression
from estimation.study.source import open_source
from robot_io.types import FloatArray, IntArray

STIFFNESS, DAMPING = 500.0, 100.0
SAMPLES = 2000
SHARES = (0.02, 0.05, 0.10)
FORCE_LIMIT_N = 10.0


def contact_motion() -> tuple[FloatArray, IntArray]:
    """Depth and speed of samples in contact, shape (n, 2), as the simulated arm probes, and their runs."""
    with tempfile.TemporaryDirectory() as folder:
        channel = open_source(probe(STIFFNESS, DAMPING, 1, Path(folder))).tared()[0]
    rows = np.flatnonzero(fitting_rows(channel))
    rows = rows[np.linspace(0, len(rows) - 1, SAMPLES).astype(np.int64)]
    rows = rows[STIFFNESS * channel.position[rows] + DAMPING * channel.velocity[rows] > 0]
    return np.column_stack([channel.position[rows], channel.velocity[rows]]), channel.run[rows]


def contestants(share: float) -> dict[str, Estimator]:
    """The estimators of the study, for a noise of this share of the force."""
    named = {name: ESTIMATORS[name]() for name in ("lsq", "weighted", "robust")}
    return named | {
        "ransac at 0.01 N (paper)": Ransac(),
        "ransac at the noise": Ransac(threshold=2 * share * FORCE_LIMIT_N),
        "sprls 20, 1 (paper)": Sprls(),
        "sprls 0, 0": Sprls(beta=0.0, gamma=0.0),
    }


def run_study(draws: int) -> None:
    """Print root mean square errors over the Cramer-Rao bound (for noise of known variance)."""
    columns, run = contact_motion()
    force = columns @ np.array([STIFFNESS, DAMPING])
    print(f"\nForce noise in % of the force; k = {STIFFNESS:g}, c = {DAMPING:g}, {len(run)} samples")
    print(f"Root mean square error over the Cramer-Rao bound, k / c; in brackets in %; {draws} draws\n")
    print(f"{'estimator':26s}" + "".join(f"{f'{100 * share:g} %':>28s}" for share in SHARES))
    for name in contestants(SHARES[0]):
        cells = [_cell(contestants(share)[name], columns, run, force, share, draws) for share in SHARES]
        print(f"{name:26s}" + "".join(f"{cell:>28s}" for cell in cells))
    print(
        "\nA threshold of 0.01 N keeps the few samples that happen to lie within it and throws away the\n"
        "information of all others. Weights that follow the noise come near the bound."
    )


def _cell(
    estimator: Estimator, columns: FloatArray, run: IntArray, force: FloatArray, share: float, draws: int
) -> str:
    sigma = share * force
    bound = np.sqrt(np.diag(np.linalg.inv((columns / sigma[:, None]).T @ (columns / sigma[:, None]))))
    errors = []
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        noisy = force + sigma * rng.standard_normal(len(force))
        problem = Regression(columns, noisy, ("k", "c"), ("N/m", "N s/m"), run=run)
        found = estimator.fit(problem, rng=rng)
        errors.append((found["k"].value - STIFFNESS, found["c"].value - DAMPING))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    k, c = rms / bound
    return f"{k:.2f} / {c:.2f} ({100 * rms[0] / STIFFNESS:.2f}, {100 * rms[1] / DAMPING:.2f})"
