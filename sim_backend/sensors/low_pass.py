"""First-order low-pass, exact for a signal that is held over each step."""

from collections.abc import Sequence
from math import exp, pi


class LowPass:
    """dy/dt = 2 pi f (u - y), for several signals at once.

    Args:
        bandwidth_hz: corner frequency f [Hz], where the gain is 1/sqrt(2).
        step_s: time between two calls [s].
    """

    def __init__(self, bandwidth_hz: float, step_s: float) -> None:
        self._gain = 1.0 - exp(-2.0 * pi * bandwidth_hz * step_s)
        self._output: list[float] | None = None

    def filter(self, signal: Sequence[float]) -> list[float]:
        """The output after one more step; the first call starts settled at `signal`."""
        if self._output is None:
            self._output = list(signal)
        else:
            gain = self._gain
            self._output = [y + gain * (u - y) for u, y in zip(signal, self._output, strict=True)]
        return self._output
