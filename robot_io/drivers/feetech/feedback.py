"""One sync read a tick: the state of all servos, and what it says of their health.

The block begins before the torque switch and ends with the error byte. What it holds beside position, speed
and load is known: the settings that were written, and the goal that was sent last. A byte that was lost or
damaged and got past the protocol's eight bits of checksum shows there, as does a servo that has restarted.
"""

import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Final, NamedTuple

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.feetech import protocol
from palpate.robot_io.drivers.feetech.protocol import FeetechStatusReader, error_names
from palpate.robot_io.drivers.feetech.tables import (
    POSITION_STEP_RAD,
    PRESENT_LOAD,
    PRESENT_POSITION,
    PRESENT_SPEED,
    RESTARTED_LIMIT,
    TORQUE_ENABLE,
)
from palpate.robot_io.drivers.servo.access import Packet
from palpate.robot_io.drivers.servo.feedback import FeedbackReader
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.serial_port import SerialPort

# Torque enable, acceleration, goal, its time and speed, torque limit, five reserved bytes, lock, position,
# speed, load, voltage, temperature, a flag, errors.
_FORMAT: Final = struct.Struct("<BBHHHH5xBHHHBBxB")
FEEDBACK_SIZE: Final = _FORMAT.size
PADDING: Final = 7  # bytes before the block, by which the answers to different requests differ


_POSITION_SIGN = _SPEED_SIGN = 1 << 15  # from here on a value is negative; see `tables`
_LOAD_SIGN = 1 << 10
_GOALS = 32  # more than are sent while an answer is late
_NEAR_COUNTS = 16  # beside what a joint can have turned

_SETTINGS = ("acceleration", "goal time", "goal speed", "torque limit", "lock")
Settings = tuple[int, int, int, int, int]  # the values of these


class FeetechFeedback(NamedTuple):
    """One servo's state, in its own units."""

    torque_on: int
    errors: int  # bits, see `error_names`
    settings: Settings
    goal: int
    position: int
    speed: int
    load: int
    voltage: int
    temperature: int

    @property
    def complaint(self) -> str:
        """Its errors by name, or nothing."""
        return f"error: {error_names(self.errors)}" if self.errors else ""


def decode_feedback(packet: Packet) -> FeetechFeedback:
    """Decode the block at the end of an answer of at least `FEEDBACK_SIZE` bytes.

    Args:
        packet: answer of one servo.
    """
    data = packet.data
    on, acceleration, goal, time, fastest, limit, lock, position, speed, load, volts, celsius, errors = (
        _FORMAT.unpack_from(data, len(data) - FEEDBACK_SIZE)
    )
    return FeetechFeedback(
        on,
        errors,
        (acceleration, time, fastest, limit, lock),
        goal,
        position if position < _POSITION_SIGN else PRESENT_POSITION.signed_value(position),
        speed if speed < _SPEED_SIGN else PRESENT_SPEED.signed_value(speed),
        load if load < _LOAD_SIGN else PRESENT_LOAD.signed_value(load),
        volts,
        celsius,
    )


def feedback_reader(
    port: SerialPort, clock: Clock, servo_ids: Sequence[int], decode: Callable[[Packet], FeetechFeedback]
) -> FeedbackReader[FeetechFeedback]:
    """Make the reader of the block of all servos.

    Args:
        port: An open port.
        clock: Clock of the deadlines.
        servo_ids: Servos that are asked, in this order.
        decode: Makes feedback of an answer; ProtocolError: it is not to be believed.
    """
    sizes = range(FEEDBACK_SIZE, FEEDBACK_SIZE + PADDING + 1)
    end = TORQUE_ENABLE.address + FEEDBACK_SIZE
    return FeedbackReader(
        port,
        clock,
        servo_ids,
        asking={size: protocol.DIALECT.sync_read(end - size, size, servo_ids) for size in sizes},
        packets=FeetechStatusReader(largest=protocol.AROUND + FEEDBACK_SIZE + PADDING),
        decode=decode,
        around=protocol.AROUND,
    )


