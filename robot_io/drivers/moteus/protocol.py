"""The register protocol of moteus controllers: what is sent in CAN FD frames, and what is answered.

A frame is a row of subframes, each of which writes or reads registers, or answers. Every frame that is sent
here ends with the same question, so that every answer has the same form; one that has another is refused.

Sources: mjbots/moteus of 2026-04-06, docs/protocol/can.md and registers.md (subframes, registers, faults);
the order of answers: mjbots/mjlib, multiplex/micro_server.cc.
"""

import struct
from dataclasses import dataclass
from math import isfinite
from typing import Final

from robot_io.drivers.can.line import CanFrame, expect_length
from robot_io.errors import InputError, ProtocolError

STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11  # modes
RELATIVE, ROTOR, OUTPUT = 0, 1, 2  # what its position is known by: home state
FIRST_LIMIT: Final = 96  # from here on a fault code in a healthy mode says what limits the torque

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
_ANSWERED = 0x8000  # in an id: an answer is wanted
_VOLT = 0.5  # of supply voltage in a byte
_WATCHDOG_STEP_S = 1e-3


@dataclass(frozen=True, slots=True)
class MoteusState:
    """What a controller answers; position, velocity and torque are of its output."""

    mode: int
    position_rev: float
    velocity_rev_s: float
    torque_nm: float
    home: int  # what its position is known by
    supply_v: float
    temperature_c: float  # of the board
    fault: int  # a fault in mode FAULT, else what limits the torque; 0 is none

    @property
    def is_known(self) -> bool:
        """Whether it knows its position, velocity and torque."""
        return isfinite(self.position_rev + self.velocity_rev_s + self.torque_nm)

    @property
    def error(self) -> int:
        """What is wrong, see `FAULTS`; 0 is nothing."""
        if self.mode == FAULT:
            return self.fault or FAULT
        return TIMEOUT if self.mode == TIMEOUT else 0


def encode_stop(host_id: int, motor_id: int) -> CanFrame:
    """Let go, and forget faults."""
    return _frame(host_id, motor_id, _STOP)


def encode_question(host_id: int, motor_id: int) -> CanFrame:
    """Ask for the state, and change nothing."""
    return _frame(host_id, motor_id, _ASK)


def encode_torque(host_id: int, motor_id: int, torque_nm: float, watchdog_s: float) -> CanFrame:
    """Command a torque at the output [N m] that holds for `watchdog_s` [s]. InputError: it is no number."""
    if not isfinite(torque_nm):
        raise InputError(f"torque {torque_nm} N m is not finite")
    head, middle, tail = _COMMAND
    timeout = _WORD.pack(round(watchdog_s / _WATCHDOG_STEP_S))
    data = head + _FLOAT.pack(torque_nm) + middle + timeout + tail + _QUESTION + b"\x50\x50"
    return _frame(host_id, motor_id, data)


def as_sent(torque_nm: float) -> float:
    """A torque as the 32 bit float that travels [N m]."""
    return float(_FLOAT.unpack(_FLOAT.pack(torque_nm))[0])


def decode_state(frame: CanFrame) -> MoteusState:
    """What a controller answers. ProtocolError: wrong length, or not what was asked for."""
    expect_length(frame, "moteus state", _ANSWER.size)
    head, mode, floats, turns, speed, torque, rest, home, volts, celsius, fault = _ANSWER.unpack(frame.data)
    if (head, floats, rest) != _HEADS:
        raise ProtocolError(f"not what was asked for: {frame.data.hex(' ')}")
    return MoteusState(mode, turns, speed, torque, home, _VOLT * volts, celsius, fault)


def _frame(host_id: int, motor_id: int, data: bytes) -> CanFrame:
    return CanFrame(_ANSWERED | host_id << 8 | motor_id, data, extended=True, fd=True)
