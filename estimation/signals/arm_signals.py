"""Signals of one joint from the rigid-body model of its arm, along the recorded motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.signals.cache_by_array import cache_by_array
from palpate.estimation.signals.runwise import (
    BY_ACCELERATION,
    BY_POSITION,
    TWICE_BY_POSITION,
    smooth_jitter,
)
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, IntArray

if TYPE_CHECKING:
    from palpate.control.arm.rigid_body import RigidBody

TORQUE = "rigid_body_torque"
REGRESSOR = "rigid_body_regressor"
PAYLOAD = "payload_effort_per_kg"
CONTACT_TORQUE = "contact_torque"
CONTACT_LEVER = "contact_torque_per_newton"
UNREAD_FORCE = "force_beyond_reading"
TILT = "tilt_effort_per_rad"
WEIGHT = "weight_effort"
TURNED = "weight_effort_turned"
ZERO = "effort_by_positions"
ZERO_TWICE = "effort_twice_by_positions"
ARM_MOTION = ("joint_position", "joint_velocity", "joint_acceleration")
Motion = tuple[FloatArray, FloatArray, FloatArray]  # position, velocity, acceleration, each (n, joints)
Dynamics = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
_STEP_RAD = 1e-4
_WIDE_STEP_RAD = 1e-3


@dataclass(frozen=True)
class _ArmTorques:
    """Torques of all joints along a motion, each of shape (n, joints)."""

    rigid_body: FloatArray  # [N m]
    payload: FloatArray  # by a mass at the tip [N m/kg]
    tilt: dict[str, FloatArray]  # signals of a rotation of the base, see `with_rigid_body`


def with_rigid_body(
    data: ChannelData, body: "RigidBody", joint: int, *, regressor: Sequence[int] | IntArray = ()
) -> ChannelData:
    """Add signals of the rigid-body model to the channel of one joint.

    The function always adds `rigid_body_torque` (n,) [N m] with its derivatives by the joint's position and
    acceleration, and `payload_effort_per_kg` (n,) [N m/kg].

    If the axis of the first joint is level, it adds `weight_effort` (n,) [N m], the torque of the weight
    perpendicular to that axis. It also adds `tilt_effort_per_rad` (n,) [N m/rad], its derivative by a
    rotation of the base about the axis, with the sign of the nearer world axis (x or y).
    Otherwise, it adds `weight_effort_turned` (n, 3) [N m]: the torques of the weight with the base turned by
    a quarter about y, by a quarter about x, and not at all.

    If the contact force is known, it adds `contact_torque` (n,) [N m], the torque of that force, and its
    lever `contact_torque_per_newton` (n,) [m]. If the torques of all joints are known too, it adds
    `force_beyond_reading` (n,) [N]: the part of the tip's force that acts on the other joints but is missing
    in the force sensor's reading.

    Without a regressor, it adds the derivatives of `rigid_body_torque` plus `contact_torque` by the positions
    of all joints: `effort_by_positions` (n, joints), zero for prismatic joints, and
    `effort_twice_by_positions` (n, pairs), with the pairs of joints in the order of `numpy.triu_indices`.

    Args:
        data: the channel.
        body: the arm.
        joint: index of the joint, from 0.
        regressor: columns of the joint's regressor to add as `rigid_body_regressor` (n, columns), with its
            derivatives; see `RigidBody.joint_regressor`.

    Raises:
        InputError: the context lacks the motion of all joints, or their number differs from the body's.
    """
    missing = [name for name in ARM_MOTION if name not in data.context]
    if missing:
        raise InputError(f"channel '{data.name}': a rigid body needs {', '.join(missing)} of all joints")
    q, v, a = (data.context[name].reshape(len(data), -1) for name in ARM_MOTION)
    if q.shape[1] != body.joint_count:
        raise InputError(
            f"channel '{data.name}': motion of {q.shape[1]} joints, but the URDF has {body.joint_count}"
        )
    context = dict(data.context)
    if len(regressor):

        def chosen(*motion: FloatArray) -> FloatArray:
            return body.joint_regressor(joint, *motion)[:, regressor]

        context |= _with_slopes(REGRESSOR, chosen, (q, v, a), joint)
    motion = tuple(data.context[name] for name in ARM_MOTION)
    arm = _arm_torques(body, *motion)

    def torque(*motion: FloatArray) -> FloatArray:
        return body.inverse_dynamics_batch(*motion)[:, joint]

    context |= _with_slopes(TORQUE, torque, (q, v, a), joint, arm.rigid_body[:, joint])
    context[PAYLOAD] = arm.payload[:, joint]
    changes = None if len(regressor) else [torques[:, joint] for torques in _by_positions(body, *motion)]
    if "contact_force" in data.context:
        force_n, direction = data.context["contact_force"], data.context["press_direction_world"]
        jacobians = _tip_jacobians(body, data.context["joint_position"])
        levers_m: FloatArray = np.einsum("nij,ni->nj", jacobians[:, :3], direction)
        context[CONTACT_LEVER] = levers_m[:, joint]
        context[CONTACT_TORQUE] = context[CONTACT_LEVER] * force_n
        if changes:
            levers = _levers_by_positions(jacobians, direction, joint)
            changes = [
                torques + lever * force_n[:, None] for torques, lever in zip(changes, levers, strict=True)
            ]
        if "joint_torque" in data.context:
            unexplained = data.context["joint_torque"] - arm.rigid_body
            others = np.delete(np.arange(body.joint_count), joint)
            context[UNREAD_FORCE] = _unread_force(data, levers_m[:, others], unexplained[:, others])
    if changes:
        turning = [axis.revolute for axis in body.joint_axes()]
        context |= {ZERO: changes[0] * turning, ZERO_TWICE: changes[1]}
    context |= {name: torques[:, joint] for name, torques in arm.tilt.items()}
    return replace(data, context=context)


@cache_by_array
def _arm_torques(
    body: "RigidBody", position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> _ArmTorques:
    """Compute the torques along a motion, (n, joints) or (n,) each, once for all channels of an arm."""
    q, v, a = (values.reshape(len(values), -1) for values in (position, velocity, acceleration))
    rigid_body = body.inverse_dynamics_batch(q, v, a)
    payload = body.with_load(1.0).inverse_dynamics_batch(q, v, a) - rigid_body
    axis = body.joint_axes()[0].axis_world
    if abs(axis[2]) >= 1e-6:
        x, y, z = body.gravity_m_s2
        turned = np.array([[-z, 0.0, x], [0.0, z, -y], [x, y, z]])
        per_gravity = body.inertial_and_gravity_torques(q, v, a)[1].reshape(*q.shape, 3)  # also of one joint
        return _ArmTorques(rigid_body, payload, {TURNED: per_gravity @ turned.T})
    quarter = np.zeros(body.joint_count)
    quarter[0] = 0.5 * np.pi * np.sign(axis[np.argmax(np.abs(axis))])
    zero = np.zeros_like(q)
    at_0, at_90, at_180, at_270 = (
        body.inverse_dynamics_batch(q + turns * quarter, zero, zero) for turns in range(4)
    )
    tilt = {TILT: 0.5 * (at_90 - at_270), WEIGHT: 0.5 * (at_0 - at_180)}
    return _ArmTorques(rigid_body, payload, tilt)


@cache_by_array
def _by_positions(
    body: "RigidBody", position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Differentiate torques by joint positions once and twice, (n, joints, joints) and (n, joints, pairs)."""
    q, v, a = (values.reshape(len(values), -1) for values in (position, velocity, acceleration))
    steps = _WIDE_STEP_RAD * np.eye(body.joint_count)

    def change(step: FloatArray) -> FloatArray:
        return body.inverse_dynamics_batch(q + step, v, a) - here

    here = body.inverse_dynamics_batch(q, v, a)
    once = [change(step) for step in steps]
    twice = {
        (j, k): change(steps[j] + steps[k]) - once[j] - once[k]
        for j, k in combinations_with_replacement(range(len(steps)), 2)
    }
    slopes = [first - 0.5 * twice[j, j] for j, first in enumerate(once)]  # with an error of third order
    pairs = np.stack(list(twice.values()), axis=-1)
    return np.stack(slopes, axis=-1) / _WIDE_STEP_RAD, pairs / _WIDE_STEP_RAD**2


