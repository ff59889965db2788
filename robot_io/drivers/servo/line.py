"""The servos of one line as a whole: who is there, and torque off."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from robot_io.drivers.servo.access import RegisterAccess
from robot_io.drivers.servo.dialect import Dialect
from robot_io.drivers.servo.register import Register
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.serial_port import SerialPort

_SWITCH_OFF_ATTEMPTS = 3


class TorqueSwitch(NamedTuple):
    """How a maker's servos are let go."""

    register: Register  # 0 is off
    last_resort: str  # what happens where a servo cannot be told anything


def check_all_there(access: RegisterAccess, servo_ids: Sequence[int], baud_rate: int, ping_size: int) -> None:
    """Ping everybody. DeviceError: somebody does not answer; with all who do not, and all who do."""
    missing = [servo_id for servo_id in servo_ids if not _is_there(access, servo_id, ping_size)]
    if missing:
        there = ", ".join(str(servo_id) for servo_id in servo_ids if servo_id not in missing) or "none"
        raise DeviceError(
            f"no answer from servo {', '.join(map(str, missing))} at {baud_rate} bit/s "
            f"(answering: {there}): check power, cable, id and baud rate"
        )


def _is_there(access: RegisterAccess, servo_id: int, ping_size: int) -> bool:
    try:
        access.ping(servo_id, ping_size)
    except DeviceTimeoutError:
        return False
    return True


def switch_off(
    dialect: Dialect, port: SerialPort, access: RegisterAccess, servo_ids: Iterable[int], switch: TorqueSwitch
) -> None:
    """Torque off, asked of every servo until it says so.

    DeviceError: some did not say so, by id.
    """
    still_on, problem = list(servo_ids), ""
    off = switch.register.encode(0)
    for _ in range(_SWITCH_OFF_ATTEMPTS):
        port.write(dialect.sync_write(switch.register.address, dict.fromkeys(still_on, off)))
        failures = [(servo_id, _why_still_on(access, port, servo_id, switch)) for servo_id in still_on]
        still_on = [servo_id for servo_id, failure in failures if failure]
        problem = "; ".join(failure for _, failure in failures if failure)
        if not still_on:
            return
    raise DeviceError(f"torque not known to be off: {problem}; {switch.last_resort}")


def _why_still_on(
    access: RegisterAccess, port: SerialPort, servo_id: int, switch: TorqueSwitch
) -> str | None:
    try:
        on = access.read(servo_id, switch.register)
    except DeviceError as error:
        if not port.is_open:
            raise
        return str(error)
    return f"servo {servo_id}: says that it is on" if on else None
