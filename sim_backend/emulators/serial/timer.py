"""When the readings of a stream are due."""

from math import inf


class StreamTimer:
    """Counts the readings of a stream out at a steady rate; those that were missed are not made up for.

    Args:
        rate_hz: readings a second [Hz].

    Attributes:
        running: whether the stream is on.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.running = False
        self._next_s = -inf

    def due(self, now_s: float) -> bool:
        """Whether one is due now."""
        if not self.running or now_s < self._next_s - 1e-9:
            return False
        period_s = 1.0 / self.rate_hz
        self._next_s = self._next_s + period_s if now_s - self._next_s < period_s else now_s + period_s
        return True
