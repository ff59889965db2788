"""Stream "tick" of a session: its records and its log."""

import math
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import NamedTuple, Protocol

from palpate.control.loop.task import Phase, TaskOutput
from palpate.control.loop.timing import TickDurations
from palpate.robot_io.errors import error_text
from palpate.robot_io.session import Column, Stream
from palpate.robot_io.types import FloatArray, Measurement

STREAM_NAME = "tick"
Estimates = tuple[float, float, float]
"""Online estimates of stiffness [N/m], damping [N s/m], and the surface along the press direction [m]."""

NO_ESTIMATE: Estimates = (math.nan, math.nan, math.nan)


class Tick(NamedTuple):
    """All data that one tick of the loop read, computed and sent."""

    number: int  # number of the tick on the loop's grid
    measurement: Measurement
    output: TaskOutput
    sent_torque_nm: FloatArray  # shape (n,), NaN if sending failed [N m]
    tripped: bool  # whether the guard has tripped
    estimates: Estimates
    durations: TickDurations


_PHASES = ", ".join(f"{phase.value} {phase.name}" for phase in Phase)
_STATUS = "0 OK, 1 STALE, 2 SATURATED, 3 FAULT"
_PER_JOINT = 0  # width of a column with one value for each joint
# Attribute of `Tick`, and its column: name, unit, width, description, and a type other than float64.
_COLUMNS: tuple[tuple[str, str, str, int, str, *tuple[str, ...]], ...] = (
    ("number", "tick", "1", 1, "number of the tick on the loop's grid; a gap is an overrun", "int64"),
    ("measurement.time_s", "time_s", "s", 1, "start of the tick on the robot's clock"),
    ("output.run", "run", "1", 1, "number of the probing run, -1 between runs", "int32"),
    ("output.phase", "phase", "1", 1, _PHASES, "int32"),
    ("measurement.joint_position_rad", "joint_position_rad", "rad", _PER_JOINT, "measured"),
    ("measurement.joint_velocity_rad_s", "joint_velocity_rad_s", "rad/s", _PER_JOINT, "measured"),
    ("measurement.joint_torque_nm", "torque_measured_nm", "N m", _PER_JOINT, "measured by the drives"),
    (
        "output.command.joint_torque_nm",
        "torque_commanded_nm",
        "N m",
        _PER_JOINT,
        "commanded by the controller; 0 in STOPPED",
    ),
    ("sent_torque_nm", "torque_sent_nm", "N m", _PER_JOINT, "sent; NaN if sending failed"),
    ("measurement.force_n", "force_n", "N", 1, "contact force, positive in compression"),
    ("output.reference_position_rad", "reference_position_rad", "rad", _PER_JOINT, "goal"),
    ("output.reference_velocity_rad_s", "reference_velocity_rad_s", "rad/s", _PER_JOINT, "goal"),
    ("output.tip_position_world_m", "tip_position_world_m", "m", 3, "of the measured joints"),
    ("output.tip_velocity_world_m_s", "tip_velocity_world_m_s", "m/s", 3, "of the measured joints"),
    ("output.press_direction_world", "press_direction_world", "1", 3, "unit vector into the object"),
    ("output.desired_force_n", "desired_force_n", "N", 1, "goal; NaN without force control"),
    ("measurement.encoder_at_s", "encoder_at_s", "s", 1, "when the encoders sampled"),
    ("measurement.torque_at_s", "torque_at_s", "s", 1, "when the torques were sampled"),
    ("measurement.force_at_s", "force_at_s", "s", 1, "when the force was sampled"),
    ("measurement.encoder_status", "encoder_status", "1", 1, _STATUS, "int32"),
    ("measurement.torque_status", "torque_status", "1", 1, _STATUS, "int32"),
    ("measurement.force_status", "force_status", "1", 1, _STATUS, "int32"),
    ("tripped", "guard_tripped", "1", 1, "true once the guard has tripped", "bool"),
)
# In the order of `Estimates`, then of `TickDurations`.
_ESTIMATE_COLUMNS = (
    Column("stiffness_n_m", "N/m", 1, "online estimate, NaN if none"),
    Column("damping_n_s_m", "N s/m", 1, "online estimate, NaN if none"),
    Column("surface_m", "m", 1, "online estimate along the press direction, NaN if none"),
)
_DURATIONS = (
    *("time spent reading the robot", "time spent in the task", "time spent in the guard"),
    *("time spent writing the command", "time spent in the online estimator"),
    *("time spent logging the previous tick", "how late the tick began"),
)
_values = attrgetter(*(attribute for attribute, *_ in _COLUMNS))


