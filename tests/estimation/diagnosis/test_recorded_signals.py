"""What was recorded beside a channel, such as a temperature: asked whether the error depends on it."""

from dataclasses import replace

import numpy as np
import pytest
from tests.estimation.diagnosis.presses import session

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.models import MODELS
from robot_io.errors import InputError
from tests.estimation.fits import compare, fits

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def warming(data):
    """Degrees, one course for each run."""
    start = np.random.default_rng(3).permutation(len(data.runs))
    return 20.0 + 2.0 * start[data.run] + np.sin(data.time_s)


def named(data, name="temperature"):
    return replace(data, context={name: warming(data)}, recorded=frozenset({name}))


def softened(data, share_per_kelvin=0.01):
    """The same object, softer where it is warm."""
    return replace(data, effort=data.effort * (1.0 - share_per_kelvin * (warming(data) - 25.0)))


def answer(data):
    return diagnose(data, MODEL, rng=np.random.default_rng(1)).channels[0]


def test_an_object_that_softens_with_warmth_is_an_effect_that_depends_on_the_recorded_temperature():
    found = answer(named(softened(session(11))))
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert found.depends_on[0] == "temperature"
    assert found.noise_floor < 0.5 * found.baseline.rmse
    assert "different values of temperature" in found.next_experiment.instruction
    assert found.next_experiment.probe == {}


def test_runs_that_differ_for_no_known_reason_are_no_noise_of_a_revision():
    revisions = fits(softened(session(11)), MODEL, ["cubic_stiffness"])
    assert all(0.04 < revision.noise_floor < 0.5 * revision.rmse for revision in revisions)


def test_a_temperature_that_does_nothing_is_not_blamed():
    found = answer(named(session(12)))
    assert found.verdict is Verdict.ADEQUATE


@pytest.mark.parametrize("signal", [{}, {"wind": np.zeros((len(session(12)), 2))}])
def test_what_was_recorded_must_be_there_and_one_number_a_sample(signal):
    with pytest.raises(InputError, match="wind"):
        replace(session(12), context=signal, recorded=frozenset({"wind"}))


@pytest.mark.parametrize("name", ["temperature", "speed"])
def test_the_error_is_split_by_what_was_recorded(name):
    told = compare(named(softened(session(11)), name), MODEL)
    parts = told.parts["temperature" if name == "temperature" else "recorded speed"]
    assert max(part.rmse for part in parts) > 1.5 * min(part.rmse for part in parts)
