"""A link in one process: delay, jitter and loss of packets each way."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from control.teleop.couplings.coupling import Packet

_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class LinkFaults:
    """What the link does to packets, each way."""

    delay_s: float = 0.0
    jitter_s: float = (
        0.0  # packets come up to so much later, evenly distributed; they may overtake each other
    )
    loss: float = 0.0  # share of packets that never come, independently

    def __str__(self) -> str:
        return f"{1e3 * self.delay_s:.0f} ms + {1e3 * self.jitter_s:.0f} ms, {100 * self.loss:.0f} %"


class Line:
    """One way of the link, which hands out the newest packet; a packet that was overtaken is dropped."""

    def __init__(self, faults: LinkFaults, rng: np.random.Generator) -> None:
        self._faults, self._rng = faults, rng
        self._under_way: deque[tuple[float, int, Packet]] = deque()
        self._number = self._newest_number = -1
        self._newest: Packet | None = None

    def send(self, packet: Packet, time_s: float) -> None:
        """Put a packet on the way at `time_s` [s]."""
        self._number += 1
        late, lost = self._rng.random(2)
        if lost >= self._faults.loss:
            arrives_s = time_s + self._faults.delay_s + late * self._faults.jitter_s
            self._under_way.append((arrives_s, self._number, packet))

    def newest(self, time_s: float) -> Packet | None:
        """The newest packet that has arrived by `time_s` [s], or None."""
        still: deque[tuple[float, int, Packet]] = deque()
        now_s = time_s + _ROUNDING_S
        while self._under_way and self._under_way[0][0] <= now_s + self._faults.jitter_s:
            arrives_s, number, packet = self._under_way.popleft()
            if arrives_s > now_s:
                still.append((arrives_s, number, packet))
            elif number > self._newest_number:
                self._newest_number, self._newest = number, packet
        self._under_way.extendleft(reversed(still))
        return self._newest
