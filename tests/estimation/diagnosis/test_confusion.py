"""Which effects are said to be as good as the one that is named."""

import numpy as np
import pytest
from estimation.diagnosis.search.confusion import is_as_small

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import diagnose
from estimation.effects import EFFECTS
from estimation.model import Model

ARM = Model("arm", (EFFECTS["rigid_body"](),))
RUNS, STEP_S = 4, 0.01


def carrying(noise_nm, burst_nm, bias_nm=0.05):
    """A joint of known weight, with a bias; a payload would take nearly the same in all its postures.

    The noise comes in bursts, as where an acceleration is off.
    """
    rng = np.random.default_rng(11)
    t = np.arange(0.0, 3.0, STEP_S)
    q = np.concatenate([0.5 + 0.2 * np.sin(1.3 * t + run) for run in range(RUNS)])
    v = np.concatenate([0.26 * np.cos(1.3 * t + run) for run in range(RUNS)])
    a = np.concatenate([-0.338 * np.sin(1.3 * t + run) for run in range(RUNS)])
    lever = 3.7 * np.cos(0.5 * q)
    bursts = np.convolve(rng.normal(0.0, burst_nm, len(q)) * (rng.random(len(q)) < 0.05), np.ones(6), "same")
    effort = 6.0 * np.cos(q) + bias_nm + rng.normal(0.0, noise_nm, len(q)) + bursts
    context = {"rigid_body_torque": 6.0 * np.cos(q), "payload_effort_per_kg": lever}
    motion = (np.tile(t, RUNS), q, v, a, effort)
    run = np.repeat(np.arange(RUNS), len(t))
    return ChannelData("joint_1", ChannelKind.REVOLUTE, *motion, run, np.full(len(q), -1), context)


def told(data):
    library = [EFFECTS["bias"](), EFFECTS["payload"]()]
    found = diagnose(data, ARM, library, rng=np.random.default_rng(1)).channels[0]
    (entry,) = found.accepted
    return entry, found


@pytest.mark.parametrize("bias_nm", [0.05, -0.05])
def test_a_small_difference_of_errors_is_none_where_a_few_bursts_make_it(bias_nm):
    entry, found = told(carrying(0.002, 0.02, bias_nm))
    assert {entry.effect, *entry.confused_with} == {"bias", "payload"}
    assert found.next_experiment.separates == [entry.effect, *entry.confused_with]


def test_a_difference_that_chance_does_not_make_is_used():
    entry, _ = told(carrying(0.002, 0.0))
    assert entry.effect == "bias"
    assert entry.confused_with == []


RUN = np.repeat(np.arange(RUNS), 500)


def squared_noise(seed):
    return np.random.default_rng(seed).normal(size=len(RUN)) ** 2


def test_errors_that_differ_as_chance_makes_them_differ_are_as_small():
    told = [is_as_small(squared_noise(seed), squared_noise(seed + 1000), RUN) for seed in range(100)]
    assert np.mean(told) > 0.95


def test_an_error_that_is_larger_all_along_is_not_as_small():
    assert not is_as_small(squared_noise(1), squared_noise(2) * 1.15, RUN)


@pytest.mark.parametrize("runs", [1, 2, RUNS])
def test_an_error_that_is_much_larger_in_one_place_of_a_few_runs_is_not_as_small(runs):
    worse = squared_noise(3)
    for run in range(runs):
        worse[500 * run + 100 : 500 * run + 105] += 150.0
    assert not is_as_small(squared_noise(3), worse, RUN)
