"""Tasks of the loop: in each tick, a task computes a command from a measurement."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from palpate.robot_io.types import Command, FloatArray, Measurement

if TYPE_CHECKING:
    from palpate.control.arm.rigid_body import TipMotion
    from palpate.control.paths.trajectory import JointMotion


class Phase(IntEnum):
    """Phase of a task, as logged in every tick."""

    IDLE = 0  # active, holding still, no target
    MOVE = 1  # free motion between targets
    APPROACH = 2  # towards the object, not touching yet
    LOADING = 3  # in contact, moving in
    HOLD = 4  # in contact, force held
    UNLOADING = 5  # in contact, moving out
    RETRACT = 6  # contact lost, moving away from the object
    FREE_AIR = 7  # intentionally without contact, for the noise floor and the arm's own dynamics
    STOPPED = 8  # the safe state: the guard commands, not the task


IN_CONTACT = (Phase.LOADING, Phase.HOLD, Phase.UNLOADING)
NO_RUN = -1  # `run` between runs
_SPACE = (3,)


@dataclass(frozen=True, slots=True)
class TaskEvent:
    """An event worth a line in the session, such as the touch of the object."""

    kind: str  # short word for filters, such as "touch"
    text: str  # one sentence for people
    data: Mapping[str, object] | None = None  # values for programs (numbers, strings), if any


class TaskOutput(NamedTuple):
    """Command and reference of one tick."""

    command: Command  # joint torques; the guard may limit or replace them
    reference_position_rad: FloatArray  # shape (n,), where the joints should be [rad]
    reference_velocity_rad_s: FloatArray  # shape (n,), how fast they should move [rad/s]
    # shape (3,), measured tip (forward kinematics of the measured joints) [m].
    tip_position_world_m: FloatArray
    tip_velocity_world_m_s: FloatArray  # shape (3,), measured tip velocity [m/s]
    press_direction_world: FloatArray  # shape (3,), unit vector into the object
    desired_force_n: float  # desired contact force, positive in compression [N]; NaN if the force is free
    phase: Phase  # phase of the task
    run: int = NO_RUN  # number of the probing run from 0, or `NO_RUN` between runs
    done: bool = False  # whether the task has ended: this command is the last, and the torque may go off
    events: tuple[TaskEvent, ...] = ()  # events of this tick


# Required type of each field of a `TaskOutput`, in order, and its name in errors.
_KINDS: tuple[type | tuple[type, ...], ...] = (
    *(Command, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray),
    *((float, int), Phase, (int, np.integer), object, tuple),
)
_KIND_NAMES = ("Command", *["array"] * 5, "number", "Phase", "whole number", "", "tuple")


class Task(Protocol):
    """Interface of tasks that the loop can run.

    A task receives measurements and time steps, but never devices or clocks.
    """

    def start(self, measurement: Measurement) -> None:
        """Begin from the measured state; called once, in the first tick before `step`.

        Args:
            measurement: state of the arm; the loop powers the drives afterwards.
        """

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Compute one tick; an exception or an output of a wrong shape stops the arm.

        Args:
            measurement: state of the arm.
            dt_s: time since the previous tick [s]; a multiple of the period after an overrun.
        """


def make_output(
    command: Command,
    motion: "JointMotion",
    tip: "TipMotion",
    direction: FloatArray,
    phase: Phase,
    *,
    desired_force_n: float = math.nan,
    run: int = NO_RUN,
    done: bool = False,
    events: tuple[TaskEvent, ...] = (),
) -> TaskOutput:
    """Make the output of a task that follows a motion of the joints, with the measured tip motion.

    Args:
        command: joint torques.
        motion: reference of the joints.
        tip: measured motion of the tip.
        direction: unit vector into the object, shape (3,), world frame.
        phase: phase of the task.
        desired_force_n: desired contact force, positive in compression [N]; NaN if the force is free.
        run: number of the probing run, or `NO_RUN`.
        done: whether the task has ended.
        events: events of the tick.
    """
    position_m, velocity_m_s = tip.position_world_m, tip.velocity_world_m_s
    reference = (motion.position_rad, motion.velocity_rad_s)
    return TaskOutput(
        command, *reference, position_m, velocity_m_s, direction, desired_force_n, phase, run, done, events
    )


def blank_output(joint_count: int, phase: Phase, run: int = NO_RUN) -> TaskOutput:
    """Make the output of a tick without a task: zero torque, no reference, no tip.

    Args:
        joint_count: number of joints n.
        phase: phase to record.
        run: number of the probing run, or `NO_RUN`.
    """
    joints, space = np.full(joint_count, np.nan), np.full(3, np.nan)
    return TaskOutput(
        Command(np.zeros(joint_count)), joints, joints, space, space, space, math.nan, phase, run
    )


def checked_output(output: object, joints: tuple[int]) -> TaskOutput:
    """Check types and shapes of a task's output, and return it; the guard checks values.

    Args:
        output: return value of `Task.step`.
        joints: shape of the joints' arrays, (n,).

    Raises:
        TypeError: the output is not a `TaskOutput`, or a field has the wrong type.
        ValueError: an array has the wrong shape.
    """
    if not isinstance(output, TaskOutput):
        raise TypeError(f"step returned a {type(output).__name__}, not a TaskOutput")
    if not all(map(isinstance, output, _KINDS)):
        for name, value, kind, words in zip(TaskOutput._fields, output, _KINDS, _KIND_NAMES, strict=True):
            if not isinstance(value, kind):
                raise _wrong_type(name, value, words)
    if not isinstance(output.command.joint_torque_nm, np.ndarray):
        raise _wrong_type("command", output.command.joint_torque_nm, "array")
    shapes = (
        output.command.joint_torque_nm.shape,
        output.reference_position_rad.shape,
        output.reference_velocity_rad_s.shape,
        output.tip_position_world_m.shape,
        output.tip_velocity_world_m_s.shape,
        output.press_direction_world.shape,
    )
    expected = (joints, joints, joints, _SPACE, _SPACE, _SPACE)
    if shapes != expected:
        for name, shape, expected_shape in zip(TaskOutput._fields, shapes, expected, strict=False):
            if shape != expected_shape:
                raise ValueError(f"step returned {name} of shape {shape}, expected {expected_shape}")
    for event in output.events:
        if not isinstance(event, TaskEvent):
            raise _wrong_type("events", event, "TaskEvent")
    return output


def _wrong_type(name: str, value: object, expected: str) -> TypeError:
    return TypeError(f"step returned {name} of type {type(value).__name__}, expected: {expected}")
