"""Feedback of Feetech servos: decoding, and rejection of what cannot be true."""

import struct
from collections import deque
from collections.abc import Mapping, Sequence
from math import inf
from operator import sub
from typing import Final, NamedTuple

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.feetech import protocol, tables
from palpate.robot_io.drivers.feetech.protocol import FeetechStatusReader, error_names
from palpate.robot_io.drivers.servo.feedback import FeedbackReader, FeedbackRequest
from palpate.robot_io.drivers.servo.stream import ServoAnswer
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.serial_port import SerialPort

# Torque enable, acceleration, goal, its time and speed, torque limit, five reserved bytes, lock, position,
# speed, load, three bytes (voltage, temperature, a flag), errors.
_FORMAT: Final = struct.Struct("<BBHHHH5xBHHH3xB")
FEEDBACK_SIZE: Final = _FORMAT.size
PADDING: Final = 7  # bytes before the block, by which the answers to different requests differ


_POSITION_SIGN = _SPEED_SIGN = 1 << 15  # a larger value is negative; see `tables`
_LOAD_SIGN = 1 << 10
_MOST_GOALS = 32  # remembered goals; more than are sent while an answer is late
_MARGIN_COUNTS = 16  # beyond the largest possible motion of a joint

_SETTINGS = ("acceleration", "goal time", "goal speed", "torque limit", "lock")
Settings = tuple[int, int, int, int, int]  # the values of these


class FeetechFeedback(NamedTuple):
    """State of all servos, in their own units; each field has one value per servo."""

    torque_on: Sequence[int]
    goal: Sequence[int]
    position: Sequence[int]
    speed: Sequence[int]
    load: Sequence[int]
    errors: Sequence[int]  # bits, see `error_names`

    @property
    def fault_texts(self) -> list[str]:
        """Names of each servo's errors, or an empty string."""
        return [f"error: {error_names(errors)}" if errors else "" for errors in self.errors]


def _make_feedback(values: tuple[int, ...]) -> FeetechFeedback:
    """Convert raw values, six per servo, one servo after the other; speeds and loads have sign bits."""
    on, goal, position = values[0::6], values[1::6], values[2::6]
    speeds, loads, errors = values[3::6], values[4::6], values[5::6]
    speed = [value if value < _SPEED_SIGN else _SPEED_SIGN - value for value in speeds]
    load = [value if value < _LOAD_SIGN else tables.PRESENT_LOAD.signed_value(value) for value in loads]
    return FeetechFeedback(on, goal, position, speed, load, errors)


class PlausibilityFilter:
    """Check that rejects implausible feedback of the servos of this bus.

    Args:
        clock: The robot's clock.
        settings: Settings sent to each servo, by its id, in the order of the answers.
        fastest_counts_s: Largest plausible speed of a joint [counts/s].
    """

    def __init__(self, clock: Clock, settings: Mapping[int, Settings], fastest_counts_s: float) -> None:
        self._clock, self._settings, self._fastest_counts_s = clock, settings, fastest_counts_s
        self._goals = deque[tuple[int, ...]](maxlen=_MOST_GOALS)  # of all servos, the newest first
        self.restart()

    def restart(self) -> None:
        """Reset the last positions and commands."""
        self._goals.clear()
        self._last_s = -inf
        self._last_positions: Sequence[int] = [0] * len(self._settings)

    def sent(self, goals: Sequence[int]) -> None:
        """Store goals that were sent.

        Args:
            goals: Goals of all servos, or of the first ones; the others keep theirs [counts].
        """
        others = self._goals[0][len(goals) :] if self._goals else ()
        self._goals.appendleft((*goals, *others))

    def decode(self, packets: Sequence[ServoAnswer]) -> FeetechFeedback:
        """Decode the feedback at the end of each servo's answer.

        Args:
            packets: An answer of at least `FEEDBACK_SIZE` bytes from each servo.

        Raises:
            ProtocolError: The feedback is implausible, or a servo has other settings.
            DeviceError: A servo has restarted.
        """
        values: tuple[int, ...] = ()
        for servo_id, _, data in packets:
            on, acceleration, goal, time, fastest, limit, lock, position, speed, load, errors = (
                _FORMAT.unpack_from(data, len(data) - FEEDBACK_SIZE)
            )
            settings = zip(
                _SETTINGS, (acceleration, time, fastest, limit, lock), self._settings[servo_id], strict=True
            )
            if changed := [setting for setting in settings if setting[1] != setting[2]]:
                name, value, expected = changed[0]
                fault = f"servo {servo_id}: {name} is {value} instead of {expected}"
                if len(changed) == 1 and (name, value, on) == ("torque limit", tables.RESTARTED_LIMIT, 0):
                    raise DeviceError(f"{fault}; it has restarted")
                raise ProtocolError(f"{fault}; its answer is damaged, or it has restarted")
            position = tables.PRESENT_POSITION.signed_value(position)
            values += on, goal, position, speed, load, errors
        feedback = _make_feedback(values)
        if problem := self.problem(feedback):
            raise ProtocolError(f"{problem}; its answer is damaged")
        return feedback

    def problem(self, feedback: FeetechFeedback) -> str | None:
        """Return what is implausible in goals or positions; None, and remember the positions, if nothing is.

        Args:
            feedback: Feedback of all servos.
        """
        now_s = self._clock.now_s()
        largest_step = _MARGIN_COUNTS + self._fastest_counts_s * (now_s - self._last_s)
        steps = list(map(sub, feedback.position, self._last_positions))
        if max(steps) > largest_step or min(steps) < -largest_step or feedback.goal not in self._goals:
            for k, servo_id in enumerate(self._settings):
                sent, goal = [goals[k] for goals in self._goals], feedback.goal[k]
                if feedback.torque_on[k] and sent and goal not in sent:
                    return f"servo {servo_id}: goal position is {goal} instead of {sent[0]}"
                if abs(steps[k]) > largest_step:
                    return (
                        f"position of servo {servo_id} jumped from {self._last_positions[k]} to "
                        f"{feedback.position[k]} counts"
                    )
        self._last_s, self._last_positions = now_s, feedback.position
        return None