class Plausibility:
    """Refuses feedback that cannot be what a servo of this bus says now.

    Args:
        clock: The robot's clock.
        settings: What each servo was told, as in `FeetechFeedback.settings`, by its id.
        fastest_counts_s: No joint is faster [counts/s].
    """

    def __init__(self, clock: Clock, settings: Mapping[int, Settings], fastest_counts_s: float) -> None:
        self._clock, self._settings, self._fastest_counts_s = clock, settings, fastest_counts_s
        self._goals = {servo_id: deque[int](maxlen=_GOALS) for servo_id in settings}
        self._last: dict[int, tuple[float, int]] = {}

    def restart(self) -> None:
        """Forget where the joints were, and what was sent."""
        for goals in self._goals.values():
            goals.clear()
        self._last.clear()

    def sent(self, goals: Mapping[int, int]) -> None:
        """Remember goals that are on their way, by servo id."""
        for servo_id, goal in goals.items():
            self._goals[servo_id].appendleft(goal)

    def decode(self, packet: Packet) -> FeetechFeedback:
        """Decode the feedback in an answer.

        Args:
            packet: An answer of at least `FEEDBACK_SIZE` bytes.

        Raises:
            ProtocolError: It is not to be believed.
            DeviceError: The servo has restarted.
        """
        feedback, servo_id = decode_feedback(packet), packet.servo_id
        if feedback.settings != self._settings[servo_id]:
            raise self._changed_setting(servo_id, feedback)
        goals = self._goals[servo_id]
        if feedback.torque_on and goals and feedback.goal not in goals:
            raise ProtocolError(
                f"servo {servo_id}: goal position is {feedback.goal} in place of {goals[0]}: "
                "its answer is damaged"
            )
        now_s = self._clock.now_s()
        before_s, before = self._last.get(servo_id, (-inf, 0))
        if abs(feedback.position - before) > _NEAR_COUNTS + self._fastest_counts_s * (now_s - before_s):
            raise ProtocolError(
                f"servo {servo_id} jumped from {before} to {feedback.position}: its answer is damaged"
            )
        self._last[servo_id] = now_s, feedback.position
        return feedback

    def _changed_setting(self, servo_id: int, feedback: FeetechFeedback) -> DeviceError:
        settings = zip(_SETTINGS, feedback.settings, self._settings[servo_id], strict=True)
        changed = [setting for setting in settings if setting[1] != setting[2]]
        name, shown, told = changed[0]
        problem = f"servo {servo_id}: {name} is {shown} in place of {told}"
        if len(changed) == 1 and (name, shown, feedback.torque_on) == ("torque limit", RESTARTED_LIMIT, 0):
            return DeviceError(f"{problem}: it has restarted")
        return ProtocolError(f"{problem}: damaged, or it has restarted")


def feedback_problem(
    feedback: Sequence[FeetechFeedback], labels: Sequence[str], fastest_counts_s: float, *, powered: bool
) -> str | None:
    """Say why some of the feedback cannot be trusted, or None.

    Args:
        feedback: Feedback of all servos.
        labels: What to call them, in the same order.
        fastest_counts_s: No joint is faster [counts/s].
        powered: Whether the torque was switched on.
    """
    for label, servo in zip(labels, feedback, strict=True):
        if powered and not servo.torque_on:
            why = error_names(servo.errors) if servo.errors else "none; has it restarted?"
            return f"{label}: has switched its torque off (error: {why})"
        if abs(servo.speed) > fastest_counts_s:
            speed_rad_s, fastest_rad_s = (c * POSITION_STEP_RAD for c in (servo.speed, fastest_counts_s))
            return f"{label}: shows {speed_rad_s:.3g} rad/s, more than it can do ({fastest_rad_s:.3g} rad/s)"
    return None
