"""Effects that only look right once the other parameters have made room for them."""

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS
from tests.estimation.presses import K, kelvin_voigt, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def answer(data, *more):
    base = MODEL
    for name in more:
        base = base.with_effect(EFFECTS[name]())
    return diagnose(data, base, rng=np.random.default_rng(1)).channels[0]


def test_finds_a_growing_damper_beside_a_spring_whose_part_it_could_take():
    def law(t, x, v, run):
        return kelvin_voigt(x, v, 2.5e4 * np.maximum(x, 0.0) ** 1.5 * v)

    found = answer(session(11, law), "contact_offset")
    assert [entry.effect for entry in found.accepted] == ["hunt_crossley"]
    assert found.accepted[0].parameters["n"].value == pytest.approx(1.5, abs=0.2)
    assert found.final.parameters["stiffness.k"].value == pytest.approx(K, rel=0.02)


def test_finds_a_dead_band_that_a_surface_deeper_down_made_up_for():
    def law(t, x, v, run):
        return np.maximum(kelvin_voigt(x, v) - 0.8, 0.0)

    found = answer(session(12, law), "contact_offset")
    assert found.verdict is Verdict.MISSING
    assert any("deadband" in (entry.effect, *entry.confused_with) for entry in found.accepted)
    assert found.final.rmse < 1.05 * found.noise_floor
