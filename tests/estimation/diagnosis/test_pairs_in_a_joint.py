"""Two effects in one joint, of which no smooth law of the motion shows the second, or the first hides it."""

import numpy as np
import pytest

from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.models import MODELS

STEP_S, NOISE_NM, RUNS = 0.01, 0.02, 5
TIMES_S = np.arange(0.0, 8.0, STEP_S)


def nothing(q, v):
    return np.zeros_like(q)


def as_it_is(effort):
    return effort


def pendulum(seed, extra=nothing, sensor=as_it_is):
    """A pendulum that swings through several runs, with `extra` torque, its sum read by `sensor`."""
    rng = np.random.default_rng(seed)
    w, p = rng.uniform([0.6, 2.0, 4.0], [1.2, 3.0, 6.0], (RUNS, 3)), rng.uniform(0.0, 6.0, (RUNS, 3))
    waves = w[:, :, None] * TIMES_S + p[:, :, None]
    size = np.array([0.8, 0.5, 0.2])[:, None]
    q, v = (size * np.sin(waves)).sum(1), (size * w[:, :, None] * np.cos(waves)).sum(1)
    a = -(size * w[:, :, None] ** 2 * np.sin(waves)).sum(1)
    effort = sensor(0.05 * a + 2.0 * np.sin(q) + 0.15 * v + extra(q, v))
    return q, v, a, effort, rng


def channel(q, v, a, effort):
    run = np.repeat(np.arange(RUNS), len(TIMES_S))
    time_s, unknown = np.tile(TIMES_S, RUNS) + 20.0 * run, np.full(run.size, -1)
    columns = (part.ravel() for part in (q, v, a, effort))
    return ChannelData("joint_1", ChannelKind.REVOLUTE, time_s, *columns, run, unknown)


def answer(data, *tried):
    model, effects = MODELS["pendulum"]().build(ModelContext()), [EFFECTS[name]() for name in tried]
    found = diagnose(data, model, effects, rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.MISSING
    return found


def named(found):
    return {entry.effect: entry.parameters for entry in found.accepted}


def late(effort):
    """Twelve samples late; before that, the first value."""
    return np.concatenate([np.repeat(effort[:, :1], 12, axis=1), effort[:, :-12]], axis=1)


def test_a_ripple_is_found_behind_a_long_delay():
    # nothing that is smooth over the present position shows what the position was long ago
    q, v, a, effort, rng = pendulum(1, lambda q, v: 0.3 * np.sin(20.0 * q), late)
    noisy = effort + rng.normal(0.0, NOISE_NM, effort.shape)
    found = named(answer(channel(q, v, a, noisy), "delay", "torque_ripple", "lag", "joint_spring"))
    assert set(found) == {"delay", "torque_ripple"}
    assert found["delay"]["time"].value == pytest.approx(0.12, abs=0.002)
    assert found["torque_ripple"]["cycles"].value == pytest.approx(20.0, rel=0.01)


def test_a_friction_that_swallowed_another_is_weighed_beside_it_once_both_are_fitted():
    def rubbing(q, v):
        return np.tanh(v / 0.005) * (0.2 + 0.3 * np.exp(-((v / 0.25) ** 2))) + 0.3 * v * np.abs(v)

    q, v, a, effort, rng = pendulum(2, rubbing)
    noisy = effort + rng.normal(0.0, NOISE_NM, effort.shape)
    tried = ("stribeck_friction", "quadratic_friction", "coulomb_friction", "joint_spring")
    found = named(answer(channel(q, v, a, noisy), *tried))
    assert set(found) == {"stribeck_friction", "quadratic_friction"}
    assert found["quadratic_friction"]["d2"].value == pytest.approx(0.3, rel=0.1)


def test_steps_of_a_reading_are_seen_beside_a_spring_and_no_smooth_law_does_better():
    q, v, a, effort, rng = pendulum(3, lambda q, v: 6.0 * q)
    noisy = effort + rng.normal(0.0, NOISE_NM, effort.shape)
    stepped = 0.5 * np.round(noisy / 0.5)
    found = named(answer(channel(q, v, a, stepped), "joint_spring", "quantisation", "bias"))
    assert set(found) == {"joint_spring", "quantisation"}
    assert found["quantisation"]["step"].value == pytest.approx(0.5, rel=0.01)
    assert found["quantisation"]["noise"].value == pytest.approx(NOISE_NM, rel=0.4)


def test_a_spring_is_told_from_one_that_stiffens_once_the_friction_beside_it_is_known():
    q, v, a, effort, rng = pendulum(5, lambda q, v: 6.0 * q + 0.35 * np.tanh(v / 0.005))
    noisy = effort + rng.normal(0.0, NOISE_NM, effort.shape)
    tried = ("cubic_stiffness", "joint_spring", "coulomb_friction", "bias")
    found = named(answer(channel(q, v, a, noisy), *tried))
    assert set(found) == {"joint_spring", "coulomb_friction"}


def test_parameters_that_make_up_for_each_other_have_no_interval():
    # uneven friction has viscous parts of its own: with those of the model only sums are determined
    def uneven(q, v):
        return np.where(v > 0.0, 0.3 + 0.2 * v, -0.15 + 0.05 * v)

    q, v, a, effort, rng = pendulum(4, uneven)
    noisy = effort + rng.normal(0.0, NOISE_NM, effort.shape)
    fitted = answer(channel(q, v, a, noisy), "asymmetric_friction").final.parameters
    assert fitted["viscous_friction.d"].std_err is None
    assert fitted["asymmetric_friction.viscous_forward"].std_err is None
    assert fitted["asymmetric_friction.forward"].std_err < 0.01
    total = fitted["viscous_friction.d"].value + fitted["asymmetric_friction.viscous_forward"].value
    assert total == pytest.approx(0.35, abs=0.02)
