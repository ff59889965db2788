"""A bus of Feetech servos, whose own position control generates the torques.

These servos have no torque mode and no watchdog: in their mode without position control they would continue
to run after the program has died. So a torque is commanded as a goal near the joint's present position, by
the servo's own law (`tables`). Without further commands, the joint stays near that goal. Torques are those of
the motor, from its duty cycle and speed; they do not include the friction of the gears.
"""

import struct
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import ceil, inf
from typing import Any, Final, NamedTuple

import numpy as np

from palpate.robot_io.clock import Clock
from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.feetech import protocol, tables
from palpate.robot_io.drivers.feetech.protocol import FeetechStatusReader, error_names
from palpate.robot_io.drivers.feetech.servos import FeetechLine, examine_servo
from palpate.robot_io.drivers.feetech.tables import POSITION_STEP_RAD, FeetechSettings
from palpate.robot_io.drivers.joint_bus import BusTorque
from palpate.robot_io.drivers.servo.bus import ServoBus, ServoEncoder
from palpate.robot_io.drivers.servo.feedback import FeedbackReader, FeedbackRequest
from palpate.robot_io.drivers.servo.stream import ServoAnswer
from palpate.robot_io.errors import DeviceError, LifecycleError, ProtocolError
from palpate.robot_io.examination import Finding, ok
from palpate.robot_io.serial_port import SerialPort
from palpate.robot_io.types import FloatArray, clip

# Torque enable, acceleration, goal, its time and speed, torque limit, five reserved bytes, lock, position,
# speed, load, voltage, temperature, a flag, errors.
_FORMAT: Final = struct.Struct("<BBHHHH5xBHHHBBxB")
FEEDBACK_SIZE: Final = _FORMAT.size
PADDING: Final = 7  # bytes before the block, by which the answers to different requests differ


_POSITION_SIGN = _SPEED_SIGN = 1 << 15  # a larger value is negative; see `tables`
_LOAD_SIGN = 1 << 10
_MOST_GOALS = 32  # remembered goals; more than are sent while an answer is late
_MARGIN_COUNTS = 16  # beyond the largest possible motion of a joint

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
    def fault_text(self) -> str:
        """Names of its errors, or an empty string."""
        return f"error: {error_names(self.errors)}" if self.errors else ""


def decode_feedback(packet: ServoAnswer) -> FeetechFeedback:
    """Decode the block at the end of an answer of at least `FEEDBACK_SIZE` bytes.

    Args:
        packet: answer of one servo.
    """
    data = packet.data
    on, acceleration, goal, time, fastest, limit, lock, position, speed, load, volts, celsius, errors = (
        _FORMAT.unpack_from(data, len(data) - FEEDBACK_SIZE)
    )
    position, speed = tables.PRESENT_POSITION.signed_value(position), tables.PRESENT_SPEED.signed_value(speed)
    settings, load = (acceleration, time, fastest, limit, lock), tables.PRESENT_LOAD.signed_value(load)
    return FeetechFeedback(on, errors, settings, goal, position, speed, load, volts, celsius)