class _WholeAnswer:
    """Form of the answers of all servos to a request for `size` bytes, one after the other."""

    def __init__(self, size: int, settings: Mapping[int, Settings]) -> None:
        padding = size - FEEDBACK_SIZE
        self._packets = struct.Struct(f"{protocol.AROUND + size}s" * len(settings))
        # Known bits: header, id and length; acceleration; goal's time and speed with the torque limit; lock;
        # the sign of the position. Then the values: the fields of `FeetechFeedback`.
        known = struct.Struct(f"<4s{2 + padding}xB2x6s5xBH9x")
        self._values = struct.Struct("<" + len(settings) * f"{5 + padding}xBxH12xHHH3xBx")
        mask = known.pack(b"\xff" * 4, 0xFF, b"\xff" * 6, 0xFF, _POSITION_SIGN)
        self._mask = int.from_bytes(len(settings) * mask, "little")
        expected = b"".join(
            known.pack(
                protocol.HEADER + bytes((servo_id, size + 2)),
                acceleration,
                struct.pack("<HHH", *speeds),
                lock,
                0,
            )
            for servo_id, (acceleration, *speeds, lock) in settings.items()
        )
        self._expected = int.from_bytes(expected, "little")

    def decode(self, data: bytes) -> FeetechFeedback | None:
        """Decode all feedback; None unless it is intact, with the sent settings and no negative position.

        Args:
            data: the answers of all servos, one after the other.
        """
        if len(data) != self._packets.size:
            return None
        if int.from_bytes(data, "little") & self._mask != self._expected:
            return None
        if not protocol.are_intact(self._packets.unpack(data)):
            return None
        return _make_feedback(self._values.unpack(data))


class FeetechReader(FeedbackReader[FeetechFeedback]):
    """Reads the feedback of all servos, asked in the order of their settings."""

    _packets: FeetechStatusReader

    def __init__(
        self,
        port: SerialPort,
        clock: Clock,
        settings: Mapping[int, Settings],
        plausibility: PlausibilityFilter,
    ) -> None:
        end = tables.TORQUE_ENABLE.address + FEEDBACK_SIZE
        sizes, servo_ids = range(FEEDBACK_SIZE, FEEDBACK_SIZE + PADDING + 1), tuple(settings)
        super().__init__(
            port,
            clock,
            servo_ids,
            asking={size: protocol.DIALECT.sync_read(end - size, size, servo_ids) for size in sizes},
            packets=FeetechStatusReader(largest=protocol.AROUND + FEEDBACK_SIZE + PADDING),
            decode=plausibility.decode,
            overhead=protocol.AROUND,
        )
        self._plausibility = plausibility
        self._whole = {size: _WholeAnswer(size, settings) for size in sizes}

    def _decode_whole(self, request: FeedbackRequest, data: bytes) -> FeetechFeedback | None:
        feedback = self._whole[request.size].decode(self._packets.pending + data)
        if feedback is None or self._plausibility.problem(feedback):
            return None
        self._packets.pending = b""
        return feedback
