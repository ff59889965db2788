"""A sensor's own time, which tells when a reading came later than others did."""

from collections import deque
from itertools import pairwise
from math import inf

_CLOCKS_DIFFER = 1e-3  # by so much of the time: two crystals, and a rate that is stated in whole hertz
_WINDOW_S, _WINDOWS = 0.25, 4  # in whose shortest delays an error of the rate shows
_STEADY = 0.5  # share of the largest change between two windows by which changes may differ


class OwnTime:
    """Dates readings: none is younger than the shortest delay so far, from sampling to arrival, makes it.

    What always delays a reading shows nowhere; what has begun to, does. A sensor whose clock is off by more
    than 0.1 % seems to fall behind; one whose rate may be off by more is followed once its shortest delays
    have changed steadily for a second, where a reading that is late changes them once.

    Args:
        rate_error: Share by which the sensor's time may be off.
        longest_gap_s: After a longer silence nobody knows how far the sensor's time has gone on [s].
    """

    def __init__(self, rate_error: float = 0.0, longest_gap_s: float = inf) -> None:
        self._rate_error, self._longest_gap_s = rate_error, longest_gap_s
        self._rate = 1.0  # seconds of the host in one of the sensor's
        self.restart()

    def restart(self) -> None:
        """Begin anew: the sensor has restarted, and its time says nothing of earlier readings."""
        self._now_s = self._looked_s = 0.0  # on the sensor's clock
        self._arrived_s = inf
        self._delay_s = self._window_delay_s = inf  # the shortest; it holds how far the clocks are apart
        self._window_end_s, self._delays_s = _WINDOW_S, deque[float](maxlen=_WINDOWS)

    def goes_on(self, by_s: float) -> None:
        """The sensor's time of the newest reading is `by_s` after that of the one before [s]."""
        self._now_s += by_s * self._rate

    def sampled_at_s(self, arrived_at_s: float, *, prompt: bool) -> float:
        """When the newest reading was sampled at the latest, on the host's clock [s].

        It arrived at `arrived_at_s`; `prompt` is whether it was just then, and not perhaps later.
        """
        if arrived_at_s - self._arrived_s > self._longest_gap_s:
            self.restart()
        self._arrived_s = arrived_at_s
        if prompt:
            delay_s = arrived_at_s - self._now_s
            grown_s = self._delay_s + _CLOCKS_DIFFER * (self._now_s - self._looked_s)
            self._delay_s, self._looked_s = min(delay_s, grown_s), self._now_s
            self._follow_rate(delay_s)
        return min(arrived_at_s, self._now_s + self._delay_s)

    def _follow_rate(self, delay_s: float) -> None:
        """Correct the sensor's rate where its delays have changed steadily."""
        self._window_delay_s = min(self._window_delay_s, delay_s)
        if self._now_s < self._window_end_s:
            return
        self._delays_s.append(self._window_delay_s)
        self._window_delay_s, self._window_end_s = inf, self._now_s + _WINDOW_S
        changes = [after_s - before_s for before_s, after_s in pairwise(self._delays_s)]
        if len(changes) < _WINDOWS - 1:
            return
        largest_s = max(map(abs, changes))
        is_steady = max(changes) - min(changes) < _STEADY * largest_s
        if is_steady and _CLOCKS_DIFFER * _WINDOW_S < largest_s <= self._rate_error * _WINDOW_S:
            self._rate *= 1.0 + sum(changes) / len(changes) / _WINDOW_S
            self._delay_s = self._delays_s[-1] + max(changes[-1], 0.0)
            self._delays_s.clear()
