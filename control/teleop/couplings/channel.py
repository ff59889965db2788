"""Which of the packets that have come a side is given in a step.

Packets are numbered by the step in which they were sent. One that is not finite never came.
"""

import heapq
import math
from abc import ABC, abstractmethod

Packet = tuple[float, ...]  # what one side sends the other in a step
_LONGEST = 10_000  # steps: a packet that is behind the newest by more says nothing about the link


class Channel(ABC):
    """One side's end of the link; pure. `take` whatever has come, then `packet` once in each step."""

    def take(self, number: int, packet: Packet) -> None:
        """Take in a packet that has come, sent in the sender's step `number`."""
        if math.isfinite(sum(packet)):
            self._take(number, packet)

    @abstractmethod
    def _take(self, number: int, packet: Packet) -> None:
        """The same for a packet that is finite."""

    @abstractmethod
    def packet(self) -> Packet | None:
        """What the side is given in this step; None as long as there is nothing."""


class Newest(Channel):
    """The newest one; what it has overtaken is dropped."""

    def __init__(self) -> None:
        self._number = -1
        self._packet: Packet | None = None

    def _take(self, number: int, packet: Packet) -> None:
        if number > self._number:
            self._number, self._packet = number, packet

    def packet(self) -> Packet | None:
        """See `Channel.packet`."""
        return self._packet


class Playout(Channel):
    """A playout buffer: each packet waits until it is as old as the oldest that ever came.

    So jitter becomes a constant delay, for which waves are made (Kosuge, Murayama and Takeo, "Bilateral
    feedback control of telemanipulators via computer network", IROS 1996). Where a packet is lost, the one
    before it stands.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, Packet]] = []
        self._step = self._played = self._newest = -1
        self._oldest = -math.inf  # steps from sending to arrival, by counts that may begin apart
        self._packet: Packet | None = None

    def _take(self, number: int, packet: Packet) -> None:
        if number <= self._played or number < self._newest - _LONGEST:
            return
        self._newest = max(self._newest, number)
        self._oldest = max(self._oldest, self._step + 1 - number)
        heapq.heappush(self._waiting, (number, packet))

    def packet(self) -> Packet | None:
        """See `Channel.packet`."""
        self._step += 1
        while self._waiting and self._waiting[0][0] + self._oldest <= self._step:
            self._played, self._packet = heapq.heappop(self._waiting)
        return self._packet
