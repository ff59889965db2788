"""What accelerates a drive's rotor does not press on its gear."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.diagnosis.search.extend import extend

from estimation.channel import ChannelData, ChannelKind
from estimation.effects import EFFECTS
from estimation.fit.standing import stand
from estimation.model import Model

LINK, ROTOR, WEIGHT = 0.05, 0.03, 2.0  # kg m^2, kg m^2, N m


def swings(weight=WEIGHT):
    """A pendulum on a geared drive, at several rates; the friction of the gear is 0.3 of what passes it."""
    rng = np.random.default_rng(11)
    run = np.repeat(np.arange(4), 1000)
    t = np.tile(np.arange(1000) * 0.004, 4) + 5.0 * run
    rate = 2.0 + 1.5 * run
    q, v, a = 0.9 * np.sin(rate * t), 0.9 * rate * np.cos(rate * t), -0.9 * rate**2 * np.sin(rate * t)
    passed = LINK * a + weight * np.sin(q)
    torque = passed + ROTOR * a + 0.3 * np.abs(passed) * np.tanh(v / 0.02)
    torque = torque + 0.01 * rng.standard_normal(len(t))
    return ChannelData("joint_1", ChannelKind.REVOLUTE, t, q, v, a, torque, run, np.full(len(t), -1))


def with_friction(data, base):
    standing = stand(data, Model(base, (EFFECTS[base](),)), {})
    effect = EFFECTS["load_dependent_friction"]().suited_to(standing.data)
    return effect, extend(data, standing, effect)


def test_the_share_of_the_rotor_in_an_inertia_shows_in_the_friction():
    _, found = with_friction(swings(), "pendulum")
    values = found.trial.parameters
    assert values["load_dependent_friction.link_share"] == pytest.approx(LINK / (LINK + ROTOR), abs=0.02)
    assert values["load_dependent_friction.mu"] == pytest.approx(0.3, abs=0.01)
    assert values["pendulum.inertia"] == pytest.approx(LINK + ROTOR, rel=0.01)
    assert found.rmse == pytest.approx(0.01, rel=0.05)


def test_without_a_weight_the_share_is_not_asked_for():
    """It would be the same as a smaller friction coefficient."""
    effect, found = with_friction(swings(weight=0.0), "inertia")
    assert [p.name for p in effect.inner] == ["transition"]
    share = LINK / (LINK + ROTOR)
    assert found.trial.parameters["load_dependent_friction.mu"] == pytest.approx(0.3 * share, rel=0.05)


def test_a_rotor_that_the_model_knows_of_does_not_load_the_gear():
    data = swings()
    known = {"rigid_body_torque": LINK * data.acceleration + WEIGHT * np.sin(data.position)}
    names = ("rigid_body", "armature", "load_dependent_friction")
    model = Model("rigid_body", tuple(EFFECTS[name]() for name in names))
    found = stand(replace(data, context=known), model, {"load_dependent_friction.transition": 0.02})
    assert found.trial.parameters["armature.inertia"] == pytest.approx(ROTOR, rel=0.01)
    assert found.trial.parameters["load_dependent_friction.mu"] == pytest.approx(0.3, abs=0.01)
    assert found.rmse == pytest.approx(0.01, rel=0.05)
