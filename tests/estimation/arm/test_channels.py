"""From joint channels and models to the equations of an arm, and columns that belong to all its joints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sim_backend
from control.arm.rigid_body import RigidBody
from estimation.arm.arm_columns import payload_columns, tilt_columns
from estimation.arm.base_parameters import base_parameters
from estimation.arm.channels import rows_of_channels
from estimation.arm.identify import identify
from estimation.arm.rows import arm_rows
from estimation.base_model import ModelContext
from estimation.channel import ChannelData, ChannelKind
from estimation.effects import EFFECTS
from estimation.models import MODELS
from robot_io.calibration.applied import gravity_base_m_s2
from robot_io.errors import InputError
from tests.estimation.arm.panda import JOINTS, TIP, motion, panda, panda_urdf

FOLLOWER = Path(sim_backend.__file__).parent / "arms/follower/follower.urdf"


def arm_channels(seed=0, coulomb=0.4):
    """Joints of an arm as its URDF has it, with dry friction in all and 0.02 N m of noise."""
    rng = np.random.default_rng(seed)
    (q, v, a), run = motion(rng, runs=3, seconds=5.0)
    torque = panda().inverse_dynamics_along(q, v, a) + coulomb * np.sign(v) + rng.normal(0, 0.02, q.shape)
    context = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    time_s, phase = 0.01 * np.arange(len(q)), np.full(len(q), -1)
    return [
        ChannelData(
            f"joint_{j + 1}",
            ChannelKind.REVOLUTE,
            time_s,
            *(part[:, j] for part in (q, v, a, torque)),
            run=run,
            phase=phase,
            context=context,
        )
        for j in range(JOINTS)
    ]


def fitted_models():
    base, urdf = MODELS["rigid_body_fitted"](), panda_urdf()
    return [base.build(ModelContext(j, urdf, TIP)) for j in range(JOINTS)]


def test_every_joint_names_the_same_parameters():
    """A joint's columns times the arm's base parameters, by name, are its torque."""
    body, channels = panda(), arm_channels()
    base = base_parameters(body)
    value = dict(zip(base.names, base.grouping @ body.parameters, strict=True))
    torque = body.inverse_dynamics_along(
        *(channels[0].context[f"joint_{what}"] for what in ("position", "velocity", "acceleration"))
    )
    for joint in (0, 3, 6):
        model = fitted_models()[joint]
        ready = MODELS["rigid_body_fitted"]().prepare(channels[joint], ModelContext(joint, panda_urdf(), TIP))
        effect = model.effects[0]
        gains = np.array([value[gain.name] for gain in effect.gains])
        np.testing.assert_allclose(effect.columns(ready, {}) @ gains, torque[:, joint], atol=1e-8)


def test_models_of_all_joints_become_one_fit():
    body, channels = panda(), arm_channels()
    base = base_parameters(body)
    models = [model.with_effect(EFFECTS["coulomb_friction"]()) for model in fitted_models()]
    inner = [{"coulomb_friction.transition": 1e-6}] * JOINTS
    rows = rows_of_channels(channels, models, inner, body, base, block=2)
    found = identify(rows, base, body.parameters)
    viscous, coulomb = np.transpose(found.own)
    np.testing.assert_allclose(viscous, 0.0, atol=0.02)
    np.testing.assert_allclose(coulomb, 0.4, atol=0.02)
    np.testing.assert_allclose(found.sigma, 0.02 / np.sqrt(2), rtol=0.2)


def test_pressing_is_taken_off_before_the_masses_are_fitted():
    body, channels = panda(), arm_channels()
    base = base_parameters(body)
    free = rows_of_channels(channels, fitted_models(), [{}] * JOINTS, body, base)
    press = np.sin(np.arange(len(channels[0])))
    pressed = [
        replace(c, effort=c.effort + press, context={**c.context, "contact_torque": press}) for c in channels
    ]
    again = rows_of_channels(pressed, fitted_models(), [{}] * JOINTS, body, base)
    np.testing.assert_allclose(again.torque, free.torque, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda channels, models: (channels[:-1], models[:-1]), "6 joint channels"),
        (
            lambda channels, models: (channels, [models[0].with_effect(EFFECTS["lag"]()), *models[1:]]),
            "add torque",
        ),
        (lambda channels, models: ([*channels[:-1], channels[-1].select(np.arange(50))], models), "samples"),
        (lambda channels, models: ([replace(c, context={}) for c in channels], models), "joint_position"),
    ],
)
def test_says_what_it_cannot_use(change, words):
    body = panda()
    channels, models = change(arm_channels(), fitted_models())
    with pytest.raises(InputError, match=words):
        rows_of_channels(channels, models, [{}] * len(models), body, base_parameters(body))


def test_a_load_in_the_hand_is_one_mass_in_all_joints():
    """Its column is the difference that a point mass in the tip frame makes."""
    body = RigidBody.from_urdf(FOLLOWER, "tip")
    q, v, a = np.random.default_rng(1).uniform(-1, 1, (3, 30, body.joint_count))
    columns = payload_columns(body, q, v, a)
    heavier = body.with_load(0.3).inverse_dynamics_along(q, v, a) - body.inverse_dynamics_along(q, v, a)
    beside = body.with_load(0.3).parameters - body.parameters
    inertia = np.stack([body.regressor(*row)[:, -6:] for row in zip(q, v, a, strict=True)])
    np.testing.assert_allclose(columns @ beside[-10:-6] + inertia @ beside[-6:], heavier, atol=1e-9)


def test_tilt_columns_are_the_change_of_weight_with_the_base():
    body, angle = RigidBody.from_urdf(FOLLOWER, "tip"), 1e-4
    q = np.random.default_rng(2).uniform(-1, 1, (30, body.joint_count))
    rest = np.zeros_like(q)
    level = body.inverse_dynamics_along(q, rest, rest)
    columns = tilt_columns(body, q)
    for index, tilt in enumerate([(angle, 0.0), (0.0, angle)]):
        tilted = RigidBody.from_urdf(FOLLOWER, "tip", gravity_base_m_s2(*tilt))
        change = (tilted.inverse_dynamics_along(q, rest, rest) - level) / angle
        np.testing.assert_allclose(columns[:, :, index], change, atol=1e-3)


def test_a_tilt_shared_by_all_joints_is_found_beside_fitted_masses():
    body = panda()
    base, rng = base_parameters(body), np.random.default_rng(3)
    (q, v, a), run = motion(rng, seconds=5.0)
    tilted = body.with_gravity(gravity_base_m_s2(0.03, -0.02))
    torque = tilted.inverse_dynamics_along(q, v, a) + rng.normal(0, 0.05, q.shape)
    none = [np.zeros((len(q), 0))] * JOINTS
    rows = arm_rows(body, base, (q, v, a), torque, run=run, own=none, shared=tilt_columns(body, q))
    found = identify(rows, base, body.parameters)
    assert found.shared == pytest.approx([0.03, -0.02], abs=2e-3)
