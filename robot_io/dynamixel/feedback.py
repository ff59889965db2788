"""What is read of every servo in every tick, gathered into one block by indirect addressing.

Beside current, velocity and position the block holds what tells that a servo still does what it was told:
torque enable, hardware error status, and the bus watchdog. A servo that has restarted has forgotten which
registers make up the block, and shows zeros, so its watchdog is not the one that was set.
"""

import struct
from typing import Final, NamedTuple

from robot_io.dynamixel.packet import StatusPacket
from robot_io.dynamixel.registers import (
    BUS_WATCHDOG,
    HARDWARE_ERROR_STATUS,
    PRESENT_CURRENT,
    PRESENT_POSITION,
    PRESENT_VELOCITY,
    TORQUE_ENABLE,
)
from robot_io.errors import ProtocolError

_REGISTERS: Final = (
    TORQUE_ENABLE,
    HARDWARE_ERROR_STATUS,
    BUS_WATCHDOG,
    PRESENT_CURRENT,
    PRESENT_VELOCITY,
    PRESENT_POSITION,
)
_FORMAT: Final = struct.Struct("<BBbhii")
FEEDBACK_SIZE: Final = _FORMAT.size
PADDING: Final = 3  # bytes before the block, see `block_addresses`


class Feedback(NamedTuple):
    """One servo's state, in its own units.

    Attributes:
        torque_on: whether the motor is powered.
        hardware_error: hardware error status.
        watchdog: value of the bus watchdog; -1 when it has fired.
        current: present current.
        velocity: present velocity.
        position: present position, over several turns.
        alert: whether its answer carried the alert.
    """

    torque_on: int
    hardware_error: int
    watchdog: int
    current: int
    velocity: int
    position: int
    alert: bool


def block_addresses() -> tuple[int, ...]:
    """The addresses that the indirect data must stand for, in order.

    Some padding comes first: a request can start at any of its bytes, so that answers to successive requests
    differ in length and a late one is not taken for a new one.
    """
    block = [register.address + byte for register in _REGISTERS for byte in range(register.size)]
    return (*[TORQUE_ENABLE.address] * PADDING, *block)


def decode_feedback(packet: StatusPacket) -> Feedback:
    """The block at the end of an answer.

    Raises:
        ProtocolError: the servo refused, or the answer is too short.
    """
    if packet.refusal:
        raise ProtocolError(f"servo {packet.servo_id} refuses to be read: {packet.refusal}")
    if len(packet.data) < FEEDBACK_SIZE:
        raise ProtocolError(f"servo {packet.servo_id} answered {len(packet.data)} bytes, too few")
    values: tuple[int, int, int, int, int, int] = _FORMAT.unpack(packet.data[-FEEDBACK_SIZE:])
    return Feedback(*values, packet.alert)
