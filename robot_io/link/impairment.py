"""A bad network, for trials: frames are delayed, jittered and lost on their way out, by a fixed seed."""

import heapq
from dataclasses import dataclass

import numpy as np

from robot_io.errors import InputError


@dataclass(frozen=True)
class Impairment:
    """How bad it is, one way."""

    delay_s: float = 0.0  # mean [s]
    jitter_s: float = 0.0  # standard deviation of the delay, which is never below 0 [s]
    loss: float = 0.0  # share of frames that are lost
    seed: int = 0

    def __post_init__(self) -> None:
        if not (0.0 <= self.delay_s <= 60.0 and 0.0 <= self.jitter_s <= 60.0):
            raise InputError(f"delay {self.delay_s} s, jitter {self.jitter_s} s: each 0 to 60 s")
        if not 0.0 <= self.loss < 1.0:
            raise InputError(f"loss {self.loss}: at least 0 and below 1")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"seed {self.seed}: at least 0 and below 2^63")


class BadNetwork:
    """Holds frames back as an `Impairment` says; frames may overtake each other."""

    def __init__(self, impairment: Impairment) -> None:
        self._is, self._rng = impairment, np.random.default_rng(impairment.seed)
        self._held: list[tuple[float, int, bytes]] = []
        self._count = 0

    def put(self, data: bytes, now_s: float) -> None:
        """Take a frame that is sent now [s]."""
        self._count += 1
        if self._rng.random() >= self._is.loss:
            delay_s = max(0.0, self._rng.normal(self._is.delay_s, self._is.jitter_s))
            heapq.heappush(self._held, (now_s + delay_s, self._count, data))

    def due(self, now_s: float) -> list[bytes]:
        """Frames that arrive up to now [s], in the order of their arrival."""
        arrived = []
        while self._held and self._held[0][0] <= now_s:
            arrived.append(heapq.heappop(self._held)[2])
        return arrived
