"""A base model that is not linear: its exponent is found from where nothing is known of it."""

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS
from tests.estimation.presses import session


@pytest.mark.parametrize(("exponent", "stiffness"), [(1.5, 20000.0), (2.2, 600000.0)])
def test_an_object_that_follows_a_power_law_is_found_to_follow_it(exponent, stiffness):
    def law(t, x, v, run):
        depth = np.maximum(x, 0.0)
        return np.maximum(stiffness * depth**exponent * (1.0 + 0.3 * v), 0.0)

    base = MODELS["hunt_crossley"]().build(ModelContext(surface_found=True))
    tried = [EFFECTS[name]() for name in ("stiffness", "cubic_stiffness", "layered_stiffness")]
    found = diagnose(session(7, law), base, tried, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.ADEQUATE
    assert found.final.parameters["hunt_crossley.n"].value == pytest.approx(exponent, rel=0.01)
    assert found.final.parameters["hunt_crossley.k"].value == pytest.approx(stiffness, rel=0.05)
