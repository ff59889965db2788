"""Delayed and damaged answers: none is dated later than its request."""

import random
import struct
from types import SimpleNamespace

import pytest

from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.drivers.dynamixel.servos import DynamixelAccess, feedback_reader
from palpate.robot_io.drivers.dynamixel.tables import DRIVE_MODE
from palpate.robot_io.errors import DeviceTimeoutError
from palpate.sim_backend.emulators import dynamixel

FAST_SYNC_READ, LENGTH = 0x8A, 5  # an instruction; a place in a packet


class LateLine:
    """Servos that answer `late_s` after each request; their position says which request that was.

    A third of the answers is `damaged`: a bit is flipped, or a byte lost.
    """

    def __init__(self, clock, late_s, *, damaged):
        self._clock, self._late_s, self._damaged = clock, late_s, damaged
        self._pending, self._random = bytearray(), random.Random(0)
        self._coming = []
        self.asked_at_s = []

    def write(self, data):
        now_s = self._clock.now_s()
        self._pending += data
        while instruction := dynamixel.parse_instruction(self._pending):
            size, ids = instruction.parameters[2], instruction.parameters[4:]
            block = struct.pack("<BBbhii", 1, 0, 3, 0, 0, len(self.asked_at_s)).rjust(size, b"\x01")
            self.asked_at_s.append(now_s)
            if instruction.code == FAST_SYNC_READ:
                answer = dynamixel.fast_status([(servo_id, 0, block) for servo_id in ids], len(ids))
            else:
                answer = b"".join(dynamixel.status(servo_id, 0, block) for servo_id in ids)
            self._coming.append((now_s + self._late_s, self._maybe_damaged(answer)))

    def _maybe_damaged(self, answer):
        if not self._damaged or self._random.random() > 0.3:
            return answer
        place = self._random.choice((LENGTH, self._random.randrange(len(answer))))
        bit = 1 << self._random.randrange(8)
        wrong = bytes((answer[place] ^ bit,)) if self._random.random() < 0.5 else b""
        return answer[:place] + wrong + answer[place + 1 :]

    def read_all(self):
        now_s = self._clock.now_s()
        came = b"".join(answer for at_s, answer in self._coming if at_s <= now_s)
        self._coming = [(at_s, answer) for at_s, answer in self._coming if at_s > now_s]
        return came

    def wait(self, deadline_s):
        next_s = min((at_s for at_s, _ in self._coming), default=deadline_s)
        self._clock.sleep_until(min(next_s, deadline_s))
        return self.read_all()


@pytest.mark.parametrize("damaged", [False, True], ids=["intact", "damaged"])
@pytest.mark.parametrize("fast", [True, False], ids=["fast", "plain"])
@pytest.mark.parametrize("servos", [1, 5])
@pytest.mark.parametrize("period_ms", [1, 3])
def test_no_answer_is_dated_later_than_its_request(damaged, fast, servos, period_ms):
    """A damaged length once made a late answer the newest: the wrong request was taken to be over."""
    for tenths_ms in range(2, 206, 17):
        clock = SimulatedClock()
        line = LateLine(clock, 1e-4 * tenths_ms, damaged=damaged)
        reader = feedback_reader(line, clock, range(1, servos + 1), 224, fast=fast)
        seen = 0
        for tick in range(120):
            clock.sleep_until(1e-3 * period_ms * (tick + 1))
            try:
                feedback, dated_s = reader.read(clock.now_s() + 0.6e-3 * period_ms)
            except DeviceTimeoutError:
                continue
            seen += 1
            asked_s = min(line.asked_at_s[position] for position in feedback.position)
            assert dated_s <= asked_s + 1e-9, tenths_ms
        assert seen > 0


@pytest.mark.parametrize("fast", [True, False], ids=["fast", "plain"])
def test_repeated_answer_is_no_new_feedback(fast):
    """The servos have fallen silent, and an adapter repeats what they said."""
    clock = SimulatedClock()
    line = LateLine(clock, 2e-4, damaged=False)
    reader = feedback_reader(line, clock, (1, 2), 224, fast=fast)
    answers = []
    line._maybe_damaged = lambda answer: answers.append(answer) or answer
    assert reader.read(1e-3)[1] == 0.0
    line.write = lambda _: None
    for repeated in range(1, 4):
        clock.sleep_until(1e-3 * repeated)
        line._coming = [(clock.now_s(), answers[0])]
        with pytest.raises(DeviceTimeoutError, match="did not answer in time"):
            reader.read(clock.now_s() + 5e-4)


def test_servo_that_refuses_to_be_read_is_named():
    clock = SimulatedClock()
    line = LateLine(clock, 2e-4, damaged=False)
    reader = feedback_reader(line, clock, (1, 2), 224, fast=False)
    refusal = dynamixel.status(1, 4)
    line._maybe_damaged = lambda answer: refusal + answer[len(answer) // 2 :]
    with pytest.raises(DeviceTimeoutError, match="servo 1 refuses to be read: the value is out of range"):
        reader.read(1e-3)


def test_late_answer_does_not_match_the_next_request():
    line = bytearray(dynamixel.status(1, 0, b"\x07"))
    came = lambda *_: bytes([line.pop(0) for _ in range(len(line))])  # noqa: E731
    port = SimpleNamespace(
        read_all=came,
        wait=came,
        duration_s=lambda _: 0.0,
        write=lambda _: line.extend(dynamixel.status(1, 0, b"\x04")),
    )
    assert DynamixelAccess(port, SimulatedClock()).read(1, DRIVE_MODE) == 4
