"""What a sensor or a surface remembers from one run to the next."""

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.models import MODELS
from tests.estimation.presses import NOISE_N, RATE_HZ, C, K, kelvin_voigt, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def the_one_effect(data):
    found = diagnose(data, MODEL, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.MISSING
    assert found.final.rmse == pytest.approx(NOISE_N, rel=0.05)
    assert found.final.parameters["stiffness.k"].value == pytest.approx(K, rel=0.01)
    assert found.final.parameters["damping.c"].value == pytest.approx(C, rel=0.05)
    (entry,) = found.accepted
    return entry


def dragged(force, width, reading):
    """A reading with friction between it and the force, that begins where it was left."""
    readings = []
    for value in force:
        reading = min(max(reading, value - width), value + width)
        readings.append(reading)
    return np.array(readings)


@pytest.mark.parametrize("at_first_n", [0.0, 0.3])
def test_a_reading_that_stays_up_after_a_press_is_a_hysteresis_in_the_next_run_too(at_first_n):
    entry = the_one_effect(session(41, lambda t, x, v, run: dragged(kelvin_voigt(x, v), 0.3, at_first_n)))
    assert entry.effect == "hysteresis"
    assert entry.parameters["width"].value == pytest.approx(0.3, rel=0.02)


def dented(x, run, share, kept):
    """Depth below a surface that sinks with the deepest press so far."""
    deepest, left = np.zeros_like(x), 0.0
    for number in np.unique(run):
        rows = run == number
        deepest[rows] = np.maximum(np.maximum.accumulate(np.maximum(x[rows], 0.0)), left)
        left = kept * deepest[rows][-1]
    return x - share * deepest


@pytest.mark.parametrize("kept", [0.0, 1.0])
def test_a_dent_may_be_gone_or_still_be_there_when_the_next_run_presses(kept):
    def law(t, x, v, run):
        left = dented(x, run, 0.12, kept)
        speed = np.where(np.diff(run, prepend=0) == 0, np.gradient(left, 1.0 / RATE_HZ), 0.0)
        return kelvin_voigt(left, speed)

    entry = the_one_effect(session(42, law))
    assert entry.effect == "plastic_set"
    assert entry.parameters["share"].value == pytest.approx(0.12, rel=0.03)
    assert entry.parameters["kept"].value == pytest.approx(kept, abs=0.05)


def rubbing(x, run, force_n, presliding_m):
    """Dahl's friction, which begins with nothing at each touch."""
    pulled, before = np.zeros_like(x), 0.0
    for i in range(1, len(x)):
        way = x[i] - x[i - 1] if run[i] == run[i - 1] else 0.0
        full = np.sign(way) * force_n
        before = full + (before - full) * np.exp(-abs(way) / presliding_m) if x[i] > 0.0 else 0.0
        pulled[i] = before
    return pulled


def test_what_rubs_has_nothing_to_hold_on_to_before_the_touch():
    entry = the_one_effect(session(43, lambda t, x, v, run: kelvin_voigt(x, v, rubbing(x, run, 0.5, 3e-4))))
    assert entry.effect == "dry_friction"
    assert entry.parameters["force"].value == pytest.approx(0.5, rel=0.05)
    assert entry.parameters["presliding"].value == pytest.approx(3e-4, rel=0.15)
