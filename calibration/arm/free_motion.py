"""Follows joint motions in free air; whatever touches the tool on the way ends it."""

import math

import numpy as np

from calibration.arm.excitation import FourierPath
from calibration.arm.room import ACCELERATION_RAD_S2
from control.arm.rigid_body import RigidBody
from control.laws.computed_torque import ComputedTorque
from control.laws.gains import TrackingGains
from control.loop.task import NO_RUN, Phase, TaskEvent, TaskOutput, make_output
from control.paths.trajectory import JointMotion, JointMove
from robot_io.errors import SafetyTripError
from robot_io.types import Command, FloatArray, Measurement

TOUCH_N = 5.0  # away from what the force sensor showed at the start
_TOUCH_TICKS = 3
_REST_RAD_S = 0.05
_REST_WAIT_S = 2.0
_SETTLE_S = 0.3


class FreeMotion:
    """The part that all motions without contact share: tracking, the look at the force, the record."""

    def __init__(self, body: RigidBody, gains: TrackingGains) -> None:
        self.body = body
        self._torque = ComputedTorque(body, gains)
        self._no_contact = np.zeros(body.joint_count)
        self._touched_ticks = 0
        self._air_n = 0.0

    def start(self, measurement: Measurement) -> None:
        """Begin from rest; the force now is that of free air."""
        self._torque.reset()
        self._touched_ticks = 0
        self._air_n = measurement.force_n if math.isfinite(measurement.force_n) else 0.0

    def forget(self) -> None:
        """Forget the disturbances seen so far, such as a stop that was pressed on."""
        self._torque.reset()

    def torque_nm(self, measurement: Measurement, motion: JointMotion, dt_s: float) -> FloatArray:
        """Joint torques (n,) [N m] that follow `motion`.

        SafetyTripError: the force sensor feels something.
        """
        away_n = measurement.force_n - self._air_n
        self._touched_ticks = self._touched_ticks + 1 if abs(away_n) > TOUCH_N else 0
        if self._touched_ticks >= _TOUCH_TICKS:
            raise SafetyTripError(
                f"{away_n:.1f} N on the tool: something is in the way; clear it, or, if there is nothing, "
                "take off what hangs on the tool: its weight turns with it"
            )
        return self._torque.step(measurement, motion, self._no_contact, dt_s)

    def at_rest(self, measurement: Measurement, waited_s: float) -> bool:
        """Whether the arm stands, `waited_s` after its motion should have ended; trips if too long."""
        stands = float(np.abs(measurement.joint_velocity_rad_s).max()) < _REST_RAD_S
        if not stands and waited_s > _REST_WAIT_S:
            raise SafetyTripError(
                "back where the motion started the arm does not come to rest; if it shakes, lower "
                "gains.tracking.bandwidth_rad_s in the robot file"
            )
        return stands

    def output(
        self,
        measurement: Measurement,
        motion: JointMotion,
        torque_nm: FloatArray,
        phase: Phase,
        run: int = NO_RUN,
        *,
        done: bool = False,
        events: tuple[TaskEvent, ...] = (),
    ) -> TaskOutput:
        """What the loop is given; there is no object, so no direction into it: zeros."""
        tip = self.body.tip_motion(measurement.joint_position_rad, measurement.joint_velocity_rad_s)
        return make_output(
            Command(torque_nm), motion, tip, np.zeros(3), phase, run=run, done=done, events=events
        )


class PathTask:
    """Moves to a path, follows it and moves back; see `control.loop.task.Task`. The path's ticks are run 0.

    On the ways there and back the fastest joint moves at `travel_rad_s` [rad/s].
    """

    def __init__(self, body: RigidBody, gains: TrackingGains, path: FourierPath, travel_rad_s: float) -> None:
        self._free = FreeMotion(body, gains)
        self._path, self._travel_rad_s = path, travel_rad_s
        self._time_s = 0.0
        self.duration_s = path.duration_s  # with the ways to it and back, once started

    def start(self, measurement: Measurement) -> None:
        self._free.start(measurement)
        self._time_s = 0.0
        start_rad, centre_rad = measurement.joint_position_rad.copy(), self._path.centre_rad
        self._there = JointMove(start_rad, centre_rad, self._travel_rad_s, ACCELERATION_RAD_S2)
        self._back = JointMove(centre_rad, start_rad, self._travel_rad_s, ACCELERATION_RAD_S2)
        self._begin_s = self._there.duration_s + _SETTLE_S
        self._end_s = self._begin_s + self._path.duration_s
        self.duration_s = self._end_s + self._back.duration_s + _SETTLE_S

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        self._time_s += dt_s
        if self._time_s < self._begin_s:
            motion, phase, run = self._there.at(self._time_s), Phase.MOVE, NO_RUN
        elif self._time_s < self._end_s:
            motion, phase, run = self._path.at(self._time_s - self._begin_s), Phase.FREE_AIR, 0
        else:
            motion, phase, run = self._back.at(self._time_s - self._end_s), Phase.MOVE, NO_RUN
        torque_nm = self._free.torque_nm(measurement, motion, dt_s)
        over_s = self._time_s - self.duration_s
        done = over_s >= 0.0 and self._free.at_rest(measurement, over_s)
        events = (TaskEvent("motion_done", "the motion is done"),) if done else ()
        return self._free.output(
            measurement, motion, torque_nm, Phase.IDLE if done else phase, run, done=done, events=events
        )