def tick_stream(joint_count: int) -> Stream:
    """Describe the columns of a tick: the stream "tick", whose records `tick_record` makes.

    Args:
        joint_count: number of joints n of the arm.
    """
    columns = (
        Column(name, unit, width or joint_count, text, *dtype)
        for _, name, unit, width, text, *dtype in _COLUMNS
    )
    durations = zip(TickDurations._fields, _DURATIONS, strict=True)
    timing = (Column(name, "s", 1, what) for name, what in durations)
    return Stream(STREAM_NAME, (*columns, *_ESTIMATE_COLUMNS, *timing))


def tick_record(tick: Tick) -> tuple[object, ...]:
    """Make one record of `tick_stream`: a value for each column, in their order."""
    return (*_values(tick), *tick.estimates, *tick.durations)


Observer = Callable[[Measurement, TaskOutput], Estimates]
"""Computes online estimates from a tick's measurement and output, after the command is sent; NaN for none."""


class TickLog(Protocol):
    """Interface of a session's writer that the loop uses; no call may block."""

    @property
    def dropped(self) -> int:
        """Number of records lost because the buffer was full."""

    @property
    def failure(self) -> str | None:
        """Reason why records no longer reach the disk; None if they do."""

    def append(self, stream_name: str, record: tuple[object, ...]) -> object:
        """Append one record.

        Args:
            stream_name: name of the stream.
            record: a value for each column of the stream.
        """

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> object:
        """Append one event.

        Args:
            time_s: time on the robot's clock [s].
            kind: short word for filters.
            text: one sentence for people.
            data: values for programs.
        """


class Journal:
    """Passes each tick to the observer, if there is one, and logs it.

    A failing observer is switched off; failures of the log are counted. Neither stops the loop.
    """

    def __init__(self, log: TickLog, observer: Observer | None) -> None:
        self.log_failures = 0
        self.log_error = self.observer_error = ""  # the first failure of each
        self._log, self._observer = log, observer

    @property
    def log_trouble(self) -> str:
        """Reason why the log is incomplete; empty if none is known."""
        return self.log_error or self._log.failure or ""

    @property
    def dropped(self) -> int:
        """Number of records lost because the log was full."""
        return self._log.dropped

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """Ask the observer for its estimates, NaN if there are none.

        Args:
            measurement: state of the arm.
            output: the task's output for this measurement.
        """
        if self._observer is None:
            return NO_ESTIMATE
        try:
            stiffness_n_m, damping_n_s_m, surface_m = self._observer(measurement, output)
            return float(stiffness_n_m), float(damping_n_s_m), float(surface_m)
        except Exception as error:
            self._observer = None
            self.observer_error = error_text(error)
            text = f"online estimation is off: {self.observer_error}"
            self.event(measurement.time_s, "observer_failed", text)
            return NO_ESTIMATE

    def log_tick(self, tick: Tick) -> None:
        """Log a tick's record and its events."""
        time_s, record = tick.measurement.time_s, tick_record(tick)
        try:
            self._log.append(STREAM_NAME, record)
        except Exception as error:
            self._log_failed(error, time_s)
        for event in tick.output.events:
            self.event(time_s, event.kind, event.text, event.data)

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> None:
        """See `TickLog.event`; a failure is counted."""
        try:
            self._log.event(time_s, kind, text, data)
        except Exception as error:
            self._log_failed(error, time_s)

    def _log_failed(self, error: Exception, time_s: float) -> None:
        self.log_failures += 1
        if not self.log_error:
            self.log_error = error_text(error)
            self.event(time_s, "log_failed", f"a record could not be logged: {self.log_error}")
