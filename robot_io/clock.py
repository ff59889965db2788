"""Clocks: the same loop runs on the machine's time and on simulated time."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable

_STALL_S = 0.02  # larger delays of simulated time are not caught up


class Clock(ABC):
    """A clock that only goes forward."""

    @abstractmethod
    def now_s(self) -> float:
        """Return the time since an arbitrary start [s]."""

    @abstractmethod
    def sleep_until(self, time_s: float) -> None:
        """Wait until a time on this clock; return at once if it has passed.

        Args:
            time_s: the time [s].
        """


class MonotonicClock(Clock):
    """The machine's monotonic clock, which is independent of steps of the wall clock."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep_until(self, time_s: float) -> None:
        remaining_s = time_s - time.monotonic()
        if remaining_s > 0:
            time.sleep(remaining_s)


class SimulatedClock(Clock):
    """Simulated time, which advances only in waits, as fast as the listeners allow.

    A simulated world subscribes and integrates its physics up to each new time.

    Args:
        pace: real clock that sets the pace (simulation in real time), or None for as fast as possible. A
            delay before the first step or between two steps is not caught up.
    """

    def __init__(self, pace: Clock | None = None) -> None:
        self._time_s = 0.0
        self._listeners: list[Callable[[float], None]] = []
        self._pace = pace
        self._pace_ahead_s: float | None = None  # lead of the real clock over this clock

    def subscribe(self, on_advance: Callable[[float], None]) -> None:
        """Call a function each time the clock has advanced.

        Args:
            on_advance: called with the new time [s].
        """
        self._listeners.append(on_advance)

    def now_s(self) -> float:
        return self._time_s

    def sleep_until(self, time_s: float) -> None:
        if not time_s > self._time_s:  # nor for NaN
            return
        if self._pace:
            now_s = self._pace.now_s()
            if self._pace_ahead_s is None or now_s - (self._pace_ahead_s + time_s) > _STALL_S:
                self._pace_ahead_s = now_s - self._time_s
            self._pace.sleep_until(self._pace_ahead_s + time_s)
        self._time_s = time_s
        for on_advance in self._listeners:
            on_advance(time_s)
