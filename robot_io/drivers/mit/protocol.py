"""The MIT motor protocol: motion, gains and feed-forward torque packed into eight bytes.

Big-endian: position 16 bits, velocity 12, KP 12, KD 12, torque 12. An n bit number x stands for low + x (high
- low) / (2^n - 1); the ranges depend on the model, or are stated in the robot file.

Sources: CubeMars "AK Series Actuator Driver Manual" V1.0.8, section 5.3 (frames, special codes); Damiao,
"DM-J4310-2EC user manual" (feedback frame, registers). The protocol is that of the MIT Mini Cheetah's motor
controller; what differs between makers is in `makers`.
"""

from dataclasses import dataclass
from math import isnan

from robot_io.drivers.can.line import CanFrame, expect_length
from robot_io.errors import InputError


@dataclass(frozen=True, slots=True)
class MitRanges:
    """What the ends of the wire's numbers mean; each range goes from minus to plus the value."""

    position_rad: float  # of the output shaft [rad]
    velocity_rad_s: float  # of the output shaft [rad/s]
    torque_nm: float  # at the output shaft [N m]


ENTER_MOTOR_MODE = b"\xff\xff\xff\xff\xff\xff\xff\xfc"
EXIT_MOTOR_MODE = b"\xff\xff\xff\xff\xff\xff\xff\xfd"
CLEAR_ERROR = b"\xff\xff\xff\xff\xff\xff\xff\xfb"  # Damiao

MAX_16 = (1 << 16) - 1
_MAX_12 = (1 << 12) - 1
_ONLY_TORQUE = 0x8000 << 48 | 0x800 << 36  # position and velocity about zero, and both gains zero


@dataclass(frozen=True, slots=True)
class MitState:
    """What a motor answers."""

    motor_id: int  # which motor
    position_rad: float  # of the output shaft [rad]
    velocity_rad_s: float  # of the output shaft [rad/s]
    torque_nm: float  # at the output shaft [N m]
    # Whether a value is at the end of its range, so that the true one may lie beyond.
    at_range_end: bool
    error: int  # see the maker's table; 0 is none. Old firmware does not send it
    # Whether the motor is in motor mode; None where it does not say so.
    enabled: bool | None


def encode_torque(motor_id: int, torque_nm: float, ranges: MitRanges) -> tuple[CanFrame, float]:
    """The frame for a torque at the output shaft, cut at the range, and what it says, after rounding [N m].

    Zero torque is half a step off, for 4095 is odd. InputError: the torque is not a number.
    """
    bits = to_bits(torque_nm, -ranges.torque_nm, ranges.torque_nm, _MAX_12)
    frame = CanFrame(motor_id, (_ONLY_TORQUE | bits).to_bytes(8, "big"))
    return frame, from_bits(bits, ranges.torque_nm, _MAX_12)


def decode_state(frame: CanFrame, ranges: MitRanges, *, status_beside_id: bool = False) -> MitState:
    """What a motor answers: id, position 16 bits, velocity 12, torque 12, and then temperature and error.

    With `status_beside_id` the id has four bits, with four of a status above it: 0 is off, 1 on, more an
    error; the last two bytes are temperatures then.

    ProtocolError: wrong length.
    """
    expect_length(frame, "motor state", *((8,) if status_beside_id else (6, 8)))
    data = frame.data
    position = data[1] << 8 | data[2]
    velocity = data[3] << 4 | data[4] >> 4
    torque = (data[4] & 0xF) << 8 | data[5]
    motor_id, error, enabled = data[0], data[7] if len(data) == 8 else 0, None
    if status_beside_id:
        motor_id, status = data[0] & 0xF, data[0] >> 4
        error, enabled = (status if status > 1 else 0), status == 1
    return MitState(
        motor_id=motor_id,
        position_rad=from_bits(position, ranges.position_rad, MAX_16),
        velocity_rad_s=from_bits(velocity, ranges.velocity_rad_s, _MAX_12),
        torque_nm=from_bits(torque, ranges.torque_nm, _MAX_12),
        at_range_end=position in (0, MAX_16) or velocity in (0, _MAX_12),
        error=error,
        enabled=enabled,
    )


def to_bits(value: float, low: float, high: float, largest: int) -> int:
    """The number from 0 to `largest` that stands for a value. InputError: it is not a number."""
    if isnan(value):
        raise InputError("a motor command is not a number")
    return round((min(max(value, low), high) - low) / (high - low) * largest)


def from_bits(bits: int, half_range: float, largest: int) -> float:
    """What a number from 0 to `largest` stands for, from -half_range to half_range."""
    return (2.0 * bits / largest - 1.0) * half_range
