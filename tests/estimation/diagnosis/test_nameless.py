"""What is not in the library is not called by its twin's name."""

import numpy as np
import pytest
from scipy.signal import lfilter

from estimation.base_model import ModelContext
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.fit.standing import stand
from estimation.models import MODELS
from tests.estimation.diagnosis.test_pairs_in_a_joint import NOISE_NM, STEP_S, channel, pendulum

MODEL = MODELS["pendulum"]().build(ModelContext())
LATE_S, QUIET_NM = 0.03, 0.005


def answer(data, *tried):
    effects = [EFFECTS[name]() for name in tried]
    return diagnose(data, MODEL, effects, rng=np.random.default_rng(1)).channels[0]


def lagging(effort, step_s=STEP_S, time_s=LATE_S):
    kept = np.exp(-step_s / time_s)
    first = kept * effort[:, :1]
    return lfilter([1.0 - kept], [1.0, -kept], effort, axis=1, zi=first)[0]


def delayed(effort):
    late = round(LATE_S / STEP_S)
    return np.concatenate([np.repeat(effort[:, :1], late, axis=1), effort[:, :-late]], axis=1)


def noisy(q, v, a, effort, rng, noise_nm=NOISE_NM):
    return channel(q, v, a, effort + rng.normal(0.0, noise_nm, effort.shape))


@pytest.mark.parametrize(("right", "wrong", "sensor"), [("lag", "delay", lagging), ("delay", "lag", delayed)])
def test_a_lag_and_a_delay_are_not_called_by_each_others_name(right, wrong, sensor):
    data = noisy(*pendulum(3, sensor=sensor), QUIET_NM)
    found = answer(data, wrong, "bias")
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    assert [suspect.effect for suspect in found.suspects] == [wrong]
    assert [entry.effect for entry in answer(data, right, wrong, "bias").accepted] == [right]


@pytest.mark.parametrize("right", ["joint_spring", "cubic_stiffness"])
def test_a_spring_that_is_barely_seen_is_not_called_by_anothers_name(right):
    def spring(q, v):
        return 0.5 * q if right == "joint_spring" else 0.12 * q**3

    wrong = {"joint_spring": "cubic_stiffness", "cubic_stiffness": "joint_spring"}[right]
    data = noisy(*pendulum(8, spring))
    found = answer(data, wrong, "bias")
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.accepted == []
    (entry,) = answer(data, right, wrong, "bias").accepted
    assert right in {entry.effect, *entry.confused_with}


def test_means_keep_what_is_smooth_and_lose_what_is_not():
    data = noisy(*pendulum(8, lambda q, v: 0.1 * q**3))
    standing = stand(data, MODEL, {})
    assert standing.left_of_means(0.1) > 1.3 * standing.left_of_means(0.01) > 0.0
    assert standing.left_of_means(0.01) == pytest.approx(standing.left_of_blocks(), rel=0.05)