@cache_by_array
def _tip_jacobians(body: "RigidBody", position: FloatArray) -> FloatArray:
    """Compute the Jacobians of the tip in world axes, (n, 6, joints), see `RigidBody.tip_jacobian`."""
    return np.array([body.tip_jacobian(row) for row in position.reshape(len(position), -1)])


def _levers_by_positions(
    jacobians: FloatArray, direction: FloatArray, joint: int
) -> tuple[FloatArray, FloatArray]:
    """Differentiate the torque per newton that a tool measures along a direction p by joint positions.

    The derivatives of the tip x by joints i <= j <= k are dx/dk = J_k, w_j x J_k and w_i x (w_j x J_k), with
    the columns J of the Jacobian and the axes w of revolute joints (zero for prismatic ones). A tool at an
    angle to p measures only the component of the force along its axis. The second derivative of this
    component by the positions of joints j and k is -(w_j x p) (w_k x p) times the force, so the lever per
    measured newton grows by the opposite.

    Args:
        jacobians: Jacobians of the tip in world axes, (n, 6, joints).
        direction: press directions p in world axes, (n, 3).
        joint: joint of the torque, from 0.

    Returns:
        First and second derivatives, (n, joints) [m/rad] and (n, pairs) [m/rad^2].
    """
    tip, axes = jacobians[:, :3].transpose(2, 0, 1), jacobians[:, 3:].transpose(2, 0, 1)

    def lever(*joints: int) -> FloatArray:
        *turning, last = sorted((joint, *joints))
        moved = tip[last]
        for index in reversed(turning):
            moved = np.cross(axes[index], moved)
        along: FloatArray = np.einsum("ni,ni->n", moved, direction)
        return along

    turned, joints = np.cross(axes, direction), range(len(tip))
    twice = [
        lever(j, k) + lever() * np.einsum("ni,ni->n", turned[j], turned[k])
        for j, k in combinations_with_replacement(joints, 2)
    ]
    return np.stack([lever(j) for j in joints], axis=-1), np.stack(twice, axis=-1)


