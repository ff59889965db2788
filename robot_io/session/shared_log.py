"""What a program shares with its writer process: a ring per stream, a few words of state, and the job."""

import json
import mmap
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import IO

import numpy as np

from robot_io.errors import InputError, SessionError
from robot_io.session.event import EVENT_STREAM, MAX_EVENT_BYTES
from robot_io.session.ring import RingBuffer
from robot_io.session.stream import Stream

EVENT_SLOTS = 512
EVENT_DTYPE = np.dtype([("time_s", "<f8"), ("size", "<u4"), ("message", f"V{MAX_EVENT_BYTES}")])

STARTING, READY, FINISHED, FAILED = range(4)

_WORDS = 64  # bytes: state of the writer, wish of the program, length of the failure's text, its errno
_STATE, _STOP, _FAILURE_LENGTH, _ERRNO = range(4)
_FAILURE_BYTES = 960
_BLOCK = _WORDS + _FAILURE_BYTES


class SharedLog:
    """Rings and state at the same places for both sides, which know the streams and the number of slots.

    The memory is a file descriptor of `open_memory`.
    """

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
        """Whether the program wants the file finished."""
        return bool(self._words[_STOP])

    def request_stop(self) -> None:
        """Program: have the rings emptied and the file finished."""
        self._words[_STOP] = 1

    @property
    def failure(self) -> str | None:
        """Why the writer process gave up; None while it works."""
        if self._words[_STATE] != FAILED:
            return None
        return bytes(self._failure[: self._words[_FAILURE_LENGTH]]).decode(errors="replace")

    @property
    def system_error(self) -> OSError | None:
        """The system's error behind the failure; None if there is none."""
        number = self._words[_ERRNO]
        return OSError(number, os.strerror(number)) if number else None

    def fail(self, text: str, errno: int | None) -> None:
        """Writer process: give up, and say why; with the system's error number if it is one."""
        self._words[_ERRNO] = errno or 0
        data = text.encode()[:_FAILURE_BYTES]
        self._failure[: len(data)] = data
        self._words[_FAILURE_LENGTH] = len(data)
        self._words[_STATE] = FAILED


def open_memory(streams: Sequence[Stream], ring_slots: int) -> int:
    """File descriptor of anonymous memory for a `SharedLog`: it is gone with the last process that uses it.

    SessionError: the system does not give so much.
    """
    size = _size_bytes(_layout(streams, ring_slots))
    memory = os.memfd_create("palpate-log") if hasattr(os, "memfd_create") else _unlinked_file()
    try:
        # Written rather than only reserved: the control loop then meets no page for the first time.
        written = 0
        while written < size:
            written += os.write(memory, bytes(min(1 << 20, size - written)))
    except OSError as error:
        os.close(memory)
        raise SessionError(
            f"the log needs {size / 2**20:.1f} MiB of memory and cannot have it ({error.strerror}): "
            "free some, or raise the limit on the size of files (ulimit -f)"
        ) from error
    return memory


def _unlinked_file() -> int:
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def check_streams(streams: Sequence[Stream]) -> None:
    """Refuse streams that cannot live in one session.

    InputError: a name is there twice, or is the one of the events.
    """
    names = [stream.name for stream in streams]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"stream {', '.join(twice)} is there twice")
    if EVENT_STREAM in names:
        raise InputError(f"no stream can be called '{EVENT_STREAM}'; the session's events are kept there")


def _layout(streams: Sequence[Stream], ring_slots: int) -> list[tuple[str, np.dtype[np.void], int]]:
    return [(EVENT_STREAM, EVENT_DTYPE, EVENT_SLOTS), *((s.name, s.dtype, ring_slots) for s in streams)]


def _size_bytes(layout: Sequence[tuple[str, np.dtype[np.void], int]]) -> int:
    return _BLOCK + sum(RingBuffer.size_bytes(dtype, slots) for _, dtype, slots in layout)


MODULE = "robot_io.session.writer_process"


@dataclass(frozen=True)
class Job:
    """One line of JSON on the writer process's standard input."""

    path: str  # the new session file
    memory: int  # file descriptor of the memory for `SharedLog`
    streams: str  # the streams as JSON text
    ring_slots: int  # records that each ring holds
    parent_pid: int  # process whose end also ends the session
    metadata: dict[str, str]  # the session's metadata
    extra: dict[str, str]  # the metadata's extra part

    def start(self) -> subprocess.Popen[str]:
        """Start the writer process: a fresh interpreter, out of reach of the terminal's Ctrl-C."""
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
    def receive(cls, pipe: IO[str]) -> "Job":
        """Read the job at the other end."""
        return cls(**json.loads(pipe.readline()))
