"""Effort and motion on two clocks, and lost rows."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data_quality import checklist, contaminated, quality_warnings
from palpate.estimation.data_quality.sampling import lost_rows, time_offset
from palpate.estimation.models import MODELS
from palpate.estimation.signals.blocks import number_pieces
from palpate.estimation.signals.runwise import shift
from tests.estimation.presses import kelvin_voigt, maxwell, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def with_motion(data, position, time_s=None):
    """The channel with another position, or other times, and derivatives of that."""
    time_s = data.time_s if time_s is None else time_s
    motion = differentiate(time_s, position, number_pieces(time_s, data.run))
    return replace(
        data, time_s=time_s, position=position, velocity=motion.velocity, acceleration=motion.acceleration
    )


def delayed(data, what, delay_s):
    late = shift(getattr(data, what), data.time_s, data.run, delay_s)
    return replace(data, effort=late) if what == "effort" else with_motion(data, late)


@pytest.mark.parametrize(
    ("what", "side", "delay_ms"),
    [("position", "early", 40.0), ("effort", "late", 4.0), ("effort", "late", 20.0)],
)
def test_report_states_size_and_direction_of_a_delay(what, side, delay_ms):
    data = delayed(session(3), what, 1e-3 * delay_ms)
    told = time_offset(data, MODEL)
    assert f"{side} relative to the motion: the error of kelvin_voigt is 0." in told
    assert float(told.split()[3]) == pytest.approx(delay_ms, abs=0.5)
    assert told in quality_warnings(data, MODEL)
    assert checklist(data, MODEL)["sync"] == told
    assert contaminated(data, MODEL) == told


LAWS = {
    "nothing": lambda t, x, v, run: kelvin_voigt(x, v),
    "a hardening spring": lambda t, x, v, run: kelvin_voigt(x, v, 4e6 * np.maximum(x, 0.0) ** 3),
    "slow relaxation": lambda t, x, v, run: kelvin_voigt(x, v, 400.0 * maxwell(t, x, run, 0.3)),
    "quick relaxation": lambda t, x, v, run: kelvin_voigt(x, v, 400.0 * maxwell(t, x, run, 0.02)),
    "friction": lambda t, x, v, run: kelvin_voigt(x, v, 0.5 * np.sign(v)),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_missing_effect_is_not_taken_for_a_delay(law, correlation):
    data = session(3, LAWS[law], correlation=correlation)
    assert time_offset(data, MODEL) is None
    assert lost_rows(data) is None


def without_rows(data, share, seed=1):
    """Some rows left out, and the times of the others even again."""
    left = data.select(np.random.default_rng(seed).random(len(data)) > share)
    time_s = np.concatenate([0.002 * np.arange(np.sum(left.run == run)) for run in left.runs])
    return with_motion(left, left.position, time_s)


@pytest.mark.parametrize("share", [0.01, 0.03, 0.08, 0.12, 0.16])
def test_lost_rows_show_as_jumps_of_the_motion(share):
    data = without_rows(session(3, runs=4), share)
    told = lost_rows(data)
    assert float(told.rpartition("About ")[2].split()[0]) == pytest.approx(100.0 * share, rel=0.3)
    assert told in quality_warnings(data, MODEL)


def test_motion_that_starts_and_stops_within_few_samples_does_not_jump():
    steps_m = 1e-4 * np.where(np.arange(3000) // 100 % 2, -0.5, 0.5)
    start_and_stop = [0.0, 0.0, 0.05, 0.34, 0.53, 0.66, 0.7, 0.66, 0.32, 0.13, 0.05, 0.0, 0.0]
    for begin in range(150, 3000, 200):
        steps_m[begin : begin + len(start_and_stop)] = 1e-4 * np.array(start_and_stop)
    data = session(3, runs=6).select(np.arange(3000))
    data = replace(data, run=np.zeros(3000, dtype=np.int64))
    assert lost_rows(with_motion(data, np.cumsum(steps_m), 0.02 * np.arange(3000))) is None


def test_rows_missing_with_their_times_are_no_jumps():
    data = session(3)
    assert lost_rows(data.select(np.random.default_rng(1).random(len(data)) > 0.03)) is None


@pytest.mark.parametrize("noise_m", [1e-6, 1e-5, 1e-4])
def test_noisy_motion_does_not_jump(noise_m):
    data = session(3)
    noisy = data.position + np.random.default_rng(0).normal(0.0, noise_m, len(data))
    assert lost_rows(with_motion(data, noisy)) is None


@pytest.mark.parametrize("step_m", [1e-6, 3e-6, 1e-5, 2e-5, 5e-5, 8e-5, 1e-4])
def test_encoder_steps_are_no_jumps(step_m):
    data = session(3)
    assert lost_rows(with_motion(data, step_m * np.round(data.position / step_m))) is None
