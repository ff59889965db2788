"""Moves to where a path begins, follows it, and goes back to where the arm stood."""

from calibration.arm.fourier import FourierPath
from calibration.arm.free_motion import FreeMotion
from calibration.arm.pace import ACCELERATION_RAD_S2
from control.arm.rigid_body import RigidBody
from control.laws.gains import TrackingGains
from control.loop.phases import Phase
from control.loop.task import NO_RUN, TaskEvent, TaskOutput
from control.paths.trajectory import JointMotion, JointMove
from robot_io.types import FloatArray, Measurement

_SETTLE_S = 0.3


class PathTask:
    """Excites the arm along a path; see `control.loop.task.Task`. The path's ticks are run 0.

    Args:
        body: the arm.
        gains: of tracking.
        path: what to follow.
        travel_rad_s: speed of the fastest joint on the ways to the path and back [rad/s].

    Attributes:
        duration_s: of the path and the ways to it and back, once started [s].
    """

    def __init__(self, body: RigidBody, gains: TrackingGains, path: FourierPath, travel_rad_s: float) -> None:
        self._free = FreeMotion(body, gains)
        self._path, self._travel_rad_s = path, travel_rad_s
        self._time_s = 0.0
        self.duration_s = path.duration_s

    def start(self, measurement: Measurement) -> None:
        """See `control.loop.task.Task.start`."""
        self._free.start(measurement)
        start_rad = measurement.joint_position_rad.copy()
        self._time_s = 0.0
        self._there = self._move(start_rad, self._path.centre_rad)
        self._back = self._move(self._path.centre_rad, start_rad)
        self._begin_s = self._there.duration_s + _SETTLE_S
        self._end_s = self._begin_s + self._path.duration_s
        self.duration_s = self._end_s + self._back.duration_s + _SETTLE_S

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """See `control.loop.task.Task.step`.

        Raises:
            SafetyTripError: something is in the way, or the arm does not come to rest in the end.
        """
        self._time_s += dt_s
        motion, phase, run = self._aim()
        torque_nm = self._free.torque_nm(measurement, motion, dt_s)
        over_s = self._time_s - self.duration_s
        done = over_s >= 0.0 and self._free.at_rest(measurement, over_s)
        events = (TaskEvent("motion_done", "the motion is done"),) if done else ()
        return self._free.output(
            measurement, motion, torque_nm, Phase.IDLE if done else phase, run, done=done, events=events
        )

    def _aim(self) -> tuple[JointMotion, Phase, int]:
        if self._time_s < self._begin_s:
            return self._there.at(self._time_s), Phase.MOVE, NO_RUN
        if self._time_s < self._end_s:
            return self._path.at(self._time_s - self._begin_s), Phase.FREE_AIR, 0
        return self._back.at(self._time_s - self._end_s), Phase.MOVE, NO_RUN

    def _move(self, start_rad: FloatArray, end_rad: FloatArray) -> JointMove:
        return JointMove(start_rad, end_rad, self._travel_rad_s, ACCELERATION_RAD_S2)
