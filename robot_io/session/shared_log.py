"""Memory shared with the writer process: a ring per stream, a few words of state, and the job."""

import fcntl
import json
import mmap
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.session.event import EVENT_STREAM, MAX_EVENT_BYTES
from palpate.robot_io.session.stream import Record, RecordArray, Stream

_WAIT_S, _POLL_S = 1.0, 0.01  # limit and period of waiting for a program that only checks for a lock


def lock(file: BinaryIO) -> None:
    """Lock the file until it is closed; raise `SessionError` if another program uses it.

    Args:
        file: open for writing.
    """
    give_up_s = time.monotonic() + _WAIT_S
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > give_up_s:
                raise SessionError("another program uses it") from None
            time.sleep(_POLL_S)
        except OSError:  # a file system without locks, on which exclusive creation keeps others away
            return
        else:
            return


def is_locked(path: Path) -> bool:
    """Return whether a program is writing a file at this moment, if the file system shows it.

    Args:
        path: path of an existing file.
    """
    with suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe is not waited for
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(descriptor)
    return False


_LINE = 64  # bytes of a cache line; each counter has its own, so that the two sides do not slow each other
_HEAD, _TAIL, _DROPPED = range(3)
_HEADER = 3 * _LINE


class RingBuffer:
    """Ring of records in shared memory between two processes, of which neither waits for the other.

    Two counters that only grow describe the content. Only the producer moves the head, after it has written
    a record; only the consumer moves the tail, after it has copied one. If the ring is full, a record is
    dropped and counted, and its sequence number stays unused: a gap in the numbers shows missing records.

    Producer and consumer each make a `RingBuffer` on the same memory, and use it from one thread at a time.

    Args:
        memory: shared, of `size_bytes(dtype, slots)`, zero at first.
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
        """Compute the memory that a ring needs, in whole cache lines [bytes].

        Args:
            dtype: data type of a record.
            slots: number of records.
        """
        return _aligned(_aligned(_HEADER + slots * dtype.itemsize) + 8 * slots)

    @property
    def full(self) -> bool:
        """Whether the next record would be dropped."""
        return self._counters[_HEAD] - self._counters[_TAIL] >= self._slots

    @property
    def dropped(self) -> int:
        """Number of records that were dropped because the ring was full."""
        return self._counters[_DROPPED]

    @property
    def taken(self) -> int:
        """Number of records that the consumer has taken out."""
        return self._counters[_TAIL]

    @property
    def offered(self) -> int:
        """Number of records that the producer has offered, dropped ones included."""
        return self._counters[_HEAD] + self._counters[_DROPPED]

    def push(self, record: Record) -> None:
        """Producer: store one record, or count it as dropped.

        Args:
            record: tuple or np.void.
        """
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
        """Consumer: take out copies of the oldest sequence numbers and records, shape (n,) each.

        Args:
            at_most: largest number of records.
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
        """Keep earlier writes before later ones, even on CPUs that reorder writes (ARM)."""
        self._barrier.release()
        self._barrier.acquire()


