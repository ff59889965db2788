"""Holds what a task returns against what the loop can use: a fault of the task is found in its own tick."""

import numpy as np

from control.loop.phases import Phase
from control.loop.task import TaskEvent, TaskOutput
from robot_io.types import Command

_SPACE = (3,)
_NUMBERS = (float, int)
_WHOLE_NUMBERS = (int, np.integer)


class OutputCheck:
    """Type and shape of a `TaskOutput`; values are the guard's business. It takes a microsecond or two.

    Args:
        joint_count: number of joints n.
    """

    def __init__(self, joint_count: int) -> None:
        self._joints = (joint_count,)

    def __call__(self, output: object) -> TaskOutput:
        """The output, if it is one.

        Raises:
            TypeError: it is none, or a part of it is of another type.
            ValueError: an array has another shape.
        """
        if not isinstance(output, TaskOutput):
            raise TypeError(f"step returned a {type(output).__name__}, not a TaskOutput")
        if not isinstance(output.command, Command):
            raise _wrong_type("command", output.command, "Command")
        self._check_arrays(output)
        if not isinstance(output.desired_force_n, _NUMBERS):
            raise _wrong_type("desired_force_n", output.desired_force_n, "number")
        if not isinstance(output.phase, Phase):
            raise _wrong_type("phase", output.phase, "Phase")
        if not isinstance(output.run, _WHOLE_NUMBERS):
            raise _wrong_type("run", output.run, "whole number")
        if not isinstance(output.events, tuple):
            raise _wrong_type("events", output.events, "tuple")
        for event in output.events:
            if not isinstance(event, TaskEvent):
                raise _wrong_type("events", event, "TaskEvent")
        return output

    def _check_arrays(self, output: TaskOutput) -> None:
        joints = self._joints
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


def _wrong_type(name: str, value: object, expected: str) -> TypeError:
    return TypeError(f"step returned {name} of type {type(value).__name__}, expected: {expected}")
