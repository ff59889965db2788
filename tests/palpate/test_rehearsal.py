"""The rehearsal of an effect lets every effect pass that is sound: all of palpate's own are."""

import time
from dataclasses import replace

import numpy as np
import pytest

import palpate.study
from estimation.channel import ChannelKind
from estimation.effect import AdditiveEffect, Parameter
from estimation.effects import EFFECTS
from palpate.common import user_effects
from palpate.common.user_effects import rehearse, watched
from palpate.study import Study
from robot_io.errors import InputError
from tests.estimation.presses import kelvin_voigt, session

DATA = session(1, lambda t, x, v, run: kelvin_voigt(x, v))


@pytest.mark.parametrize("kind", ChannelKind)
@pytest.mark.parametrize("name", EFFECTS)
def test_palpates_own_effects_pass(name, kind):
    rehearse(watched(EFFECTS[name]()), replace(DATA, kind=kind))


class SoundEffect(AdditiveEffect):
    """What the effects of the table spoil in one way each."""

    name = "mine"
    physics = equation = source = signature = "none"
    channels = frozenset(ChannelKind)
    gains = (Parameter("k", "N", -1e6, 1e6, (0.1, 10.0)),)

    def columns(self, data, inner):
        return data.position[:, None] ** 2


RNG = np.random.default_rng(0)
SPOILT = {
    "columns are zero throughout contact": lambda data: 0.0 * data.position[:, None],
    "columns gives other values when it is called again": lambda data: RNG.normal(size=(len(data), 1)),
    r"values beyond 1e\+30": lambda data: np.full((len(data), 1), 1e200),
    "has not come to an end in 0.2 s": lambda data: time.sleep(5.0),
}


@pytest.mark.parametrize("said", SPOILT)
def test_columns_that_nothing_could_be_fitted_to_are_refused(said, monkeypatch):
    if "0.2 s" in said:  # the others may take their time on a busy machine
        monkeypatch.setattr(palpate.study, "LIMIT_S", 0.2)
    spoilt = type("Spoilt", (SoundEffect,), {"columns": lambda self, data, inner: SPOILT[said](data)})
    with pytest.raises(InputError, match=f"Spoilt: .*{said}"):
        Study([DATA], effects=[spoilt()])


def test_an_effect_that_never_comes_to_be_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(user_effects, "LIMIT_S", 0.2)
    file = tmp_path / "waits.py"
    file.write_text(
        "import time\nfrom estimation.effects.sensor_statics import Bias\n"
        "class Waits(Bias):\n    name = 'waits'\n    def __init__(self):\n        time.sleep(9)\n"
    )
    with pytest.raises(InputError, match=r"Waits.*: cannot be made: has not come to an end in 0\.2 s"):
        Study([DATA], effects=[f"{file}:Waits"])
