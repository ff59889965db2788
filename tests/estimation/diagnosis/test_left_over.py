"""What is said of an error that no effect explains."""

import re

import numpy as np
import pytest
from estimation.diagnosis.judgement.left_over import left_over, small_rest

from estimation.fit.standing import stand
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.presses import NOISE_N, K, channel, kelvin_voigt, motion

DRYING = np.array([0.0, 0.06, 0.11, 0.15, 0.18, 0.2])  # by which each run is stiffer than the first


def repeated(extra, noise_n=NOISE_N, zero_n=0.0):
    """One press, made six times; `extra` is a force of depth and run [N], `zero_n` what the zero drifts."""
    rng = np.random.default_rng(2)
    time_s, x, v, run = motion(rng, runs=1)
    x, v, run = np.tile(x, 6), np.tile(v, 6), np.repeat(np.arange(6), len(x))
    time_s = np.tile(time_s, 6) + 3.0 * run
    force = kelvin_voigt(x, v, extra(x, run)) + rng.normal(0.0, noise_n, len(x)) + zero_n * DRYING[run]
    return channel(force, time_s, x, v, run)


@pytest.mark.parametrize(
    ("extra", "noise_n", "told"),
    [
        (lambda x, run: 800.0 * x * DRYING[run], NOISE_N, "the runs differ by a factor, from 0."),
        (lambda x, run: 0.5 * np.sin(900.0 * x), NOISE_N, "could still be explained, by position"),
        (lambda x, run: 0.0 * x, 10.0 * NOISE_N, "could still be explained, by position"),
    ],
)
def test_runs_that_change_are_told_from_a_law_of_the_motion_and_from_noise(extra, noise_n, told):
    standing = stand(repeated(extra, noise_n), MODEL, {})
    assert told in left_over(standing, np.inf, ["position"])


def test_runs_that_differ_by_no_factor_are_told_so():
    standing = stand(repeated(lambda x, run: 0.0 * x, zero_n=5.0), MODEL, {})
    assert "see what differs from run to run" in left_over(standing, np.inf, [])


def test_a_factor_of_each_run_is_told_with_what_would_be_left_without_it():
    """Each run beside what the other five let expect; they are 1.0 to 1.2 times as stiff as the first."""
    factor = 1.0 + DRYING
    expected = [one / np.mean(np.delete(factor, i)) for i, one in enumerate(factor)]
    stiffer = repeated(lambda x, run: K * x * DRYING[run])
    told = left_over(stand(stiffer, MODEL, {}), np.inf, [])
    found = re.search(r"from (\S+) \(run 0\) to (\S+) \(run 5\).*it (\S+) N", told)
    least, most, left = (float(number) for number in found.groups())
    assert (least, most) == pytest.approx((expected[0], expected[5]), rel=0.02)
    assert left < 2.0 * NOISE_N


def test_a_small_rest_is_told_with_its_size_on_blocks():
    """A ripple that hides in the noise of a sample: what a spring and a damper leave of it is known."""
    wave = lambda x, run: np.where(x > 0, 0.7 * NOISE_N * np.sin(600.0 * x), 0.0)  # noqa: E731
    data = repeated(wave)
    standing = stand(data, MODEL, {})
    frame, pressed = standing.plain.frame, data.position > 0
    model = frame.reduce(np.column_stack([data.position, data.velocity]) * pressed[:, None])[frame.trusted]
    ripple = frame.reduce(wave(data.position, data.run))[frame.trusted]
    ripple -= model @ np.linalg.lstsq(model, ripple, rcond=None)[0]
    told = small_rest(standing, np.inf, [])
    found = re.search(r"explains, (\S+) N .* of (\S+) ms, which is (\S+) N; .* no single signal", told)
    rest, over_ms, whole = (float(number) for number in found.groups())
    assert standing.rmse < 1.05 * standing.floor()
    assert rest == pytest.approx(np.sqrt(np.mean(ripple**2)), rel=0.3)
    assert rest < whole < standing.rmse
    assert over_ms == 4.0
