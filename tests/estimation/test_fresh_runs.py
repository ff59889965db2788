"""Whether runs met an object that remembered the run before."""

import numpy as np
import pytest

from palpate.estimation.base_model import ModelContext
from palpate.estimation.models import MODELS
from palpate.estimation.study.model_suggestions import on_clocks_of_their_own, relaxes_afresh
from tests.estimation.presses import RATE_HZ, kelvin_voigt, maxwell, session

MODEL = MODELS["kelvin_voigt"]().build(ModelContext())
TAU_S = 1.5


def remembered(time_s, x, tau_s):
    """The same spring and dashpot, never let go: what has not flowed back between two runs is still there."""
    z, before_m = np.zeros_like(x), 0.0
    pressed = np.maximum(x, 0.0)
    left = 0.0
    for i in range(len(x)):
        step_s = time_s[i] - time_s[i - 1] if i else 1.0 / RATE_HZ
        left = (left * np.exp(-(step_s - 1.0 / RATE_HZ) / tau_s) + pressed[i] - before_m) / (
            1.0 + 1.0 / RATE_HZ / tau_s
        )
        z[i], before_m = left, pressed[i]
    return z


@pytest.mark.parametrize("afresh", [True, False])
def test_the_data_say_whether_the_object_remembered(afresh):
    def law(t, x, v, run):
        return kelvin_voigt(x, v, 500.0 * (maxwell(t, x, run, TAU_S) if afresh else remembered(t, x, TAU_S)))

    data = session(61, law)
    assert relaxes_afresh(data, MODEL) == afresh
    assert not relaxes_afresh(on_clocks_of_their_own(data), MODEL)


def test_what_does_not_relax_says_nothing():
    assert not relaxes_afresh(session(62), MODEL)
