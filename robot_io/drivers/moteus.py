"""moteus controllers of mjbots on a CAN FD bus.

Torque control is position mode without gains and with feed-forward torque. A frame is a sequence of
subframes; each writes or reads registers, or answers. Every frame sent here ends with the same request, so
every answer has the same form; an answer of a different form is refused.

Sources: mjbots/moteus of 2026-04-06, docs/protocol/can.md and registers.md (subframes, registers, faults);
the order of answers: mjbots/mjlib, multiplex/micro_server.cc.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, tau
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field, model_validator

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.can.line import CanFrame, CanLineSettings, expect_length
from palpate.robot_io.drivers.can.motors import ANSWER_S, MotorMounting, PolledMotorBus
from palpate.robot_io.drivers.joint_bus import joint_drivers
from palpate.robot_io.errors import InputError, ProtocolError
from palpate.robot_io.examination import Finding, fail, ok, warn
from palpate.robot_io.files.file_model import Number
from palpate.robot_io.guard.limits import Torque
from palpate.robot_io.types import clip


class MoteusMotor(MotorMounting):
    """One controller with its motor. It reports at its output, so `gear_ratio` is the stage after it."""

    motor_id: Annotated[int, Field(ge=1, le=127, strict=True)]  # its CAN id
    max_torque_nm: Torque  # largest torque at its output, from servo.max_current_A [N m]


class MoteusBusSettings(CanLineSettings):
    """Settings in the robot file; `bitrate` is the arbitration rate, data travel at 5 Mbit/s."""

    fd: ClassVar = True

    motors: Annotated[tuple[MoteusMotor, ...], Field(min_length=1)]  # one per joint, from base to tip
    host_id: Annotated[int, Field(ge=0, le=127, strict=True)] = 0  # CAN id to which they answer
    # After how long without a command a controller stops [s]. Each command carries it, in milliseconds, and
    # it is left to expire once at each activation.
    watchdog_s: Annotated[Number, Field(ge=1e-3, le=1)] = 0.1

    @model_validator(mode="after")
    def _check_consistency(self) -> "MoteusBusSettings":
        ids = [motor.motor_id for motor in self.motors]
        if len({*ids, self.host_id}) <= len(ids):
            raise ValueError(f"motors: ids {ids} and host_id {self.host_id} are not all different")
        return self


STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11  # modes
RELATIVE, ROTOR, OUTPUT = 0, 1, 2  # home state: source of its position
FIRST_LIMIT: Final = 96  # from here on, a fault code in a healthy mode names the limit of the torque

FAULTS: Final = {
    0: "no fault",
    FAULT: "a fault without a code",
    TIMEOUT: "its watchdog has expired: too long without a command",
    32: "calibration fault",
    33: "motor driver fault",
    34: "over voltage",
    35: "encoder fault",
    36: "motor not configured",
    37: "PWM cycle overrun",
    38: "over temperature",
    39: "outside of servopos.position_min and position_max: set both to nan",
    40: "under voltage",
    41: "configuration changed",
    42: "no valid commutation encoder",
    43: "no valid output encoder",
    44: "driver enable fault",
    45: "stop position deprecated",
    46: "timing violation",
    47: "back EMF feedforward without an acceleration limit",
    48: "invalid limits",
    49: "position control error",
    50: "velocity control error",
}
ENCODER_FAULTS: Final = frozenset({35, 42, 43})
LIMITS: Final = {
    96: "servo.max_velocity",
    97: "servo.max_power_W",
    98: "the supply voltage",
    99: "servo.max_current_A",
    100: "servo.fault_temperature",
    101: "servo.motor_fault_temperature",
    102: "the commanded maximum torque",
    103: "servopos.position_min or position_max",
}

_QUESTION = bytes.fromhex("1100 1f01 10040c")  # mode; position, velocity, torque; four from the home state on
_STOP = bytes.fromhex("010000") + _QUESTION + b"\x50\x50"  # mode 0; no operation, up to a length of CAN FD
_ASK = _QUESTION + b"\x50"
# Position mode, at no position, with this torque, no stiffness and damping, this watchdog, and no integral.
_COMMAND = (bytes.fromhex("01000a 012080 0d22"), bytes.fromhex("02230000 0527"), bytes.fromhex("012b00"))
_FLOAT, _WORD = struct.Struct("<f"), struct.Struct("<h")
_ANSWER = struct.Struct("<2sb2s3f3s4b")
_HEADS = tuple(bytes.fromhex(head) for head in ("2100", "2f01", "20040c"))
_REQUESTS_ANSWER = 0x8000  # bit in an id that requests an answer
_VOLTS_PER_COUNT = 0.5  # supply voltage
_WATCHDOG_STEP_S = 1e-3


@dataclass(frozen=True, slots=True)
class MoteusState:
    """State of a controller; position, velocity and torque refer to its output."""

    mode: int
    position_rev: float
    velocity_rev_s: float
    torque_nm: float
    home: int  # source of its position
    supply_v: float
    temperature_c: float  # of the board
    fault: int  # a fault in mode FAULT, else what limits the torque; 0 is none

    @property
    def unknown(self) -> str:
        """Which values the controller does not know; an empty string if it knows all."""
        if isfinite(self.position_rev + self.velocity_rev_s + self.torque_nm):  # as in most ticks
            return ""
        values = {"position": self.position_rev, "speed": self.velocity_rev_s, "torque": self.torque_nm}
        return ", ".join(f"its {name} is {value}" for name, value in values.items() if not isfinite(value))

    @property
    def error(self) -> int:
        """Fault, see `FAULTS`; 0 for none."""
        if self.mode == FAULT:
            return self.fault or FAULT
        return TIMEOUT if self.mode == TIMEOUT else 0


def encode_torque(host_id: int, motor_id: int, torque_nm: float, watchdog_s: float) -> CanFrame:
    """Command a torque at the output that holds for a time; raise `InputError` if it is not a number.

    Args:
        host_id: CAN id of the sender.
        motor_id: CAN id of the controller.
        torque_nm: torque at the output [N m].
        watchdog_s: time for which the torque holds [s].
    """
    if not isfinite(torque_nm):
        raise InputError(f"torque {torque_nm} N m is not finite")
    head, middle, tail = _COMMAND
    timeout = _WORD.pack(round(watchdog_s / _WATCHDOG_STEP_S))
    data = head + _FLOAT.pack(torque_nm) + middle + timeout + tail + _QUESTION + b"\x50\x50"
    return _frame(host_id, motor_id, data)


def decode_state(frame: CanFrame) -> MoteusState:
    """Decode the answer of a controller; raise `ProtocolError` for another length or answer.

    Args:
        frame: received frame.
    """
    expect_length(frame, "moteus state", _ANSWER.size)
    head, mode, floats_head, turns, speed, torque, integers_head, home, volts, celsius, fault = (
        _ANSWER.unpack(frame.data)
    )
    if (head, floats_head, integers_head) != _HEADS:
        raise ProtocolError(f"unexpected answer: {frame.data.hex(' ')}")
    return MoteusState(mode, turns, speed, torque, home, _VOLTS_PER_COUNT * volts, celsius, fault)


def _frame(host_id: int, motor_id: int, data: bytes) -> CanFrame:
    return CanFrame(_REQUESTS_ANSWER | host_id << 8 | motor_id, data, extended=True, fd=True)


_ARBITRATION_BITS, _DATA_BITS, _DATA_BITRATE = 48, 37, 5_000_000  # around the data, with a 29 bit id
_COMMAND_BYTES, _ANSWER_BYTES = 32, 24
_NO_REFERENCE = "has no reference for its position (home state 0)"
_KNOWN_BY = {ROTOR: "the rotor alone, within one turn of the rotor", OUTPUT: "the output"}


class MoteusBus(PolledMotorBus[MoteusState]):
    """moteus controllers. Each command holds the watchdog's time; each activation tests the watchdog."""

    name = "moteus_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(MoteusBusSettings, settings)
        ids = [motor.motor_id for motor in validated.motors]
        super().__init__(validated, validated.motors, context, ids, validated.watchdog_s)
        self._settings, self._motors = validated, validated.motors
        self._observed_states: list[MoteusState | None] = [None] * len(ids)
        self._state_request_frames = [_frame(validated.host_id, motor_id, _ASK) for motor_id in ids]
        self._stops = [_frame(validated.host_id, motor_id, _STOP) for motor_id in ids]

    def configure(self) -> None:
        """Open the adapter and receive a state of every controller, without changing modes.

        Raises:
            DeviceError: the adapter cannot be opened, or a controller is silent or does not know its
                position.
        """
        self._receive_all()
        self._refuse_unreferenced()

    def _refuse_unreferenced(self) -> None:
        """Raise a DeviceError if a controller knows no position, or only one relative to its start."""
        for joint, state in enumerate(self._observed_states):
            if state is not None and state.home == RELATIVE:
                raise self._motor_error(joint, _NO_REFERENCE)
            if self._motion_is_wrong[joint]:
                error = self._errors[joint]
                cause = self._error_names(error) if error else state.unknown if state else ""
                raise self._motor_error(joint, f"does not know its position: {cause}")

    def _report(self) -> list[Finding]:
        self._observed_states = [None] * self.joint_count
        self._request_states(range(self.joint_count))
        self._wait_for(lambda: None not in self._observed_states, ANSWER_S)
        return [self._observe(joint, state) for joint, state in enumerate(self._observed_states)]

    def _observe(self, joint: int, state: MoteusState | None) -> Finding:
        label = self.motor_label(joint)
        if state is None:
            return fail(label, "does not answer", "check its power, cable, id and bit rates")
        value = (
            f"mode {state.mode}, {state.supply_v:.1f} V, {state.temperature_c:.0f} °C, position reference: "
        )
        value += _KNOWN_BY.get(state.home, "none")
        if state.error:
            names = self._error_names(state.error)
            return warn(label, f"{names}; {value}", "activation clears the fault; find its cause first")
        return ok(label, value)

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: a command to each controller, and its answer."""
        data_bits = 2 * _DATA_BITS + 8 * (_COMMAND_BYTES + _ANSWER_BYTES)
        arbitration_s = 2 * _ARBITRATION_BITS / (self.line.bitrate or 1_000_000)
        return self.joint_count * (arbitration_s + data_bits / _DATA_BITRATE)

    def power_on(self) -> None:
        self._unrequested = [0] * self.joint_count
        self._arm()
        self._check_unique_ids()
        self._refuse_unreferenced()  # it may have restarted since it was configured
        self._wait_for_watchdogs()
        self._exchange(self._state_request_frames)
        self._refuse_active(map(bool, self._enabled), "is still in position mode")
        self._arm()
        self._begin_commands()

    def _switch_off(self) -> None:
        self._switch_mode(self._stops, "torque off is not confirmed by", enabled=False)

    def _arm(self) -> None:
        """Clear faults and enter position mode at zero torque; raise `DeviceError` if one did not."""
        self._switch_mode(self._stops, "does not stop:", enabled=False)
        self._switch_mode(self._zero_torque(), "no position mode:", enabled=True)

    def _switch_mode(self, frames: list[CanFrame], problem: str, *, enabled: bool) -> None:
        """Send frames until answers show that all are in position mode, or stopped."""
        self._answers = [0] * self.joint_count

        def missing() -> list[str]:
            return [
                f"{self.motor_label(joint)} ({self._error_names(error) if error else 'no such answer'})"
                for joint, error in enumerate(self._errors)
                if self._answers[joint] < 2 or error or self._enabled[joint] is not enabled
            ]

        def is_done() -> bool:
            if is_missing := bool(missing()):
                self._send_all(frames)
            return not is_missing

        if not self._wait_for(is_done, ANSWER_S):
            raise self._not_confirmed(problem, missing())

    def _state_requests(self, joint: int) -> list[CanFrame]:
        # A lost controller that a torque has switched on again, before it was known to be lost, is stopped.
        is_stopped = self._lost[joint] and self._enabled[joint]
        return [self._stops[joint] if is_stopped else self._state_request_frames[joint]]

    def _joint_of(self, frame: CanFrame) -> int | None:
        is_answer = frame.fd and not frame.remote and frame.can_id & 0xFF == self._settings.host_id
        return self._joint_by_id.get(frame.can_id >> 8) if is_answer else None

    def _store_frame(self, joint: int, frame: CanFrame, at_s: float) -> bool:
        self._states[joint].append((decode_state(frame), at_s))
        return True

    def _answering_motor(self, frame: CanFrame) -> int | None:
        return frame.can_id & 0x7F

    def _condition(self, state: MoteusState) -> tuple[int, bool | None]:
        return state.error, state.mode == POSITION

    def _loss(self, state: MoteusState) -> str:
        return _NO_REFERENCE if state.home == RELATIVE else super()._loss(state)

    def _store_state(self, joint: int, state: MoteusState, requested_s: float) -> None:
        self._observed_states[joint] = state
        is_known, is_relative = not state.unknown, state.home == RELATIVE
        self._motion_is_wrong[joint] = is_relative or not is_known or state.error in ENCODER_FAULTS
        if is_known:
            self._store_motion(joint, tau * state.position_rev, tau * state.velocity_rev_s, requested_s)
            self._store_torque(joint, state.torque_nm, requested_s)
        self._motion_at_s[joint] = requested_s

    def _encode_shaft(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        motor = self._motors[joint]
        output_nm = clip(torque_nm, -motor.max_torque_nm, motor.max_torque_nm)
        frame = encode_torque(self._settings.host_id, motor.motor_id, output_nm, self._settings.watchdog_s)
        return frame, float(np.float32(output_nm))

    def _error_names(self, error: int) -> str:
        return FAULTS.get(error, f"unknown fault {error}")

    def _fault(self, joint: int, now_s: float) -> str:
        state = self._observed_states[joint]
        return super()._fault(joint, now_s) or (state.unknown if state else "")

    def _hint(self, joint: int) -> str:
        """See `MotorBus._hint`: a controller reports the cause of a reduced torque."""
        state = self._observed_states[joint]
        if state is None or state.error or state.fault < FIRST_LIMIT:
            return ""
        return f"its torque is limited by {LIMITS.get(state.fault, f'code {state.fault}')}"


MoteusEncoder, MoteusTorque = joint_drivers(MoteusBus, "moteus")
