"""Keeps the newest reading of a force sensor, taken in by a thread of its own."""

import os
import select
import threading
from math import isnan, nan
from typing import NamedTuple

from robot_io.clock import Clock, SimulatedClock
from robot_io.drivers.serial_force.own_time import OwnTime
from robot_io.drivers.serial_force.poll import Poll
from robot_io.drivers.serial_force.text import Stream

_LOOK_S = 1e-3  # the thread looks at least this often
_PROMPT_S = 2.5e-3  # between two looks: what is found at the second has just arrived
_DISCARD = 2  # readings after a damaged one; each time again soon after, so many times
_DISCARD_MORE = 4  # more, but no more than
_DISCARD_MOST = 1000
_SOON = 100  # good readings
_JUMP_SHARE = 0.01  # of the capacity; a reading that jumps by more needs the next one to confirm it


class ForceSample(NamedTuple):
    """One reading in the sensor's own sign [N], and when it arrived or should have, robot's clock [s]."""

    force_n: float
    arrived_at_s: float
    late_s: float = 0.0  # by how much it arrived later than it should have


class SerialReader:
    """Keeps the newest valid reading of a port; older ones that were not taken are gone.

    When more time than usual has passed between two looks at the port, nobody knows when its bytes came: they
    are taken to be as old as the look before. So a reader that falls behind shows an old sample and never a
    fresh one.

    Many protocols have no checksum. So after damaged data the next two readings are discarded, and more of
    them where that happens again; and a jump by more than 1 % of the capacity is accepted with the next
    reading only, if that stays there or goes on the same way: a lost byte or a flipped bit shows once. Where
    each reading has a checksum, none of this is needed.

    The port must not block. The stream waits `held_back_s` for what confirms a reading [s]. A reading that is
    late by the sensor's `own_time`, which the stream keeps, is dated back; one that a `poll` has asked for is
    as old as its question.

    Attributes:
        newest: the newest reading, None before the first.
        failure: why nothing can be read any more, or None.
    """

    def __init__(
        self,
        file_descriptor: int,
        stream: Stream,
        clock: Clock,
        capacity_n: float,
        held_back_s: float = 0.0,
        *,
        has_checksums: bool = False,
        own_time: OwnTime | None = None,
        poll: Poll | None = None,
    ) -> None:
        self._held_back_s, self._has_checksums, self._poll = held_back_s, has_checksums, poll
        self._own_time, self._is_prompt = own_time, False
        self._file_descriptor, self._stream, self._clock = file_descriptor, stream, clock
        self._looked_s = clock.now_s()
        self._to_discard, self._discard_next = 0, _DISCARD
        self._good = 0  # readings since the last damaged one
        self._jump_n = _JUMP_SHARE * capacity_n
        # Accepted; waiting for the next one; last accepted step.
        self._last_n = self._held_n = self._step_n = nan
        self._implausible = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.newest: ForceSample | None = None
        self.failure: str | None = None

    @property
    def rejected(self) -> int:
        """Damaged and implausible readings so far."""
        return self._stream.rejected + self._implausible

    @property
    def complaint(self) -> str:
        """What the sensor says is wrong with it, or nothing."""
        return self._stream.complaint

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
        if self.failure is not None or self._stop.is_set():
            return
        try:
            readable, _, _ = select.select([self._file_descriptor], [], [], wait_s)
            pieces = self._receive() if readable else [b""]
        except EOFError:
            self.failure = "the port was unplugged"
            return
        except (OSError, ValueError) as error:
            self.failure = f"the port failed ({error})"
            return
        now_s, before_s = self._clock.now_s(), self._looked_s
        self._looked_s = now_s
        self._is_prompt = now_s - before_s <= _PROMPT_S
        arrived_s = (now_s if self._is_prompt else before_s) - self._held_back_s
        for data in pieces:
            self._keep(data, arrived_s)
        if self._poll:
            self._ask(self._poll, now_s)

    def _receive(self) -> list[bytes]:
        """What has arrived, in the pieces that the stream is to be fed with. EOFError: there is no port."""
        data = os.read(self._file_descriptor, 65536)
        if not data:
            raise EOFError
        return [data]

    def _ask(self, poll: Poll, now_s: float) -> None:
        question = poll.to_send(now_s)
        try:
            if question:
                os.write(self._file_descriptor, question)
        except OSError as error:
            self.failure = f"the port failed ({error})"

    def _keep(self, data: bytes, read_s: float) -> None:
        arrived_s: float | None = read_s
        rejected = self._stream.rejected
        samples = self._stream.feed(data)
        is_damaged = self._stream.rejected != rejected
        if self._poll and (samples or is_damaged):
            asked_s = self._poll.answered(read_s)
            arrived_s = asked_s if len(set(samples)) <= 1 else None  # nobody asked for several
        late_s = 0.0
        if self._own_time and samples and arrived_s is not None:
            dated_s = self._own_time.sampled_at_s(arrived_s, prompt=self._is_prompt)
            arrived_s, late_s = dated_s, arrived_s - dated_s
        for force_n in self._undamaged(samples, is_damaged=is_damaged):
            if arrived_s is not None and (self._has_checksums or self._is_plausible(force_n)):
                self.newest = ForceSample(force_n, arrived_s, late_s)

    def _undamaged(self, samples: list[float], *, is_damaged: bool) -> list[float]:
        """The readings that have come, without those beside damaged ones or soon after them."""
        if self._has_checksums:
            return samples
        if is_damaged:
            self._to_discard, self._good = self._discard_next, 0
            self._held_n = nan
            if self.newest:  # what a device says of itself before its first reading is no damage
                self._discard_next = min(_DISCARD_MORE * self._discard_next, _DISCARD_MOST)
            return []
        self._good += len(samples)
        if self._good >= _SOON:
            self._discard_next = _DISCARD
        discarded, self._to_discard = self._to_discard, max(0, self._to_discard - len(samples))
        return samples[discarded:]

    def _is_plausible(self, force_n: float) -> bool:
        """Whether a reading is near the last one, or confirms a jump, or goes on with one that was confirmed.

        The very first is a jump: it may be a line that was cut.
        """
        last_n, held_n, jump_n = self._last_n, self._held_n, self._jump_n
        is_near = abs(force_n - last_n) <= jump_n
        before_n, step_before_n = (last_n, self._step_n) if isnan(held_n) else (held_n, held_n - last_n)
        step_n = force_n - before_n
        goes_on = step_n * step_before_n > 0.0 and abs(step_n) <= 2.0 * abs(step_before_n) + jump_n
        if is_near or abs(step_n) <= jump_n or (goes_on and abs(step_before_n) > jump_n):
            self._step_n = force_n - last_n if is_near else step_n
            self._implausible += is_near and not isnan(held_n)
            self._last_n, self._held_n = force_n, nan
            return True
        self._implausible += not isnan(held_n)
        self._held_n = force_n
        return False

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and self.failure is None:
                self.look(_LOOK_S)
        except Exception as error:  # a thread must not end unseen
            self.failure = f"reading failed ({type(error).__name__}: {error})"
