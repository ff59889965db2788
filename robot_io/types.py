"""Data of one tick between robot, guard and controller. SI units; arrays are read-only.

Records are named tuples: immutable like a frozen dataclass, and faster to make.
"""

from enum import IntEnum
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.robot_io.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Status(IntEnum):
    """Whether, and how far, a sample can be used."""

    OK = 0
    STALE = 1  # no new sample since the one returned before; its age is in `sampled_at_s`
    SATURATED = 2  # the device reports the end of its range
    FAULT = 3  # the device reports an error; the value means nothing


class Reading(NamedTuple):
    """One device's newest sample."""

    # Code that runs in every tick builds a new one, because `_replace` takes several times as long.

    value: FloatArray  # shape (n,), n joints, or (1,) for the force sensor; unit of the device's interface
    sampled_at_s: float  # when the device itself sampled, on the robot's clock [s]
    status: Status = Status.OK  # whether the sample can be used
    # For each value, whether it is the end of the device's range; empty if unknown.
    saturated: tuple[bool, ...] = ()


class Measurement(NamedTuple):
    """All measurements of one tick."""

    time_s: float  # start of the tick on the robot's clock [s]
    joint_position_rad: FloatArray  # shape (n,) [rad]; [m] for a prismatic joint
    joint_velocity_rad_s: FloatArray  # shape (n,) [rad/s]
    joint_torque_nm: FloatArray  # shape (n,), as measured by the drives, positive along the joint axis [N m]
    force_n: float  # contact force along the sensor axis, positive in compression [N]
    encoder_at_s: float  # when the encoders were sampled [s]
    torque_at_s: float  # when the torques were sampled [s]
    force_at_s: float  # when the force was sampled [s]
    encoder_status: Status = Status.OK  # status of position and velocity
    torque_status: Status = Status.OK  # status of the torque
    force_status: Status = Status.OK  # status of the force
    torque_saturated: tuple[bool, ...] = ()  # for each torque, whether it is the end of its drive's range


class Command(NamedTuple):
    """Command of one tick."""

    joint_torque_nm: FloatArray  # shape (n,), positive along the joint axis [N m]


def frozen_array(
    values: ArrayLike, shape: tuple[int, ...] | None = None, *, what: str = "array"
) -> FloatArray:
    """Copy values into a read-only float array; raise `InputError` for another shape or if not finite.

    Args:
        values: few numbers.
        shape: required shape; None for any.
        what: name of the array in errors.
    """
    array = np.array(values, dtype=np.float64)
    if shape is not None and array.shape != shape:
        raise InputError(f"{what}: shape {array.shape}, expected {shape}")
    if not all(map(isfinite, array.ravel().tolist())):
        raise InputError(f"{what}: contains a value that is not finite: {array.tolist()}")
    array.setflags(write=False)
    return array


def clip(value: float, low: float, high: float) -> float:
    """Clip a number to bounds; several times as fast as numpy for the few numbers of an arm.

    Args:
        value: the number; NaN stays NaN.
        low: lower bound.
        high: upper bound.
    """
    return low if value < low else high if value > high else value
