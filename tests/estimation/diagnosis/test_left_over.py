"""What is said of an error that no effect explains."""

import numpy as np
import pytest

from estimation.diagnosis.bench.standing import stand
from estimation.diagnosis.judgement.left_over import left_over
from tests.estimation.diagnosis.presses import NOISE_N, channel, kelvin_voigt, motion
from tests.estimation.diagnosis.test_diagnose import MODEL

DRYING = np.array([0.0, 0.06, 0.11, 0.15, 0.18, 0.2])  # by which each run is stiffer than the first


def repeated(extra, noise_n=NOISE_N):
    """One press, made six times; `extra` is a force of depth and run [N]."""
    rng = np.random.default_rng(2)
    time_s, x, v, run = motion(rng, runs=1)
    x, v, run = np.tile(x, 6), np.tile(v, 6), np.repeat(np.arange(6), len(x))
    time_s = np.tile(time_s, 6) + 3.0 * run
    force = kelvin_voigt(x, v, extra(x, run)) + rng.normal(0.0, noise_n, len(x))
    return channel(force, time_s, x, v, run)


@pytest.mark.parametrize(
    ("extra", "noise_n", "told"),
    [
        (lambda x, run: 800.0 * x * DRYING[run], NOISE_N, "from run to run; the rest depends on position"),
        (lambda x, run: 0.5 * np.sin(900.0 * x), NOISE_N, "could still be explained, by position"),
        (lambda x, run: 0.0 * x, 10.0 * NOISE_N, "could still be explained, by position"),
    ],
)
def test_runs_that_change_are_told_from_a_law_of_the_motion_and_from_noise(extra, noise_n, told):
    standing = stand(repeated(extra, noise_n), MODEL, {})
    assert told in left_over(standing, np.inf, ["position"])
