import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.comparison import compare
from estimation.models import MODELS
from estimation.revision import revise
from robot_io.errors import InputError
from tests.estimation.presses import kelvin_voigt, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())


def cubic(t, x, v, run):
    return kelvin_voigt(x, v, 1.5e6 * np.maximum(x, 0) ** 3)


def test_comparison_says_where_a_stiffening_spring_is_missed():
    told = compare(session(4, cubic), MODEL)
    assert told.lack_of_fit > 3.0
    assert {"run", "direction", "speed", "depth", "effort"} <= set(told.parts)
    assert sum(part.energy for part in told.parts["run"]) == pytest.approx(1.0)
    deepest = told.parts["depth"][-1]
    assert deepest.mean > 0.0  # the measurement is above a straight line where it is deepest
    assert "times the noise floor" in told.words[0]
    assert any("depth" in words or "effort" in words for words in told.words[1:])


def test_what_a_fuller_model_leaves_is_the_floor_of_a_poorer_one_too():
    data = session(4, cubic)
    left = revise(data, MODEL, ["cubic_stiffness"])[-1].noise_floor
    told = compare(data, MODEL, left)
    assert told.floor.value <= left
    assert told.lack_of_fit >= told.rmse / left
    assert f"noise floor of {told.floor.value:.3g}" in told.words[0]


def test_comparison_of_a_complete_model_is_noise():
    told = compare(session(4), MODEL)
    assert told.lack_of_fit == pytest.approx(1.0, abs=0.05)
    assert "noise" in told.words[0]
    assert np.nanstd(told.residual) == pytest.approx(0.05, rel=0.1)


def test_comparison_refuses_what_cannot_be_judged():
    with pytest.raises(InputError, match="samples"):
        compare(session(4).select(np.arange(20)), MODEL)


def test_revisions_fall_to_the_noise_floor():
    stages = revise(session(4, cubic), MODEL, ["bias", "cubic_stiffness"])
    assert [stage.added for stage in stages] == ["", "bias", "cubic_stiffness"]
    assert stages[2].rmse < 0.4 * stages[0].rmse
    assert stages[2].rmse == pytest.approx(0.05, rel=0.1)
    bias = stages[2].parameters["bias.offset"]
    assert bias.value == pytest.approx(0.0, abs=4 * bias.std_err)
    assert len(stages[0].model.effects) == 2


@pytest.mark.parametrize(
    ("name", "words"),
    [("magic", "Valid"), ("coulomb_friction", "not for a contact"), ("stiffness", "more than once")],
)
def test_revision_refuses_effects_that_do_not_fit(name, words):
    with pytest.raises(InputError, match=words):
        revise(session(4), MODEL, [name])
