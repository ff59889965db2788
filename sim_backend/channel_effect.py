"""A hidden effect in one channel of a sensor that measures several."""

from collections.abc import Callable, Sequence

from sim_backend.hooks import SensorEffect

Transducer = Callable[[float, float], float]
"""Makes (time of the sample [s], value) into another value; it may remember the samples before."""


class ChannelEffect(SensorEffect):
    """Lets one value of a sample pass through a transducer.

    Args:
        index: of the value in the sample, from 0.
        transducer: what the value passes through.
        ahead_of_noise: see `SensorEffect`.
    """

    def __init__(self, index: int, transducer: Transducer, ahead_of_noise: bool) -> None:
        self._index = index
        self._transducer = transducer
        self.ahead_of_noise = ahead_of_noise

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self._index] = self._transducer(time_s, changed[self._index])
        return changed
