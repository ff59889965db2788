"""What one joint of an arm carries, computed along its motion by the rigid-body model."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from estimation.channel import ChannelData
from estimation.signals.runwise import steadied
from estimation.signals.shifted_motion import BY_ACCELERATION, BY_POSITION
from robot_io.errors import InputError
from robot_io.types import FloatArray

if TYPE_CHECKING:
    from control.arm.rigid_body import RigidBody

TORQUE = "rigid_body_torque"
REGRESSOR = "rigid_body_regressor"
PAYLOAD = "payload_effort_per_kg"
TOUCH = "contact_torque"
LEVER = "contact_torque_per_newton"
BEYOND = "force_beyond_reading"
TILT = "tilt_effort_per_rad"
WEIGHT = "weight_effort"
_MOTION = ("joint_position", "joint_velocity", "joint_acceleration")
Motion = tuple[
    FloatArray, FloatArray, FloatArray
]  # of all joints: position, velocity, acceleration, (n, joints)
Dynamics = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
_STEP_RAD = 1e-4


def with_rigid_body(
    data: ChannelData, body: "RigidBody", joint: int, *, regressor: bool = False
) -> ChannelData:
    """The channel of one joint with what the rigid body takes there.

    Adds `rigid_body_torque` (n,) [N m] (and `rigid_body_regressor` (n, 10 joints)) with its derivatives by
    the joint's own position and acceleration, `payload_effort_per_kg` (n,), and, where the first joint is
    level, `weight_effort` (n,), what the weight across that axis takes, and `tilt_effort_per_rad` (n,), its
    change with a turn of the base about the axis, counted about world x or y, whichever is nearer. Where the
    tip's contact force is known, `contact_torque` (n,) is what the joint spends on pressing,
    `contact_torque_per_newton` (n,) its lever, and where all torques are, `force_beyond_reading` (n,) [N] is
    what the other joints carry of the tip's force beyond what its sensor says; nothing acts in free air.

    Raises:
        InputError: the context lacks the motion of all joints, or their number differs from the body's.
    """
    missing = [name for name in _MOTION if name not in data.context]
    if missing:
        raise InputError(f"channel '{data.name}': the rigid body needs {', '.join(missing)} of all joints")
    q, v, a = (data.context[name].reshape(len(data), -1) for name in _MOTION)
    if q.shape[1] != body.joint_count:
        raise InputError(
            f"channel '{data.name}': motion of {q.shape[1]} joints, but the URDF has {body.joint_count}"
        )
    context = dict(data.context)
    if regressor:
        context |= _with_slopes(REGRESSOR, partial(_regressor, body, joint), (q, v, a), joint)
    context |= _with_slopes(TORQUE, partial(_torque, body, joint), (q, v, a), joint)
    context[PAYLOAD] = _torque(body.with_load(1.0), joint, q, v, a) - context[TORQUE]
    if "contact_force" in data.context:
        levers = _levers(body, data)
        context[LEVER] = levers[:, joint]
        context[TOUCH] = context[LEVER] * data.context["contact_force"]
        if "joint_torque" in data.context:
            left = data.context["joint_torque"] - body.inverse_dynamics_along(q, v, a)
            others = np.delete(np.arange(body.joint_count), joint)
            context[BEYOND] = _beyond_reading(data, levers[:, others], left[:, others])
    axis = body.joint_axes()[0].axis_world
    if abs(axis[2]) < 1e-6:
        quarter = np.zeros(body.joint_count)
        quarter[0] = 0.5 * np.pi * np.sign(axis[np.argmax(np.abs(axis))])
        rest = np.zeros_like(q)
        here, ahead, over, behind = (
            _torque(body, joint, q + turns * quarter, rest, rest) for turns in range(4)
        )
        context[TILT], context[WEIGHT] = 0.5 * (ahead - behind), 0.5 * (here - over)
    return replace(data, context=context)


def _with_slopes(name: str, dynamics: Dynamics, motion: Motion, joint: int) -> dict[str, FloatArray]:
    """A signal along the motion with its derivatives by one joint's position and acceleration."""
    q, v, a = motion
    step = np.zeros(q.shape[1])
    step[joint] = 1.0

    def along(dq: float, da: float) -> FloatArray:
        return dynamics(q + dq * step, v, a + da * step)

    here = along(0.0, 0.0)
    return {
        name: here,
        name + BY_POSITION: (along(_STEP_RAD, 0.0) - along(-_STEP_RAD, 0.0)) / (2.0 * _STEP_RAD),
        name + BY_ACCELERATION: along(0.0, 1.0) - here,
    }


def _torque(body: "RigidBody", joint: int, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """What the arm takes at one joint, shape (n,)."""
    return body.inverse_dynamics_along(q, v, a)[:, joint]


def _regressor(body: "RigidBody", joint: int, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """One joint's rows of the regressor, shape (n, 10 joints)."""
    return np.array([body.regressor(*rows)[joint] for rows in zip(q, v, a, strict=True)])


def _beyond_reading(data: ChannelData, levers: FloatArray, left: FloatArray) -> FloatArray:
    """Force at the tip beyond its reading (n,) [N], by torques that no link takes; in free air there is none.

    Each joint counts by its lever and its noise, which its neighbouring samples tell. Where none has a lever
    they say nothing: the reading is hardly off by more than the largest one (a normal prior).

    Args:
        data: any joint's channel.
        levers: torques per newton at the tip, shape (n, joints).
        left: torques, shape (n, joints).
    """
    touching, force = data.context["touching"], data.context["contact_force"]
    left = left - levers * force[:, None]
    weights = levers / np.maximum(np.var(np.diff(left, axis=0), axis=0), 1e-300)
    prior = 1.0 / np.maximum(np.max(force**2), 1e-300)
    beyond = np.sum(weights * left, axis=1) / (np.sum(weights * levers, axis=1) + prior)
    return steadied(np.where(touching, beyond, -force), data.time_s, data.run)


def _levers(body: "RigidBody", data: ChannelData) -> FloatArray:
    """Torques (n, joints) that press with one newton: J^T p, p the press direction."""
    jacobians = np.array([body.tip_jacobian(row)[:3] for row in data.context["joint_position"]])
    torque: FloatArray = np.einsum("nij,ni->nj", jacobians, data.context["press_direction_world"])
    return torque
