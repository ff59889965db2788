"""Effects that are not in the library, plain as they are, are not called by another's name."""

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS
from tests.estimation.diagnosis.test_pairs_in_a_joint import NOISE_NM, channel, pendulum


def answer(data, *names):
    model, effects = MODELS["pendulum"]().build(ModelContext()), [EFFECTS[name]() for name in names]
    return diagnose(data, model, effects, rng=np.random.default_rng(1)).channels[0]


@pytest.mark.parametrize("right", ["joint_spring", "cubic_stiffness"])
def test_a_straight_and_a_cubic_spring_are_not_called_by_each_others_name(right):
    # beside a weight, either draws nearly what the other does
    def spring(q, v):
        return 4.0 * q if right == "joint_spring" else 1.0 * q**3

    wrong = {"joint_spring": "cubic_stiffness", "cubic_stiffness": "joint_spring"}[right]
    q, v, a, effort, rng = pendulum(7, spring)
    joint = channel(q, v, a, effort + rng.normal(0.0, NOISE_NM, effort.shape))
    found = answer(joint, wrong, "bias")
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert "position" in found.depends_on
    assert [entry.effect for entry in answer(joint, right, wrong, "bias").accepted] == [right]
