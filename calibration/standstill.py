"""Readings at standstill, and estimates with uncertainties that are valid for few observations too."""

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

from scipy.special import ndtri, stdtrit

from palpate.control.loop.loop import READ_SHARE, first_measurement
from palpate.control.loop.stop_handler import InterruptFlag
from palpate.control.loop.task import NO_RUN, Phase, blank_output
from palpate.control.loop.tick_record import NO_ESTIMATE, STREAM_NAME, Tick, TickLog, tick_record
from palpate.control.loop.timing import TickDurations
from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import SafetyTripError
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import Robot
from palpate.robot_io.types import Measurement

_COVERED = 0.975
MAX_REL_STD = 0.05  # largest uncertainty of a plausible scale or gain, as a share; 95 % are within twice this
Value = TypeVar("Value")


@dataclass(frozen=True)
class UncertainValue(Generic[Value]):
    """A value (or an array of them) and its standard uncertainty."""

    value: Value
    std_err: Value


def few_sample_factor(degrees_of_freedom: int) -> float:
    """Compute the factor with which twice a standard error estimated from few samples covers about 95 %.

    Student's t over the normal quantile: 1 for many and 1.2 for 7 degrees of freedom. Source: "Guide to the
    expression of uncertainty in measurement" (JCGM 100:2008), G.3.

    Args:
        degrees_of_freedom: number of samples minus number of estimated parameters, at least 1.
    """
    return float(stdtrit(degrees_of_freedom, _COVERED) / ndtri(_COVERED))


_NO_DURATIONS = TickDurations(*[0.0] * len(TickDurations._fields))


@dataclass(frozen=True)
class StationaryRobot:
    """A robot that is configured, read and never powered; a guard checks every measurement."""

    robot: Robot
    guard: Guard
    clock: Clock
    log: TickLog
    rate_hz: float

    def record(self, duration_s: float, run: int = NO_RUN) -> None:
        """Read and log for a while.

        Args:
            duration_s: duration [s].
            run: number of the records' run.

        Raises:
            SafetyTripError: a sample is missing, old or beyond a limit.
            KeyboardInterrupt: Ctrl-C, or the program was asked to end.
        """
        output = blank_output(self.robot.joint_count, Phase.IDLE, run)
        zero_nm = output.command.joint_torque_nm
        period_s, start_s = 1.0 / self.rate_hz, self.clock.now_s()
        with InterruptFlag() as interrupt:
            for number in range(1, math.ceil(duration_s * self.rate_hz) + 1):
                measurement = self._read_at(start_s + number * period_s)
                self.guard.watch(measurement)
                tripped = self.guard.tripped
                is_tripped = tripped is not None
                record = Tick(number, measurement, output, zero_nm, is_tripped, NO_ESTIMATE, _NO_DURATIONS)
                self.log.append(STREAM_NAME, tick_record(record))
                if tripped:
                    raise SafetyTripError("; ".join(filter(None, (tripped.cause, tripped.remedy))))
                if interrupt.signal_name:
                    raise KeyboardInterrupt

    def await_samples(self) -> Measurement:
        """Read until every device has a recent sample; see `first_measurement`."""
        return first_measurement(self.robot, self.guard, self.clock, 1.0 / self.rate_hz)

    def settle(self, duration_s: float) -> None:
        """Read for a while without logging or checking.

        Args:
            duration_s: duration [s].

        Raises:
            KeyboardInterrupt: Ctrl-C, or the program was asked to end.
        """
        end_s, period_s = self.clock.now_s() + duration_s, 1.0 / self.rate_hz
        with InterruptFlag() as interrupt:
            while self.clock.now_s() < end_s:
                self._read_at(min(end_s, self.clock.now_s() + period_s))
                if interrupt.signal_name:
                    raise KeyboardInterrupt

    def _read_at(self, time_s: float) -> Measurement:
        self.clock.sleep_until(time_s)
        return self.robot.read(self.clock.now_s() + READ_SHARE / self.rate_hz)
