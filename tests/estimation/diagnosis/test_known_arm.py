"""An arm whose masses are known shows what is wrong with a sensor that a fit could not."""

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects.rigid_body import RigidBody
from estimation.gate.gate import refuse
from estimation.model import Model
from estimation.models import MODELS

LIMIT_NM = 0.8
ARM = Model("arm", (RigidBody(),))


def carrying():
    """A joint that carries 0.5 to 3.5 N m, read by a sensor that ends at 0.8 N m."""
    rng, step, runs = np.random.default_rng(5), 0.01, 5
    t = np.arange(0.0, 8.0, step)
    q = np.array([np.sin(w * t + p) for w, p in rng.uniform(1.0, 3.0, (runs, 2))])
    v = np.gradient(q, step, axis=1)
    a = np.gradient(v, step, axis=1)
    load = (2.0 + 1.5 * q + 0.01 * a).ravel()
    reading = np.minimum(load + rng.normal(0.0, 0.02, load.size), LIMIT_NM)
    run = np.repeat(np.arange(runs), len(t))
    time_s, unknown = np.tile(t, runs) + 20.0 * run, np.full(run.size, -1)
    motion = (q.ravel(), v.ravel(), a.ravel())
    context = {"rigid_body_torque": load}
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, *motion, reading, run, unknown, context)


def test_the_end_of_a_sensor_s_range_is_found_where_the_load_is_known():
    found = diagnose(carrying(), ARM, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.MISSING
    (entry,) = found.accepted
    assert entry.effect == "saturation"
    assert entry.parameters["limit"].value == pytest.approx(LIMIT_NM, rel=0.01)


def test_what_has_to_be_fitted_needs_readings_below_that_end():
    pendulum = MODELS["pendulum"]().build(ModelContext())
    assert "at its end" in refuse(carrying(), pendulum)
    assert refuse(carrying(), ARM) is None
