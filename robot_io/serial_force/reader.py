"""Reads a serial port so that neither a slow loop nor a slow reader makes an old reading look new."""

import os
import select
import threading
from typing import NamedTuple

from robot_io.clock import Clock, SimulatedClock
from robot_io.serial_force.framing import Stream

_LOOK_S = 1e-3  # the thread looks at least this often
_DOUBTED = 2  # readings after something that was none; each time again soon after, so many times
_MORE_DOUBTED = 4  # more, but no more than
_MOST_DOUBTED = 1000
_SOON = 100  # good readings
_PROMPT_S = 2.5e-3  # between two looks: what is found at the second has just arrived


class ForceSample(NamedTuple):
    """One reading.

    Attributes:
        force_n: in the sensor's own sign [N].
        arrived_at_s: not before this time, on the robot's clock [s].
    """

    force_n: float
    arrived_at_s: float


class SerialReader:
    """Keeps the newest reading of a port; older ones that were not taken are gone.

    When more time than usual has passed between two looks at the port, nobody knows when its bytes came:
    they are taken to be as old as the look before. So a reader that falls behind shows an old sample and
    never a fresh one.

    Many lines have no checksum: where something has been no reading, the next ones that look like readings
    may be damaged too. The first two after it are not believed, and more of them where that happens again.

    Args:
        file_descriptor: of the port, not blocking.
        stream: makes readings of bytes.
        clock: the robot's clock.
    """

    def __init__(self, file_descriptor: int, stream: Stream, clock: Clock) -> None:
        self._file_descriptor = file_descriptor
        self._stream = stream
        self._clock = clock
        self._looked_s = clock.now_s()
        self._newest: ForceSample | None = None
        self._doubted = 0  # readings still to come that are not believed
        self._to_doubt = _DOUBTED  # after the next that is none
        self._good = 0  # readings since the last that was none
        self._failure: str | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def newest(self) -> ForceSample | None:
        """The newest reading, or None before the first; never blocks."""
        return self._newest

    @property
    def failure(self) -> str | None:
        """Why nothing can be read any more, or None."""
        return self._failure

    @property
    def rejected(self) -> int:
        """How much was not a reading."""
        return self._stream.rejected

    def start(self) -> None:
        """Look at the port until `stop`: in a thread, or, on a simulated clock, whenever that has moved on.

        Simulated time stands still meanwhile, so that runs are repeatable.
        """
        if isinstance(self._clock, SimulatedClock):
            self._clock.subscribe(lambda _: self.look())
            return
        self._thread = threading.Thread(target=self._run, name="force sensor", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Do not look any more. Can be called again."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def look(self, wait_s: float = 0.0) -> None:
        """Take in what has arrived, after waiting for it at most `wait_s` [s]."""
        if self._failure is not None or self._stop.is_set():
            return
        try:
            readable, _, _ = select.select([self._file_descriptor], [], [], wait_s)
            data = os.read(self._file_descriptor, 65536) if readable else b""
            ended = bool(readable) and not data
        except (OSError, ValueError) as error:
            self._failure = f"the port failed ({error})"
            return
        now_s, before_s = self._clock.now_s(), self._looked_s
        self._looked_s = now_s
        if ended:
            self._failure = "the port was unplugged"
            return
        if samples := self._believed(data):
            prompt = now_s - before_s <= _PROMPT_S
            self._newest = ForceSample(samples[-1], now_s if prompt else before_s)

    def _believed(self, data: bytes) -> list[float]:
        """The readings in `data`, without those that come soon after something that was none."""
        rejected = self._stream.rejected
        samples = self._stream.feed(data)
        if self._stream.rejected != rejected:
            self._doubted, self._good = self._to_doubt, 0
            if self._newest:  # what a device says of itself before its first reading is no damage
                self._to_doubt = min(_MORE_DOUBTED * self._to_doubt, _MOST_DOUBTED)
            return []
        self._good += len(samples)
        if self._good >= _SOON:
            self._to_doubt = _DOUBTED
        doubted, self._doubted = self._doubted, max(0, self._doubted - len(samples))
        return samples[doubted:]

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and self._failure is None:
                self.look(_LOOK_S)
        except Exception as error:  # a thread must not end unseen
            self._failure = f"reading failed ({type(error).__name__}: {error})"