def _with_slopes(
    name: str, dynamics: Dynamics, motion: Motion, joint: int, values: FloatArray | None = None
) -> dict[str, FloatArray]:
    """Return a signal along the motion and its derivatives by one joint's position and acceleration."""
    q, v, a = motion
    axis = np.zeros(q.shape[1])
    axis[joint] = 1.0

    def signal_at(dq: float, da: float) -> FloatArray:
        return dynamics(q + dq * axis, v, a + da * axis)

    values = signal_at(0.0, 0.0) if values is None else values
    ahead, behind = (signal_at(side * _STEP_RAD, 0.0) for side in (1.0, -1.0))
    return {
        name: values,
        name + BY_POSITION: (ahead - behind) / (2.0 * _STEP_RAD),
        name + TWICE_BY_POSITION: (ahead - 2.0 * values + behind) / _STEP_RAD**2,
        name + BY_ACCELERATION: signal_at(0.0, 1.0) - values,
    }


def _unread_force(data: ChannelData, levers_m: FloatArray, unexplained: FloatArray) -> FloatArray:
    """Estimate the force at the tip minus its reading from torques that the rigid bodies do not explain.

    Joints are weighted by their levers and their noise, estimated from neighboring samples. A normal prior
    with the size of the largest reading bounds the result if no joint has a lever. In free air the true force
    is zero.
    """
    in_contact, force_n = data.context["touching"], data.context["contact_force"]
    unexplained = unexplained - levers_m * force_n[:, None]
    weights = levers_m / np.maximum(np.var(np.diff(unexplained, axis=0), axis=0), 1e-300)
    prior = 1.0 / np.maximum(np.max(force_n**2), 1e-300)
    unread_n = np.sum(weights * unexplained, axis=1) / (np.sum(weights * levers_m, axis=1) + prior)
    return smooth_jitter(np.where(in_contact, unread_n, -force_n), data.time_s, data.run)
