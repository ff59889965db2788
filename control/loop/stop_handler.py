"""Early stop of a run: signals, requests and failures trip the guard, and each cause is logged once."""

import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Any, Self

from palpate.control.loop.result import Outcome
from palpate.control.loop.tick_record import Journal
from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import error_text
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import Robot

# Ctrl-C, kill, closed terminal, and Ctrl-Z, because nobody commands the arm of a suspended program.
_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)


class InterruptFlag:
    """Context in which the signals that end or suspend a program only set a flag.

    A second Ctrl-C has no effect, because the safe stop is already as short as possible. Signals that the
    program's parent ignores (nohup, background jobs) stay ignored. Outside the main thread, where Python
    allows no handlers, the flag is never set.
    """

    def __init__(self) -> None:
        self.signal_name: str | None = None  # the first received signal
        self._former: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in _ENDING_SIGNALS:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._former[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._former.clear()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.signal_name = self.signal_name or signal.Signals(number).name


@dataclass
class StopHandler:
    """Turns requests to stop and failures into trips of the guard, each logged once.

    Attributes:
        stop: called once per tick; a non-empty reason ends the run.
        error: the exception behind the trip, if there was one.
    """

    guard: Guard
    robot: Robot
    clock: Clock
    journal: Journal
    interrupt: InterruptFlag
    stop: Callable[[], str]
    error: Exception | None = None  # what tripped the guard, if an exception did
    _on_request: bool = False
    _cause: str = ""
    _last_failure: str = ""

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run if it ends now."""
        if not self.guard.tripped:
            return Outcome.FINISHED
        return Outcome.STOPPED if self._on_request else Outcome.TRIPPED

    @property
    def cause(self) -> str:
        """Why the guard is tripped; empty if it is not."""
        self.log_trip()
        return self._cause

    def check_requests(self) -> None:
        """Trip the guard if the user or `stop` asks for it; no effect once it is tripped."""
        if self.guard.tripped:
            return
        if self.interrupt.signal_name:
            self._on_request = True
            self.guard.trip(f"interrupted by the user ({self.interrupt.signal_name})")
            return
        try:
            reason = self.stop()
        except Exception as error:
            self.fail("asking whether to stop", error)
            return
        if reason:
            self._on_request = True
            self.guard.trip(f"stopped: {reason}")

    def fail(self, what: str, error: BaseException) -> None:
        """Trip the guard for an exception, or log it if the guard is already tripped.

        Args:
            what: what failed, the beginning of the message.
            error: the exception; one that repeats in every tick is logged once.
        """
        if not isinstance(error, Exception):  # SystemExit and others count as failures
            error = RuntimeError(f"{type(error).__name__} {error}")
        text = f"{what}: {error_text(error)}"
        if not self.guard.tripped:
            self.error = error
            self.guard.trip(text)
        elif text != self._last_failure:  # a failure that repeats in each tick is logged once
            self.journal.event(self.clock.now_s(), "failure", text)
        self._last_failure = text

    def log_trip(self) -> None:
        """Log the trip if it is new."""
        trip = self.guard.tripped
        if trip and not self._cause:
            robot = self.robot
            troubles = {**robot.bus_delays, **robot.bus_errors}
            buses = (f"bus '{name}': {problem}" for name, problem in troubles.items())
            samples = (f"{device}: {problem}" for device, problem in robot.sample_errors.items())
            remedies = (trip.remedy,) if trip.remedy else ()
            self._cause = "; ".join((trip.cause, *buses, *samples, *remedies))
            self.journal.event(self.clock.now_s(), "stop" if self._on_request else "trip", self._cause)
