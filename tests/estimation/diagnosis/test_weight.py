"""A weight that the model does not know is no spring, unless the joint moves too little to tell."""

import numpy as np
import pytest
from estimation.diagnosis.search.credible import may_be_nothing
from estimation.diagnosis.search.library import candidates, library

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.fit.standing import stand
from estimation.models import MODELS

STEP_S, NOISE_NM = 0.004, 0.02
WEIGHT_NM, ZERO_RAD = 1.5, 0.7


def swinging(amplitude_rad, zero_rad, law):
    """Six runs of a joint that moves by three sines about `zero_rad` and carries `law(q)` [N m]."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 5.0, STEP_S)
    rates, phases = rng.uniform(1.0, 4.0, (2, 6, 3, 1))
    size = amplitude_rad * np.array([0.5, 0.3, 0.2])[:, None]
    sines, cosines = np.sin(rates * t + phases), np.cos(rates * t + phases)
    q = (zero_rad + (size * sines).sum(axis=1)).ravel()
    v = (size * rates * cosines).sum(axis=1).ravel()
    a = -(size * rates**2 * sines).sum(axis=1).ravel()
    run = np.repeat(np.arange(6), len(t))
    torque = 0.05 * a + 0.1 * v + law(q) + NOISE_NM * rng.standard_normal(len(q))
    time_s = (t + 7.0 * np.arange(6)[:, None]).ravel()
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, q, v, a, torque, run, np.full(len(q), -1))


def answer(data, base):
    model = MODELS[base]().build(ModelContext())
    return diagnose(data, model, rng=np.random.default_rng(1)).channels[0]


def weight(q):
    return WEIGHT_NM * np.sin(q - 0.4)


@pytest.mark.parametrize("amplitude_rad", [0.8, 1.5])
def test_a_weight_is_found_beside_a_model_that_has_none(amplitude_rad):
    found = answer(swinging(amplitude_rad, ZERO_RAD, weight), "inertia")
    assert found.verdict is Verdict.MISSING
    (entry,) = found.accepted
    assert entry.effect == "weight"
    g1, g2 = (entry.parameters[name] for name in ("g1", "g2"))
    assert np.hypot(g1.value, g2.value) == pytest.approx(WEIGHT_NM, rel=0.05)
    assert abs(g1.value - WEIGHT_NM * np.cos(0.4)) < 4.0 * g1.std_err


@pytest.mark.parametrize("size_nm", [0.0, WEIGHT_NM])
def test_a_weight_whose_interval_holds_zero_may_be_nothing(size_nm):
    data = swinging(1.0, 0.0, lambda q: size_nm * np.sin(q))
    effect = EFFECTS["weight"]()
    model = MODELS["inertia"]().build(ModelContext()).with_effect(effect)
    assert may_be_nothing(effect, stand(data, model, {})) is (size_nm == 0.0)


@pytest.mark.parametrize(("amplitude_rad", "zero_rad", "off_rad"), [(0.2, 0.0, 0.0), (0.3, ZERO_RAD, 0.4)])
def test_where_a_sine_is_nearly_straight_both_are_named_as_one_group(amplitude_rad, zero_rad, off_rad):
    data = swinging(amplitude_rad, zero_rad, lambda q: WEIGHT_NM * np.sin(q - off_rad))
    (entry,) = answer(data, "inertia").accepted
    assert {entry.effect, *entry.confused_with} >= {"joint_spring", "weight"}


def test_a_spring_that_is_wound_far_is_no_weight():
    (entry,) = answer(swinging(1.5, 0.0, lambda q: 0.8 * q), "inertia").accepted
    assert (entry.effect, entry.confused_with) == ("joint_spring", [])


@pytest.mark.parametrize(("base", "tried", "not_tried"), [
    ("inertia", "weight", "gravity_tilt"),
    ("pendulum", "gravity_tilt", "weight"),
])  # fmt: skip
def test_a_tilt_is_tried_where_there_is_a_weight_to_be_turned(base, tried, not_tried):
    data = swinging(1.0, 0.0, weight)
    names = {e.name for e in candidates(data, MODELS[base]().build(ModelContext()), library())}
    assert tried in names
    assert not_tried not in names
