"""What the loop runs: a task turns one measurement into one command, tick after tick."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from control.arm.rigid_body import TipMotion
from control.loop.phases import Phase
from control.paths.trajectory import JointMotion
from robot_io.types import Command, FloatArray, Measurement

NO_RUN = -1  # `run` between runs
_SPACE = (3,)
_PARTS = (
    ("command", Command, "Command"),
    ("desired_force_n", (float, int), "number"),
    ("phase", Phase, "Phase"),
    ("run", (int, np.integer), "whole number"),
    ("events", tuple, "tuple"),
)


@dataclass(frozen=True, slots=True)
class TaskEvent:
    """Something worth a line in the session, such as the touch of the object."""

    kind: str  # short word for filters, such as "touch"
    text: str  # one sentence for people
    data: Mapping[str, object] | None = None  # values for programs (numbers, strings), if any


class TaskOutput(NamedTuple):
    """What a task wants in one tick, and what it was aiming at."""

    command: Command  # joint torques wanted; the guard has the last word
    reference_position_rad: FloatArray  # shape (n,), where the joints should be [rad]
    reference_velocity_rad_s: FloatArray  # shape (n,), how fast they should move [rad/s]
    # shape (3,), measured tip (forward kinematics of the measured joints) [m].
    tip_position_world_m: FloatArray
    tip_velocity_world_m_s: FloatArray  # shape (3,), measured tip velocity [m/s]
    press_direction_world: FloatArray  # shape (3,), unit vector into the object
    desired_force_n: float  # contact force aimed at, positive in compression [N]; NaN when it is free
    phase: Phase  # what the arm is doing
    run: int = NO_RUN  # number of the probing run from 0, or `NO_RUN` between runs
    # the task has ended: this command is the last, and the arm may be let go where it stands.
    done: bool = False
    events: tuple[TaskEvent, ...] = ()  # what happened in this tick


class Task(Protocol):
    """Anything the loop can run; it sees measurements and time steps, never devices or clocks."""

    def start(self, measurement: Measurement) -> None:
        """Begin from the measured state; called once, in the first tick before `step`."""

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """One tick; what is raised, or returned in another shape than `TaskOutput` says, stops the arm.

        `dt_s` is the time since the previous tick [s]; a whole multiple of the period after an overrun.
        """


def aimed_output(
    command: Command,
    motion: JointMotion,
    tip: TipMotion,
    direction: FloatArray,
    phase: Phase,
    *,
    desired_force_n: float = math.nan,
    run: int = NO_RUN,
    done: bool = False,
    events: tuple[TaskEvent, ...] = (),
) -> TaskOutput:
    """The output of a task that aimed at a motion of the joints; `tip` is measured, the rest as there."""
    position_m, velocity_m_s = tip.position_world_m, tip.velocity_world_m_s
    aimed = (motion.position_rad, motion.velocity_rad_s)
    return TaskOutput(
        command, *aimed, position_m, velocity_m_s, direction, desired_force_n, phase, run, done, events
    )


def aimless_output(joint_count: int, phase: Phase, run: int = NO_RUN) -> TaskOutput:
    """What a record shows of a tick without a task: no torque, nothing aimed at, no tip computed."""
    joints, space = np.full(joint_count, np.nan), np.full(3, np.nan)
    return TaskOutput(
        Command(np.zeros(joint_count)), joints, joints, space, space, space, math.nan, phase, run
    )


def checked_output(output: object, joints: tuple[int]) -> TaskOutput:
    """A task's output, if its parts have the types and shapes that the loop needs; values are the guard's.

    A fault of the task so is found in its own tick. `joints` is the shape of the joints' arrays, (n,).

    Raises:
        TypeError: it is no `TaskOutput`, or a part of it is of another type.
        ValueError: an array has another shape.
    """
    if not isinstance(output, TaskOutput):
        raise TypeError(f"step returned a {type(output).__name__}, not a TaskOutput")
    for name, kind, words in _PARTS:
        if not isinstance(value := getattr(output, name), kind):
            raise _wrong_type(name, value, words)
    for name, array, shape in (
        ("command", output.command.joint_torque_nm, joints),
        ("reference_position_rad", output.reference_position_rad, joints),
        ("reference_velocity_rad_s", output.reference_velocity_rad_s, joints),
        ("tip_position_world_m", output.tip_position_world_m, _SPACE),
        ("tip_velocity_world_m_s", output.tip_velocity_world_m_s, _SPACE),
        ("press_direction_world", output.press_direction_world, _SPACE),
    ):
        if not isinstance(array, np.ndarray):
            raise _wrong_type(name, array, "array")
        if array.shape != shape:
            raise ValueError(f"step returned {name} of shape {array.shape}, expected {shape}")
    for event in output.events:
        if not isinstance(event, TaskEvent):
            raise _wrong_type("events", event, "TaskEvent")
    return output


def _wrong_type(name: str, value: object, expected: str) -> TypeError:
    return TypeError(f"step returned {name} of type {type(value).__name__}, expected: {expected}")
