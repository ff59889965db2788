"""Watches a robot without power, tick by tick, and logs it as the loop does."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from control.loop.journal import TickLog
from control.loop.loop import READ_SHARE, first_measurement
from control.loop.phases import Phase
from control.loop.task import NO_RUN, TaskOutput
from control.loop.tick_record import NO_ESTIMATE, STREAM_NAME, tick_record
from control.loop.timing import TickDurations
from control.loop.way_out import InterruptFlag
from robot_io.clock import Clock
from robot_io.errors import SafetyTripError
from robot_io.guard import Guard
from robot_io.robot import Robot
from robot_io.types import Command, Measurement

_NO_DURATIONS = TickDurations(*[0.0] * len(TickDurations._fields))


@dataclass(frozen=True)
class StillRobot:
    """A robot that is read and never powered.

    Attributes:
        robot: configured, not active.
        guard: watches every measurement; nothing is commanded.
        clock: the robot's.
        log: takes the records of the stream "tick" and the events.
        rate_hz: ticks per second.
    """

    robot: Robot
    guard: Guard
    clock: Clock
    log: TickLog
    rate_hz: float

    def watch(
        self, duration_s: float, run: int = NO_RUN, told: Callable[[float], None] | None = None
    ) -> None:
        """Read and log for a while.

        Args:
            duration_s: how long [s].
            run: what the records are numbered with.
            told: called after each tick with the share that is done.

        Raises:
            SafetyTripError: a sample is missing, old or beyond a limit.
            KeyboardInterrupt: Ctrl-C, or the program was asked to end.
        """
        output = _nothing_aimed_at(self.robot.joint_count, run)
        none_nm = output.command.joint_torque_nm
        count, period_s, start_s = (
            math.ceil(duration_s * self.rate_hz),
            1.0 / self.rate_hz,
            self.clock.now_s(),
        )
        with InterruptFlag() as interrupt:
            for tick in range(1, count + 1):
                self.clock.sleep_until(start_s + tick * period_s)
                measurement = self.robot.read(self.clock.now_s() + READ_SHARE * period_s)
                self.guard.watch(measurement)
                tripped = self.guard.tripped
                record = tick_record(
                    tick, measurement, output, none_nm, tripped is not None, NO_ESTIMATE, _NO_DURATIONS
                )
                self.log.append(STREAM_NAME, record)
                if tripped:
                    raise SafetyTripError("; ".join(filter(None, (tripped.cause, tripped.remedy))))
                if interrupt.signal_name:
                    raise KeyboardInterrupt
                if told:
                    told(tick / count)

    def await_samples(self) -> Measurement:
        """Read until every device has a young sample; see `first_measurement`.

        Raises:
            DeviceTimeoutError: one has none in time.
        """
        return first_measurement(self.robot, self.guard, self.clock, 1.0 / self.rate_hz)

    def settle(self, duration_s: float) -> None:
        """Let time pass, with the devices read; what comes meanwhile is not logged and not judged."""
        end_s, period_s = self.clock.now_s() + duration_s, 1.0 / self.rate_hz
        with InterruptFlag() as interrupt:
            while self.clock.now_s() < end_s:
                self.clock.sleep_until(min(end_s, self.clock.now_s() + period_s))
                self.robot.read(self.clock.now_s() + READ_SHARE * period_s)
                if interrupt.signal_name:
                    raise KeyboardInterrupt


def _nothing_aimed_at(joint_count: int, run: int) -> TaskOutput:
    joints, space = np.full(joint_count, np.nan), np.full(3, np.nan)
    torque_off = Command(np.zeros(joint_count))
    return TaskOutput(torque_off, joints, joints, space, space, space, math.nan, Phase.IDLE, run)