class PlausibilityFilter:
    """Check that rejects implausible feedback of the servos of this bus.

    Args:
        clock: The robot's clock.
        settings: Settings sent to each servo, as in `FeetechFeedback.settings`, by its id.
        fastest_counts_s: Largest plausible speed of a joint [counts/s].
    """

    def __init__(self, clock: Clock, settings: Mapping[int, Settings], fastest_counts_s: float) -> None:
        self._clock, self._settings, self._fastest_counts_s = clock, settings, fastest_counts_s
        self._goals = {servo_id: deque[int](maxlen=_MOST_GOALS) for servo_id in settings}
        self._last_positions: dict[int, tuple[float, int]] = {}
        self._packed = {
            servo_id: (acceleration, struct.pack("<HHH", *speeds), lock)
            for servo_id, (acceleration, *speeds, lock) in settings.items()
        }

    def restart(self) -> None:
        """Reset the last positions and commands."""
        for goals in self._goals.values():
            goals.clear()
        self._last_positions.clear()

    def sent(self, goals: Mapping[int, int]) -> None:
        """Store the goals that were sent, by servo id.

        Args:
            goals: goals by servo id [counts].
        """
        for servo_id, goal in goals.items():
            self._goals[servo_id].appendleft(goal)

    def decode(self, packet: ServoAnswer) -> FeetechFeedback:
        """Decode the feedback in an answer.

        Args:
            packet: An answer of at least `FEEDBACK_SIZE` bytes.

        Raises:
            ProtocolError: The feedback is implausible.
            DeviceError: The servo has restarted.
        """
        feedback, servo_id = decode_feedback(packet), packet.servo_id
        if feedback.settings != self._settings[servo_id]:
            settings = zip(_SETTINGS, feedback.settings, self._settings[servo_id], strict=True)
            changed = [setting for setting in settings if setting[1] != setting[2]]
            name, reported, expected = changed[0]
            problem = f"servo {servo_id}: {name} is {reported} in place of {expected}"
            restarted = ("torque limit", tables.RESTARTED_LIMIT, 0)
            if len(changed) == 1 and (name, reported, feedback.torque_on) == restarted:
                raise DeviceError(f"{problem}: it has restarted")
            raise ProtocolError(f"{problem}: damaged, or it has restarted")
        goals = self._goals[servo_id]
        if feedback.torque_on and goals and feedback.goal not in goals:
            raise ProtocolError(
                f"servo {servo_id}: goal position is {feedback.goal} in place of {goals[0]}: "
                "its answer is damaged"
            )
        now_s = self._clock.now_s()
        last_s, last_position = self._last_positions.get(servo_id, (-inf, 0))
        allowed = _MARGIN_COUNTS + self._fastest_counts_s * (now_s - last_s)
        if abs(feedback.position - last_position) > allowed:
            raise ProtocolError(
                f"servo {servo_id} jumped from {last_position} to {feedback.position}: its answer is damaged"
            )
        self._last_positions[servo_id] = now_s, feedback.position
        return feedback

    def decode_all(
        self, rows: Iterable[tuple[Any, ...]], servos: Iterable[tuple[int, bytes]]
    ) -> list[FeetechFeedback] | None:
        """Decode plausible feedback of all servos, as in most ticks; faster than `decode` for each.

        Args:
            rows: fields of each servo's answer, see `_WHOLE_ANSWER`.
            servos: id of each servo, and the first bytes of its answer.

        Returns:
            The same as `decode` of each answer; None if something in them is unusual.
        """
        now_s, feedback = self._clock.now_s(), []
        for row, (servo_id, expected) in zip(rows, servos, strict=True):
            start, on, acceleration, goal, speeds, lock, position, speed, load, volts, celsius, errors = row
            settings, goals = self._settings[servo_id], self._goals[servo_id]
            last_s, last_position = self._last_positions.get(servo_id, (-inf, 0))
            if (
                start != expected
                or (acceleration, speeds, lock) != self._packed[servo_id]
                or position >= _POSITION_SIGN
                or (on and goals and goal not in goals)
                or abs(position - last_position) > _MARGIN_COUNTS + self._fastest_counts_s * (now_s - last_s)
            ):
                return None
            self._last_positions[servo_id] = now_s, position
            speed = speed if speed < _SPEED_SIGN else tables.PRESENT_SPEED.signed_value(speed)
            load = load if load < _LOAD_SIGN else tables.PRESENT_LOAD.signed_value(load)
            feedback.append(
                FeetechFeedback(on, errors, settings, goal, position, speed, load, volts, celsius)
            )
        return feedback


_SIZES = range(FEEDBACK_SIZE, FEEDBACK_SIZE + PADDING + 1)
# Header, id and length; torque enable, acceleration, goal, its time and speed with the torque limit, lock ...
_WHOLE_ANSWER: Final = {
    size: struct.Struct(f"<4sx{size - FEEDBACK_SIZE}xBBH6s5xBHHHBBxBx") for size in _SIZES
}


