"""A sensor's own time, which tells when a reading came later than others did."""

from math import inf

_CLOCKS_DIFFER = 1e-3  # by so much of the time: two crystals, and a rate that is stated in whole hertz


class OwnTime:
    """Dates readings: none is younger than the shortest delay so far, from sampling to arrival, makes it.

    What always delays a reading shows nowhere; what has begun to, does. A sensor whose clock is off by more
    than 0.1 % seems to fall behind.
    """

    def __init__(self) -> None:
        self._now_s = self._looked_s = 0.0  # on the sensor's clock
        self._delay_s = inf  # the shortest so far, and how far the two clocks are apart

    def goes_on(self, by_s: float) -> None:
        """The sensor's time of the newest reading is `by_s` after that of the one before [s]."""
        self._now_s += by_s

    def sampled_at_s(self, arrived_at_s: float, *, prompt: bool) -> float:
        """When the newest reading was sampled at the latest, on the host's clock [s].

        It arrived at `arrived_at_s`; `prompt` is whether it was just then, and not perhaps later.
        """
        if prompt:
            grown_s = self._delay_s + _CLOCKS_DIFFER * (self._now_s - self._looked_s)
            self._delay_s, self._looked_s = min(arrived_at_s - self._now_s, grown_s), self._now_s
        return min(arrived_at_s, self._now_s + self._delay_s)
