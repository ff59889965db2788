"""One direction of a link that delays, jitters and loses packets."""

import heapq
import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")
_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class LinkFaults:
    """What the link does to packets, each way."""

    delay_s: float = 0.0
    jitter_s: float = 0.0  # largest additional delay, uniformly distributed; packets may overtake each other
    loss: float = 0.0  # share of packets that never come, independently

    def __str__(self) -> str:
        return f"{1e3 * self.delay_s:.0f} ms + {1e3 * self.jitter_s:.0f} ms, {100 * self.loss:.0f} %"


class DelayLine(Generic[T]):
    """One direction of the link, for packets of any kind."""

    def __init__(self, faults: LinkFaults, rng: np.random.Generator) -> None:
        self._faults, self._rng = faults, rng
        self._under_way: list[tuple[float, int, T]] = []
        self._number = -1

    def send(self, packet: T, time_s: float) -> None:
        """Put a packet on the way at `time_s` [s]."""
        self._number += 1
        late, lost = self._rng.random(2)
        if lost >= self._faults.loss:
            arrives_s = time_s + self._faults.delay_s + late * self._faults.jitter_s
            heapq.heappush(self._under_way, (arrives_s, self._number, packet))

    @property
    def next_s(self) -> float:
        """When the next packet arrives [s]; infinity while none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf

    def arrived(self, time_s: float) -> list[tuple[int, T]]:
        """Packets that have arrived by `time_s` [s] since the last call, each with its number."""
        arrived = []
        while self.next_s <= time_s + _ROUNDING_S:
            arrived.append(heapq.heappop(self._under_way)[1:])
        return arrived
