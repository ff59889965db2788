"""What the loop hands on of each tick, to log and observer, without ever being stopped by them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from control.loop.task import TaskEvent, TaskOutput
from control.loop.tick_record import NO_ESTIMATE, STREAM_NAME, Estimates
from robot_io.types import Measurement

Observer = Callable[[Measurement, TaskOutput], Estimates]
"""Looks at what was measured in a tick and what the task made of it, once the command is sent; returns the
online estimates, each NaN if there is none."""


class TickLog(Protocol):
    """The part of a session's writer that the loop needs; neither call may block."""

    @property
    def dropped(self) -> int:
        """Records that found no room and are lost."""

    @property
    def failure(self) -> str | None:
        """Why records no longer reach the disk; None while all is well."""

    def append(self, stream_name: str, record: tuple[object, ...]) -> object:
        """Take over one record, a value for each column of the stream."""

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> object:
        """Take over one event."""


class Journal:
    """Shows each tick to the observer, if there is one, and logs it."""

    def __init__(self, log: TickLog, observer: Observer | None) -> None:
        self.log_failures = 0
        self.log_error = self.observer_error = ""  # the first failure of each
        self._log, self._observer = log, observer

    @property
    def log_trouble(self) -> str:
        """Why the log is not complete, empty if it is, as far as is known."""
        return self.log_error or self._log.failure or ""

    @property
    def dropped(self) -> int:
        """Records that found no room in the log."""
        return self._log.dropped

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """What the observer makes of a tick."""
        if self._observer is None:
            return NO_ESTIMATE
        try:
            stiffness_n_m, damping_n_s_m, surface_m = self._observer(measurement, output)
            return float(stiffness_n_m), float(damping_n_s_m), float(surface_m)
        except Exception as error:
            self._observer = None
            self.observer_error = f"{type(error).__name__}: {error}"
            text = f"online estimation is off: {self.observer_error}"
            self.event(measurement.time_s, "observer_failed", text)
            return NO_ESTIMATE

    def tick(self, time_s: float, record: tuple[object, ...], events: Sequence[TaskEvent]) -> None:
        """Log a tick's record, see `control.loop.tick_record`, and what happened in it."""
        try:
            self._log.append(STREAM_NAME, record)
        except Exception as error:
            self._log_failed(error, time_s)
        for event in events:
            self.event(time_s, event.kind, event.text, event.data)

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> None:
        """Log one event."""
        try:
            self._log.event(time_s, kind, text, data)
        except Exception as error:
            self._log_failed(error, time_s)

    def _log_failed(self, error: Exception, time_s: float) -> None:
        self.log_failures += 1
        if not self.log_error:
            self.log_error = f"{type(error).__name__}: {error}"
            self.event(time_s, "log_failed", f"a record could not be logged: {self.log_error}")
