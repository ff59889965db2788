"""Replay of recorded joint references, tick by tick."""

import math
from dataclasses import dataclass

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.computed_torque import ComputedTorque
from palpate.control.laws.gains import Gains
from palpate.control.loop.task import NO_RUN, Phase, TaskEvent, TaskOutput, make_output
from palpate.control.paths.trajectory import JointMotion, JointMove
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import Command, FloatArray, IntArray, Measurement

SPEED_RAD_S, ACCELERATION_RAD_S2 = 0.5, 2.0  # of the move to the first reference
_SETTLE_S = 0.3  # rest before the references, and after them


@dataclass(frozen=True, eq=False)
class ReferenceTrajectory:
    """Recorded references of an arm with j joints over n ticks.

    Raises:
        InputError: times do not increase, a number is not finite, or a phase is unknown.
    """

    time_s: FloatArray  # from 0 on, increasing, shape (n,) [s]
    position_rad: FloatArray  # shape (n, j) [rad]
    velocity_rad_s: FloatArray  # shape (n, j) [rad/s]
    run: IntArray  # number of the run, or `NO_RUN`, shape (n,)
    phase: IntArray  # numbers of `Phase`, shape (n,)
    press_direction_world: FloatArray  # unit vectors into the object, shape (n, 3)

    def __post_init__(self) -> None:
        if len(self.time_s) < 2 or not (np.diff(self.time_s) > 0.0).all():
            raise InputError("references: their times do not increase")
        for name in ("position_rad", "velocity_rad_s", "press_direction_world"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"references: {name} has a value that is not finite")
        if not np.isin(self.phase, [int(phase) for phase in Phase]).all():
            raise InputError("references: they contain an unknown phase")

    @property
    def duration_s(self) -> float:
        """Time from the first to the last tick [s]."""
        return float(self.time_s[-1])

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return int(self.position_rad.shape[1])


class ReplayTask:
    """Task that moves to the first reference, follows the references, and stays at the last one.

    Joints are followed by computed torque, which compensates the measured force as a load. The force is
    not controlled: on a stiffer object it can grow up to the guard's limit.

    Args:
        body: model of the arm.
        gains: gains of the computed torque.
        references: references of an arm with as many joints.

    Raises:
        InputError: the references are of an arm with another number of joints.
    """

    def __init__(self, body: RigidBody, gains: Gains, references: ReferenceTrajectory) -> None:
        if references.joint_count != body.joint_count:
            raise InputError(
                f"references of {references.joint_count} joints, but the arm has {body.joint_count}"
            )
        self._body, self._references = body, references
        self._torque = ComputedTorque(body, gains.tracking)
        self._feedforward = gains.contact.force_feedforward
        self._acceleration_rad_s2 = np.gradient(references.velocity_rad_s, references.time_s, axis=0)
        self._time_s = 0.0

    def start(self, measurement: Measurement) -> None:
        """Plan the move from the measured posture to the first reference.

        Args:
            measurement: state of the arm.
        """
        self._torque.reset()
        begin_rad = self._references.position_rad[0]
        position_rad = measurement.joint_position_rad.copy()
        self._move_to_start = JointMove(position_rad, begin_rad, SPEED_RAD_S, ACCELERATION_RAD_S2)
        self._time_s, self._tick = 0.0, 0

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Move to the first reference, then follow the recorded references at their times.

        Args:
            measurement: state of the arm.
            dt_s: time since the last tick [s].
        """
        self._time_s += dt_s
        since_s = self._time_s - self._move_to_start.duration_s - _SETTLE_S
        if since_s < 0.0:
            return self._output(measurement, self._move_to_start.at(self._time_s), dt_s, Phase.MOVE, NO_RUN)
        references = self._references
        while self._tick < len(references.time_s) - 1 and references.time_s[self._tick + 1] <= since_s:
            self._tick += 1
        phase, run = Phase(int(references.phase[self._tick])), int(references.run[self._tick])
        done = since_s >= references.duration_s + _SETTLE_S
        motion = self._motion(since_s)
        return self._output(
            measurement, motion, dt_s, Phase.IDLE if done else phase, NO_RUN if done else run, done=done
        )

    def _motion(self, since_s: float) -> JointMotion:
        """Interpolate the references linearly at a time; at rest after the last."""
        references, tick = self._references, self._tick
        if tick == len(references.time_s) - 1:
            zero = np.zeros(references.joint_count)
            return JointMotion(references.position_rad[-1], zero, zero)
        share = (since_s - references.time_s[tick]) / (references.time_s[tick + 1] - references.time_s[tick])
        signals = references.position_rad, references.velocity_rad_s, self._acceleration_rad_s2
        return JointMotion(*((1.0 - share) * signal[tick] + share * signal[tick + 1] for signal in signals))

    def _output(
        self,
        measurement: Measurement,
        motion: JointMotion,
        dt_s: float,
        phase: Phase,
        run: int,
        *,
        done: bool = False,
    ) -> TaskOutput:
        tip = self._body.tip_motion(measurement.joint_position_rad, measurement.joint_velocity_rad_s)
        direction = self._references.press_direction_world[self._tick]
        force_n = measurement.force_n if math.isfinite(measurement.force_n) else 0.0
        lever_m = direction.dot(tip.jacobian_world[:3])
        torque_nm = self._torque.step(measurement, motion, lever_m * (force_n * self._feedforward), dt_s)
        events = (TaskEvent("replayed", "the recorded motion was repeated"),) if done else ()
        return make_output(
            Command(torque_nm), motion, tip, direction, phase, run=run, done=done, events=events
        )
