"""What a tilted base does to an arm whose masses are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sim_backend
from control.arm.rigid_body import RigidBody
from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis import Verdict, diagnose
from estimation.effects import EFFECTS
from estimation.effects.gravity_load import KnownRigidBody
from estimation.model import Model
from estimation.signals.arm_signals import with_rigid_body

URDF = Path(sim_backend.__file__).parent / "arms/follower/follower.urdf"
HOME_RAD = np.array([0.87, -1.47, -0.98])
STEP_S, RUNS = 0.01, 3


def swinging(joint, dip_rad, swing_rad=0.1, noise_nm=0.0):
    """Slow swings of an arm whose base dips towards its front, which its model does not know."""
    t = np.arange(0.0, 4.0, STEP_S)
    swings = [HOME_RAD + swing_rad * np.sin(np.outer(t, [1.3, 1.7, 2.1]) + run) for run in range(RUNS)]
    q = np.concatenate(swings)
    v = np.concatenate([np.gradient(swing, STEP_S, axis=0) for swing in swings])
    a = np.concatenate([np.gradient(speed, STEP_S, axis=0) for speed in np.split(v, RUNS)])
    tilted = RigidBody.from_urdf(URDF, "tip", 9.81 * np.array([np.sin(dip_rad), 0.0, -np.cos(dip_rad)]))
    torque = np.array([tilted.inverse_dynamics(*rows)[joint] for rows in zip(q, v, a, strict=True)])
    torque += np.random.default_rng(4).normal(0.0, 1.0, len(torque)) * noise_nm
    run = np.repeat(np.arange(RUNS), len(t))
    context = {"joint_position": q, "joint_velocity": v, "joint_acceleration": a}
    motion = (np.tile(t, RUNS), q[:, joint], v[:, joint], a[:, joint])
    name = f"joint_{joint + 1}"
    data = ChannelData(name, ChannelKind.REVOLUTE, *motion, torque, run, np.full(len(run), -1), context)
    return with_rigid_body(data, RigidBody.from_urdf(URDF, "tip"), joint)


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("dip_rad", [0.14, -0.6])
def test_a_turned_base_takes_what_a_turned_gravity_takes(joint, dip_rad):
    data = swinging(joint, dip_rad)
    tilt = EFFECTS["gravity_tilt"]().suited_to(data)
    added = tilt.known(data, {"tilt": dip_rad})  # about y, though the follower's joints turn about -y
    np.testing.assert_allclose(data.effort - data.context["rigid_body_torque"], added, atol=1e-9)


def test_a_tilt_is_no_spring_though_the_joint_moves_little():
    """A tenth of a radian of swing, and 1 % of the weight that the tilt takes off: more than half of it."""
    data = swinging(0, dip_rad=0.14, noise_nm=0.01)
    found = diagnose(data, Model("arm", (KnownRigidBody(),)), rng=np.random.default_rng(1)).channels[0]
    assert found.verdict is Verdict.MISSING
    (entry,) = found.accepted
    assert entry.effect == "gravity_tilt"
    tilt = entry.parameters["tilt"]
    assert tilt.unit == "rad"
    assert abs(tilt.value - 0.14) < 3.0 * tilt.std_err < 0.03


def test_no_joint_of_an_arm_is_taken_for_a_pendulum_on_a_tilted_base():
    """What a tilt takes is not computed where the first axis is not level: then nothing is said of it."""
    arm, tilt = swinging(1, dip_rad=0.0), EFFECTS["gravity_tilt"]()
    lacking = {k: v for k, v in arm.context.items() if k not in {"tilt_effort_per_rad", "weight_effort"}}
    assert tilt.applies_to(arm)
    assert not tilt.applies_to(replace(arm, context=lacking))
    assert tilt.applies_to(replace(arm, context={}))  # a single joint
