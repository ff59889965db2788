"""The speed-optimised stream (mode 3) of Lorenz Messtechnik sensors, which has no checksum.

A sample is three bytes: a counter, and a signed 16 bit value, most significant byte first.
Source: see `lorenz`.
"""

from itertools import pairwise

_SYNC_SAMPLES = 4  # counters in a row before a stream is believed


class LorenzStream:
    """Samples of stream mode 3. Nothing but the counter tells where a sample begins: it must count on by one.

    After a gap the stream is believed again once four counters in a row fit. A flipped bit in a value does
    not
    show: the mode has no checksum.

    Args:
        newtons_per_count: newtons in one count.
    """

    def __init__(self, newtons_per_count: float) -> None:
        self._factor = newtons_per_count
        self._rest = b""
        self._next_counter: int | None = None  # None: searching
        self.rejected = 0

    def feed(self, data: bytes) -> list[float]:
        """See `Stream.feed`."""
        buffer, place, samples = self._rest + data, 0, []
        while True:
            if self._next_counter is None:
                place, found = self._search(buffer, place)
                if not found:
                    break
                self._next_counter = buffer[place]
            if place + 3 > len(buffer):
                break
            if buffer[place] != self._next_counter:
                self._next_counter = None
                self.rejected += 1
                continue
            samples.append(int.from_bytes(buffer[place + 1 : place + 3], "big", signed=True) * self._factor)
            self._next_counter = (self._next_counter + 1) & 0xFF
            place += 3
        self._rest = buffer[place:]
        return samples

    def _search(self, buffer: bytes, place: int) -> tuple[int, bool]:
        """Where a row of fitting counters begins; or where to look on when there is more.

        A slow ramp of the force counts on by one too: a row is believed only if no other one fits beside it.
        """
        while place + 3 * _SYNC_SAMPLES + 2 <= len(buffer):
            fitting = [shift for shift in range(3) if _counts_on(buffer[place + shift :: 3][:_SYNC_SAMPLES])]
            if len(fitting) == 1:
                return place + fitting[0], True
            place += 3 if fitting else 1
        return place, False


def _counts_on(counters: bytes) -> bool:
    return all((after - before) & 0xFF == 1 for before, after in pairwise(counters))
