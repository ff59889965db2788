"""A ring of records in shared memory between two processes, of which neither ever waits for the other."""

import threading
from typing import Any

import numpy as np

from robot_io.session.stream import Record, RecordArray

_LINE = 64  # bytes; each counter on a cache line of its own, so that the two sides do not slow each other
_HEAD, _TAIL, _DROPPED = range(3)
_HEADER = 3 * _LINE


class RingBuffer:
    """Records of one dtype, each with its sequence number.

    Two counters that only grow say what is in the ring: the producer alone moves the head, after the record
    is in place, and the consumer alone moves the tail, after it has copied. A record that finds the ring full
    is counted, and uses up a sequence number: a gap in the numbers shows where records are missing.

    Each side has an object of its own on the same memory, and uses it from one thread at a time. The memory
    is shared, of `size_bytes(dtype, slots)`, and zero at first.
    """

    def __init__(self, memory: memoryview, dtype: np.dtype[np.void], slots: int) -> None:
        self._counters = memory[:_HEADER].cast("Q")[:: _LINE // 8]
        records_end = _HEADER + slots * dtype.itemsize
        self._records: RecordArray = np.frombuffer(memory[_HEADER:records_end], dtype)
        self._sequence: np.ndarray[Any, np.dtype[np.uint64]] = np.frombuffer(
            memory[_aligned(records_end) : _aligned(records_end) + 8 * slots], np.uint64
        )
        self._slots = slots
        self._barrier = threading.Lock()
        self._barrier.acquire()

    @staticmethod
    def size_bytes(dtype: np.dtype[np.void], slots: int) -> int:
        """Memory that a ring needs [bytes], a whole number of cache lines."""
        return _aligned(_aligned(_HEADER + slots * dtype.itemsize) + 8 * slots)

    @property
    def full(self) -> bool:
        """Whether the next record would be dropped."""
        return self._counters[_HEAD] - self._counters[_TAIL] >= self._slots

    @property
    def dropped(self) -> int:
        """Records that found the ring full."""
        return self._counters[_DROPPED]

    @property
    def taken(self) -> int:
        """Records that the consumer has taken out."""
        return self._counters[_TAIL]

    @property
    def offered(self) -> int:
        """Records that the producer has offered, dropped ones included."""
        return self._counters[_HEAD] + self._counters[_DROPPED]

    def push(self, record: Record) -> None:
        """Producer: put in one record (tuple or np.void), or count it as dropped."""
        head, dropped = self._counters[_HEAD], self._counters[_DROPPED]
        if head - self._counters[_TAIL] >= self._slots:
            self._counters[_DROPPED] = dropped + 1
            return
        slot = head % self._slots
        self._records[slot] = record
        self._sequence[slot] = head + dropped
        self._fence()
        self._counters[_HEAD] = head + 1

    def pop(self, at_most: int) -> tuple[np.ndarray[Any, np.dtype[np.uint64]], RecordArray]:
        """Consumer: take out the oldest records, from 0 to `at_most` of them.

        Returns copies of the sequence numbers, shape (n,), and of the records, shape (n,).
        """
        tail = self._counters[_TAIL]
        available = self._counters[_HEAD] - tail
        self._fence()
        slot = tail % self._slots
        end = slot + min(available, at_most, self._slots - slot)
        sequence, records = self._sequence[slot:end].copy(), self._records[slot:end].copy()
        self._fence()
        self._counters[_TAIL] = tail + end - slot
        return sequence, records

    def _fence(self) -> None:
        """Order the writes before it and those after it, also on CPUs that would exchange them (ARM)."""
        self._barrier.release()
        self._barrier.acquire()


def _aligned(size: int) -> int:
    return -(-size // _LINE) * _LINE
