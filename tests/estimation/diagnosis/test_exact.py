"""Data made without noise: what is left in the last digits is no law, and what is missing has its name."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from tests.estimation.diagnosis.test_diagnose import MODEL
from tests.estimation.presses import C, K, kelvin_voigt, session

NAMES = ("cubic_stiffness", "layered_stiffness", "bias")


def without_noise(extra=0.0, digits=None):
    data = session(5)
    force = kelvin_voigt(data.position, data.velocity, extra * data.position**3)
    return replace(data, effort=force if digits is None else np.round(force, digits))


def answer(data):
    effects = [EFFECTS[name]() for name in NAMES]
    return diagnose(data, MODEL, effects, rng=np.random.default_rng(1)).channels[0]


@pytest.mark.parametrize("digits", [None, 6])
def test_an_exact_model_is_adequate(digits):
    found = answer(without_noise(digits=digits))
    assert found.verdict is Verdict.ADEQUATE
    assert found.final.parameters["stiffness.k"].value == pytest.approx(K, rel=1e-6)
    assert found.final.parameters["damping.c"].value == pytest.approx(C, rel=1e-5)


def test_what_is_missing_in_exact_data_is_named_alone():
    found = answer(without_noise(extra=1e6))
    assert found.verdict is Verdict.MISSING
    assert [entry.effect for entry in found.accepted] == ["cubic_stiffness"]
    assert found.accepted[0].parameters["k3"].value == pytest.approx(1e6, rel=1e-5)


def test_what_is_small_and_not_in_the_last_digits_is_not_passed_over():
    found = answer(without_noise(extra=1e6 * 1e-4))
    assert [entry.effect for entry in found.accepted] == ["cubic_stiffness"]