class FeetechReader(FeedbackReader[FeetechFeedback]):
    """Reads the feedback of all servos.

    Args:
        port: An open port.
        clock: Clock of the deadlines.
        servo_ids: Servos that are asked, in this order.
        plausibility: Check of their feedback.
    """

    _packets: FeetechStatusReader

    def __init__(
        self, port: SerialPort, clock: Clock, servo_ids: Sequence[int], plausibility: PlausibilityFilter
    ) -> None:
        end = tables.TORQUE_ENABLE.address + FEEDBACK_SIZE
        super().__init__(
            port,
            clock,
            servo_ids,
            asking={size: protocol.DIALECT.sync_read(end - size, size, servo_ids) for size in _SIZES},
            packets=FeetechStatusReader(largest=protocol.AROUND + FEEDBACK_SIZE + PADDING),
            decode=plausibility.decode,
            overhead=protocol.AROUND,
        )
        self._plausibility = plausibility
        self._servos = {
            size: [(servo_id, protocol.HEADER + bytes((servo_id, size + 2))) for servo_id in servo_ids]
            for size in _SIZES
        }

    def _decode_whole(self, request: FeedbackRequest, data: bytes) -> list[FeetechFeedback] | None:
        buffer, width = self._packets.pending + data, protocol.AROUND + request.size
        if len(buffer) != width * len(self._ids):
            return None
        sums = [sum(buffer[start : start + width]) & 0xFF for start in range(0, len(buffer), width)]
        if sums.count(protocol.WHOLE_SUM) < len(sums):
            return None
        rows, servos = _WHOLE_ANSWER[request.size].iter_unpack(buffer), self._servos[request.size]
        feedback = self._plausibility.decode_all(rows, servos)
        if feedback is not None:
            self._packets.pending = b""
        return feedback


_LEAST_DUTY = 0.1  # smallest torque limit, as a duty cycle
_FASTEST_SHARE = 2.0  # multiple of the no-load speed that a joint may reach when it is thrown