def _aligned(size: int) -> int:
    return -(-size // _LINE) * _LINE


EVENT_SLOTS = 512
EVENT_DTYPE = np.dtype([("time_s", "<f8"), ("size", "<u4"), ("message", f"V{MAX_EVENT_BYTES}")])

STARTING, READY, FINISHED, FAILED = range(4)

_WORDS = 64  # bytes: state of the writer, stop request, length of the failure's text, its errno
_STATE, _STOP, _FAILURE_LENGTH, _ERRNO = range(4)
_FAILURE_BYTES = 960
_BLOCK = _WORDS + _FAILURE_BYTES


class SharedLog:
    """Shared memory with rings and state; both sides know its layout from streams and number of slots."""

    def __init__(self, memory: int, streams: Sequence[Stream], ring_slots: int) -> None:
        layout = _layout(streams, ring_slots)
        view = memoryview(mmap.mmap(memory, _size_bytes(layout)))
        self._words = view[:_WORDS].cast("Q")
        self._failure = view[_WORDS:_BLOCK]
        self.rings: dict[str, RingBuffer] = {}
        start = _BLOCK
        for name, dtype, slots in layout:
            end = start + RingBuffer.size_bytes(dtype, slots)
            self.rings[name] = RingBuffer(view[start:end], dtype, slots)
            start = end

    @property
    def state(self) -> int:
        """STARTING, READY, FINISHED or FAILED; set by the writer process."""
        return self._words[_STATE]

    @state.setter
    def state(self, value: int) -> None:
        self._words[_STATE] = value

    @property
    def stop_requested(self) -> bool:
        """Whether the program has requested that the file is finished."""
        return bool(self._words[_STOP])

    def request_stop(self) -> None:
        """Program: request that the rings are emptied and the file is finished."""
        self._words[_STOP] = 1

    @property
    def failure(self) -> str | None:
        """Reason why the writer process failed; None while it works."""
        if self._words[_STATE] != FAILED:
            return None
        return bytes(self._failure[: self._words[_FAILURE_LENGTH]]).decode(errors="replace")

    @property
    def system_error(self) -> OSError | None:
        """System error behind the failure; None if there is none."""
        number = self._words[_ERRNO]
        return OSError(number, os.strerror(number)) if number else None

    def fail(self, text: str, errno: int | None) -> None:
        """Writer process: stop with a failure.

        Args:
            text: reason.
            errno: the system's error number, if any.
        """
        self._words[_ERRNO] = errno or 0
        data = text.encode()[:_FAILURE_BYTES]
        self._failure[: len(data)] = data
        self._words[_FAILURE_LENGTH] = len(data)
        self._words[_STATE] = FAILED


def open_memory(streams: Sequence[Stream], ring_slots: int) -> int:
    """Allocate anonymous memory for a `SharedLog`, freed with its last process; return its descriptor.

    Args:
        streams: streams of the session.
        ring_slots: records of each ring.

    Raises:
        SessionError: there is not enough memory.
    """
    size = _size_bytes(_layout(streams, ring_slots))
    if hasattr(os, "memfd_create"):
        memory = os.memfd_create("palpate-log")
    else:
        with tempfile.TemporaryFile() as file:
            memory = os.dup(file.fileno())
    try:
        # Written rather than only reserved, so that no first access to a page delays the control loop.
        written = 0
        while written < size:
            written += os.write(memory, bytes(min(1 << 20, size - written)))
    except OSError as error:
        os.close(memory)
        raise SessionError(
            f"the log needs {size / 2**20:.1f} MiB of memory and cannot get it ({error.strerror}); "
            "free some memory, or raise the limit on the size of files (ulimit -f)"
        ) from error
    return memory


def check_streams(streams: Sequence[Stream]) -> None:
    """Raise `InputError` if a stream's name appears twice, or is that of the event stream.

    Args:
        streams: streams to check.
    """
    names = [stream.name for stream in streams]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"stream {', '.join(twice)} appears twice")
    if EVENT_STREAM in names:
        raise InputError(f"no stream can be called '{EVENT_STREAM}'; the session's events are kept there")


def _layout(streams: Sequence[Stream], ring_slots: int) -> list[tuple[str, np.dtype[np.void], int]]:
    return [(EVENT_STREAM, EVENT_DTYPE, EVENT_SLOTS), *((s.name, s.dtype, ring_slots) for s in streams)]


def _size_bytes(layout: Sequence[tuple[str, np.dtype[np.void], int]]) -> int:
    return _BLOCK + sum(RingBuffer.size_bytes(dtype, slots) for _, dtype, slots in layout)


MODULE = "palpate.robot_io.session.writer_process"


@dataclass(frozen=True)
class WriterJob:
    """One line of JSON on the writer process's standard input."""

    path: str  # the new session file
    memory: int  # file descriptor of the memory for `SharedLog`
    streams: str  # the streams as JSON text
    ring_slots: int  # records that each ring holds
    parent_pid: int  # process whose end also ends the session
    metadata: dict[str, str]  # the session's metadata
    extra: dict[str, str]  # the metadata's extra part

    def start(self) -> subprocess.Popen[str]:
        """Start the writer process: a new interpreter, out of reach of the terminal's Ctrl-C."""
        search_path = os.pathsep.join(filter(None, sys.path))
        process = subprocess.Popen(  # noqa: S603 - nothing in it comes from outside
            [sys.executable, "-P", "-m", MODULE],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=[self.memory],
            env=os.environ | {"PYTHONPATH": search_path, "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,
            text=True,
        )
        if process.stdin:
            with suppress(BrokenPipeError), process.stdin as pipe:  # a process that died is seen by its exit
                pipe.write(json.dumps(asdict(self)) + "\n")
        return process

    @classmethod
    def receive(cls, pipe: IO[str]) -> "WriterJob":
        """Read the job in the writer process.

        Args:
            pipe: its standard input.
        """
        return cls(**json.loads(pipe.readline()))
