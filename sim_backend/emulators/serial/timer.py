"""When the readings of a stream are due."""

from math import inf


class StreamTimer:
    """Counts the readings of a stream out at a steady rate; those that were missed are not made up for.

    The first one comes a period after the start.

    Args:
        rate_hz: readings a second [Hz].
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._next_s = inf

    @property
    def running(self) -> bool:
        """Whether the stream is on."""
        return self._next_s < inf

    def start(self, now_s: float) -> None:
        """The stream is on from now on."""
        self._next_s = now_s + self._period_s

    def stop(self) -> None:
        """The stream is off."""
        self._next_s = inf

    def due(self, now_s: float) -> bool:
        """Whether one is due now."""
        if now_s < self._next_s - 1e-9:
            return False
        missed = now_s - self._next_s >= self._period_s
        self._next_s = (now_s if missed else self._next_s) + self._period_s
        return True