class FeetechBus(ServoBus):
    """Servos of the STS series; servos that only hold are read and monitored like joints."""

    name = "feetech_bus"
    _settings: FeetechSettings
    _line: FeetechLine

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(FeetechSettings, settings)
        models = [servo.servo_model for servo in validated.turning]
        self._stall_nm = [model.stall_torque_nm for model in models]
        direction = np.array([servo.direction for servo in validated.turning])
        step_rad = direction * POSITION_STEP_RAD
        step_nm = direction * np.array(self._stall_nm) * tables.DUTY_PER_LOAD
        super().__init__(validated, np.array((step_rad, step_rad, step_nm)), context)
        self._drag_nms_rad = [model.stall_torque_nm / model.no_load_rad_s for model in models]
        steps_rad: list[float] = self._joints.steps[0].tolist()
        stiffness_nm_rad = [stall_nm * validated.duty_per_rad for stall_nm in self._stall_nm]
        self._laws = list(zip(self._drag_nms_rad, self._stall_nm, stiffness_nm_rad, steps_rad, strict=True))
        self._half_tick_s = 0.5 / context.robot_file.control_rate_hz
        # Largest duty cycle of each servo, in its unit: for its torque at its speed. Those that hold stand
        # still, and may bear what the strongest servo of a joint may.
        limits, pairs = context.robot_file.limits, self._pairs
        servo_nm, speed_rad_s = (
            pairs.split_torques(limits.torque_nm),
            pairs.repeat_for_servos(limits.velocity_rad_s),
        )
        servos = zip(servo_nm, speed_rad_s, self._drag_nms_rad, self._stall_nm, strict=True)
        turning = [(torque + drag * speed) / stall for torque, speed, drag, stall in servos]
        held = max(torque / stall for torque, stall in zip(servo_nm, self._stall_nm, strict=True))
        duties = [max(duty, _LEAST_DUTY) for duty in (*turning, *len(validated.hold) * [held])]
        counts = [min(ceil(duty / tables.DUTY_PER_LOAD), tables.LARGEST_LIMIT) for duty in duties]
        torque_limits = dict(zip(validated.ids, counts, strict=True))
        self._line = FeetechLine(validated, torque_limits, self._port, context.clock)
        self._fastest_counts_s = (
            _FASTEST_SHARE * max(model.no_load_rad_s for model in models) / POSITION_STEP_RAD
        )
        expected_settings = {servo_id: (0, 0, 0, limit, 1) for servo_id, limit in torque_limits.items()}
        self._plausibility = PlausibilityFilter(context.clock, expected_settings, self._fastest_counts_s)
        self._servos = {servo.id: servo for servo in validated.turning}

    def _examine_servo(self, servo_id: int, label: str) -> list[Finding]:
        if servo_id in self._servos:
            return [examine_servo(self._line, self._servos[servo_id], label)]
        return [ok(label, "answers, and holds its position while the torque is on")]

    def _prepare_feedback(self) -> FeedbackReader[FeetechFeedback]:
        self._line.identify()
        self._line.prepare()
        self._plausibility.restart()
        return FeetechReader(self._port, self._clock, self._line.ids, self._plausibility)

    def _counts(self, feedback: Sequence[FeetechFeedback]) -> Sequence[Sequence[int]]:
        _, _, _, _, position, speed, load, _, _ = zip(*feedback, strict=True)
        return position, speed, load

    def _values(self, feedback: Sequence[FeetechFeedback]) -> list[float]:
        count = len(self._ids)
        feedback = feedback[:count]  # those that hold come last
        values = super()._values(feedback)
        speeds, loads = values[count : 2 * count], values[2 * count :]
        torques = zip(loads, speeds, self._drag_nms_rad, feedback, strict=True)
        values[2 * count :] = [
            (load - speed * drag) * servo.torque_on for load, speed, drag, servo in torques
        ]
        return values

    def _is_healthy(self, feedback: Sequence[FeetechFeedback]) -> bool:
        if [servo[:2] for servo in feedback] != [(int(self._powered), 0)] * len(feedback):
            return False
        speeds, fastest = [servo[5] for servo in feedback], self._fastest_counts_s
        return -fastest <= min(speeds) and max(speeds) <= fastest

    def _problem(self, feedback: Sequence[FeetechFeedback]) -> str | None:
        for label, servo in zip(self._labels, feedback, strict=True):
            if self._powered and not servo.torque_on:
                why = error_names(servo.errors) if servo.errors else "none; has it restarted?"
                return f"{label}: has switched its torque off (error: {why})"
            if abs(servo.speed) > self._fastest_counts_s:
                speed_rad_s = servo.speed * POSITION_STEP_RAD
                limit_rad_s = self._fastest_counts_s * POSITION_STEP_RAD
                return f"{label}: reports {speed_rad_s:.3g} rad/s, but its maximum is {limit_rad_s:.3g} rad/s"
        return None

    def _goals(self, torque_nm: list[float]) -> tuple[list[int], FloatArray]:
        """Compute goals from the servos' control law and predicted positions; see `ServoBus._goals`."""
        if self.sample is None:
            raise LifecycleError("read the servos first: a torque command starts from their positions")
        ahead_s = self._clock.now_s() - self.sample.sampled_at_s + self._half_tick_s
        position_rad, velocity_rad_s, _ = self.sample.servo_states.tolist()
        counts, sent_nm, highest = [], [], tables.COUNTS_PER_REVOLUTION - 1
        shares_nm, zeros_rad = self._pairs.split_torques(torque_nm), self._joints.offset_rad
        servos = zip(shares_nm, position_rad, velocity_rad_s, zeros_rad, self._laws, strict=True)
        for wanted_nm, angle_rad, speed_rad_s, zero_rad, law in servos:
            drag_nms_rad, stall_nm, stiffness_nm_rad, step_rad = law
            expected_rad, drag_nm = angle_rad + ahead_s * speed_rad_s, drag_nms_rad * speed_rad_s
            motor_nm = clip(wanted_nm + drag_nm, -stall_nm, stall_nm)
            goal = round((expected_rad + motor_nm / stiffness_nm_rad - zero_rad) / step_rad)
            goal = 0 if goal < 0 else min(goal, highest)
            counts.append(goal)
            sent_nm.append((goal * step_rad + zero_rad - expected_rad) * stiffness_nm_rad - drag_nm)
        self._plausibility.sent(dict(zip(self._ids, counts, strict=True)))
        return counts, np.array(self._pairs.sum_pairs(sent_nm))

    def _switch_on(self) -> None:
        self._plausibility.restart()
        self._plausibility.sent(self._line.switch_on())


class FeetechEncoder(ServoEncoder):
    """Positions and velocities from a `feetech_bus`."""

    name = "feetech_encoder"
    bus_type = FeetechBus


class FeetechTorque(BusTorque):
    """Torques of a `feetech_bus`, commanded and measured as duty cycles of the motors; see `FeetechBus`."""

    name = "feetech_torque"
    bus_type = FeetechBus
