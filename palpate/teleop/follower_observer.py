"""What the follower's loop hands on in each tick: to the leader, to the estimator, and to the log."""

import numpy as np

from control.laws.touch import RunningMean
from control.loop.task import NO_RUN, Phase, TaskOutput
from control.loop.tick_record import NO_ESTIMATE, Estimates
from control.teleop.messaging import LINK_STREAM
from palpate.teleop.estimating import sample_stream
from palpate.teleop.follower_messaging import FollowerMessaging, Moment
from robot_io.session import SessionWriter
from robot_io.types import Measurement

_LINK_RECORD_S = 0.1
_MOST_SAMPLES = 200_000  # of one target that are kept for its estimate


class Observer:
    """One run's; `runs` is how many presses a target has."""

    def __init__(self, messaging: FollowerMessaging, log: SessionWriter, joint_count: int, runs: int) -> None:
        self._messaging, self._log, self._runs = messaging, log, runs
        self._stream = sample_stream(joint_count)
        self._records = np.zeros(_MOST_SAMPLES, self._stream.dtype)
        self._count, self._target, self._run, self._first_run = 0, -1, NO_RUN, 0
        self._air, self._phase = RunningMean(), Phase.IDLE
        self._record_s = 0.0

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """See `control.loop.tick_record.Observer`."""
        self._tare(measurement, output)
        self._collect(measurement, output)
        speed_m_s = float(output.tip_velocity_world_m_s.dot(output.press_direction_world))
        tip, direction = output.tip_position_world_m.tolist(), output.press_direction_world.tolist()
        force_n = measurement.force_n - self._air.mean
        self._messaging.moment = Moment(output.phase, tuple(tip), speed_m_s, tuple(direction), force_n)
        if measurement.time_s >= self._record_s:
            self._record_s = measurement.time_s + _LINK_RECORD_S
            record = self._messaging.record(measurement.time_s)
            self._log.append(LINK_STREAM.name, record)
        while self._messaging.notes:
            self._log.event(measurement.time_s, *self._messaging.notes.popleft())
        return NO_ESTIMATE

    def _tare(self, measurement: Measurement, output: TaskOutput) -> None:
        if output.phase is Phase.FREE_AIR:
            if self._phase is not Phase.FREE_AIR:
                self._air = RunningMean()
            self._air.add(measurement.force_n)
        self._phase = output.phase

    def _collect(self, measurement: Measurement, output: TaskOutput) -> None:
        """Keep the samples of the target under way, and have them looked at whenever a run has ended."""
        if self._run not in {NO_RUN, output.run}:
            last = self._run - self._first_run + 1 == self._runs
            self._messaging.look(self._stream, self._records[: self._count].copy(), self._target, last=last)
        self._run = output.run
        if output.run == NO_RUN:
            return
        target = self._messaging.queue.current
        if target != self._target:
            self._count, self._target, self._first_run = 0, target, output.run
        if self._count < _MOST_SAMPLES:
            self._records[self._count] = (
                measurement.time_s,
                output.run,
                output.phase,
                measurement.joint_position_rad,
                measurement.force_n,
                output.tip_position_world_m,
                output.press_direction_world,
                measurement.encoder_at_s,
                measurement.force_at_s,
                measurement.encoder_status,
                measurement.force_status,
            )
            self._count += 1
