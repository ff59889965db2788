"""What a joint spends on pressing with the tip."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sim_backend
from control.arm.rigid_body import RigidBody
from estimation.channel import ChannelData, ChannelKind
from estimation.effects import EFFECTS
from estimation.signals.arm_signals import with_rigid_body

URDF = Path(sim_backend.__file__).parent / "arms/follower/follower.urdf"
PRESS = np.array([0.0, 0.0, -1.0])


@pytest.fixture
def body():
    return RigidBody.from_urdf(URDF, "tip")


def resting(joint, force_n, n=5):
    """An arm that stands still in random postures and presses downwards."""
    rng = np.random.default_rng(3)
    zeros, q = np.zeros(n), rng.uniform(-1, 1, (n, 3))
    context = {
        "joint_position": q,
        "joint_velocity": np.zeros((n, 3)),
        "joint_acceleration": np.zeros((n, 3)),
        "contact_force": np.full(n, force_n),
        "press_direction_world": np.tile(PRESS, (n, 1)),
    }
    return ChannelData(
        f"joint_{joint + 1}",
        ChannelKind.REVOLUTE,
        np.arange(n) * 0.1,
        q[:, joint],
        zeros,
        zeros,
        zeros,
        zeros.astype(int),
        zeros.astype(int),
        context,
    )


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_the_work_of_the_joints_is_the_work_of_the_tip(body, joint):
    """A small turn moves the tip by d; the torque for the pressing does the force's work along d."""
    step = 1e-6
    data = with_rigid_body(resting(joint, 7.0), body, joint)
    bare = with_rigid_body(resting(joint, 0.0), body, joint)
    extra = EFFECTS["rigid_body"]().known(data, {}) - EFFECTS["rigid_body"]().known(bare, {})
    for q, torque in zip(data.context["joint_position"], extra, strict=True):
        turned = q.copy()
        turned[joint] += step
        moved = body.tip_pose(turned)[0] - body.tip_pose(q)[0]
        assert torque * step == pytest.approx(7.0 * moved @ PRESS, abs=1e-9)


def test_fitted_masses_leave_the_pressing_to_the_force_sensor(body):
    data = with_rigid_body(resting(0, 7.0), body, 0, regressor=True)
    fitted, given = EFFECTS["rigid_body_fitted"](), EFFECTS["rigid_body"]()
    pressing = given.known(data, {}) - data.context["rigid_body_torque"]
    np.testing.assert_allclose(fitted.known(data, {}), pressing)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_the_other_joints_say_what_the_force_sensor_misses(body, joint):
    """The tip is pressed by more than the sensor reads; what the joint itself carries says nothing of it."""
    n, rng = 1200, np.random.default_rng(4)
    still, missed = resting(joint, 7.0, n), 0.8 * np.sin(np.linspace(0.0, 12.0, n))
    q = np.tile([0.3, -0.7, 0.4], (n, 1))
    pushed = np.array([body.tip_jacobian(row)[:3].T @ PRESS for row in q]) * (7.0 + missed)[:, None]
    torque = body.inverse_dynamics_along(q, 0.0 * q, 0.0 * q) + pushed
    torque += rng.normal(0.0, [0.02, 0.01, 0.005], q.shape)
    torque[:, joint] = rng.normal(0.0, 5.0, n)
    touching = np.append(np.zeros(200), np.ones(n - 200))
    reading = np.where(touching, 7.0, 0.3)  # a sensor that has drifted in free air
    known = {"joint_position": q, "joint_torque": torque, "touching": touching, "contact_force": reading}
    data = replace(still, time_s=0.001 * np.arange(n), context={**still.context, **known})
    found = with_rigid_body(data, body, joint).context["force_beyond_reading"]
    assert found[:170] == pytest.approx(-0.3)
    assert np.sqrt(np.mean((found - missed)[230:] ** 2)) < 0.05


def test_joints_without_a_lever_say_nothing_of_the_force(body):
    """Links in line, pressed along that line: two joints carry noise only, and a lever of next to nothing."""
    n, rng = 400, np.random.default_rng(5)
    q = np.tile([0.3, 0.5, 0.0], (n, 1))
    jacobian = body.tip_jacobian(q[0])[:3]
    along = np.cross(jacobian[:, 1], body.joint_axes()[1].axis_world) / np.linalg.norm(jacobian[:, 1])
    along += 1e-6 * jacobian[:, 1] / np.linalg.norm(jacobian[:, 1])
    assert np.abs(jacobian[:, 1:].T @ along).max() < 1e-5
    torque = body.inverse_dynamics_along(q, 0.0 * q, 0.0 * q) + 5.0 * jacobian.T @ along
    known = {"joint_position": q, "joint_torque": torque + rng.normal(0.0, 0.01, q.shape)}
    known |= {"touching": np.ones(n), "press_direction_world": np.tile(along, (n, 1))}
    pressed = resting(0, 5.0, n)
    data = replace(pressed, time_s=0.001 * np.arange(n), context={**pressed.context, **known})
    assert np.abs(with_rigid_body(data, body, 0).context["force_beyond_reading"]).max() < 0.1
