"""What the loop hands on of each tick, to log and observer, without ever being stopped by them."""

from collections.abc import Callable, Mapping
from time import perf_counter

import numpy as np

from control.task import TaskOutput
from control.tick_log import TickLog
from control.tick_record import STREAM_NAME, TickDurations, TickRecord
from robot_io.types import FloatArray, Measurement

Observer = Callable[[np.void], tuple[float, float, float]]
"""Gets the record of a tick, which is only valid during the call; returns the online estimates of stiffness
[N/m], damping [N s/m] and the surface along the press direction [m], each NaN if there is none."""


class Journal:
    """Fills the record of each tick, shows it to the observer and logs it.

    Args:
        log: where records and events go.
        observer: the online estimator, or None.
        joint_count: number of joints n.
    """

    def __init__(self, log: TickLog, observer: Observer | None, joint_count: int) -> None:
        self.log_failures = 0
        self.log_error = ""  # the first failure
        self.observer_error = ""
        self._log = log
        self._observer = observer
        self._record = TickRecord(joint_count)

    @property
    def log_trouble(self) -> str:
        """Why the log is not complete, empty if it is, as far as is known."""
        return self.log_error or self._log.failure or ""

    @property
    def dropped(self) -> int:
        """Records that found no room in the log."""
        return self._log.dropped

    def tick(
        self,
        tick: int,
        measurement: Measurement,
        output: TaskOutput,
        *,
        sent_torque_nm: FloatArray,
        tripped: bool,
        durations: TickDurations,
    ) -> float:
        """Hand on one tick, see `TickRecord.fill`; returns the time that the observer took [s]."""
        row = self._record.fill(
            tick,
            measurement,
            output,
            sent_torque_nm=sent_torque_nm,
            tripped=tripped,
            durations=durations,
        )
        observer_s = 0.0 if tripped else self._observe(row, measurement.time_s)
        try:
            self._log.append(STREAM_NAME, row)
        except Exception as error:
            self._log_failed(error, measurement.time_s)
        for event in output.events:
            self.event(measurement.time_s, event.kind, event.text, event.data)
        return observer_s

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> None:
        """Log one event."""
        try:
            self._log.event(time_s, kind, text, data)
        except Exception as error:
            self._log_failed(error, time_s)

    def _observe(self, row: np.void, time_s: float) -> float:
        if self._observer is None:
            return 0.0
        begun = perf_counter()
        try:
            estimate = self._observer(row)
            observer_s = perf_counter() - begun
            self._record.add_estimate(estimate, observer_s)
        except Exception as error:
            observer_s = perf_counter() - begun
            self._observer = None
            self.observer_error = f"{type(error).__name__}: {error}"
            self.event(time_s, "observer_failed", f"online estimation is off: {self.observer_error}")
        return observer_s

    def _log_failed(self, error: Exception, time_s: float) -> None:
        self.log_failures += 1
        if not self.log_error:
            self.log_error = f"{type(error).__name__}: {error}"
            self.event(time_s, "log_failed", f"a record could not be logged: {self.log_error}")
