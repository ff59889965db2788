"""Looks at the servos of a line one by one, and for those that are not where the robot file has them."""

from collections.abc import Sequence
from typing import get_args

from robot_io.clock import Clock
from robot_io.drivers.dynamixel import protocol, tables
from robot_io.drivers.dynamixel.protocol import BROADCAST_ID, StatusReader
from robot_io.drivers.dynamixel.servos import DynamixelAccess
from robot_io.drivers.dynamixel.settings import DynamixelSettings, ServoSettings
from robot_io.drivers.dynamixel.tables import WATCHDOG_FIRMWARE, model_name
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.examination import Finding, fail, ok, warn
from robot_io.serial_port import SerialPort

_PING_ALL_S = 0.3  # all 253 ids have answered by then


def examine_servos(settings: DynamixelSettings, port: SerialPort, clock: Clock) -> list[Finding]:
    """What every servo of the robot file says of itself, and who else is there, on a port that stays open.

    DeviceError: the port failed.
    """
    there = _ids_on_line(port, clock)
    wanted = settings.ids
    if not set(there) & set(wanted):
        return _none_answers(settings, port, clock, there)
    access = DynamixelAccess(port, clock)
    strangers = [servo_id for servo_id in there if servo_id not in wanted]
    observations: list[Finding] = []
    for label, servo in zip(settings.labels, settings.turning, strict=True):
        if servo.id in there:
            observations += _look_at(access, servo, label)
        else:
            others = f", but {_listed(strangers)}, which the robot file does not have" if strangers else ""
            observations.append(
                fail(label, f"does not answer{others}", "check its cable and power, or set its id")
            )
    if strangers:
        remedy = "take it off the line, or correct the ids"
        observations.append(warn("other servos", f"{_listed(strangers)} on the line too", remedy))
    return observations


def _none_answers(
    settings: DynamixelSettings, port: SerialPort, clock: Clock, there: Sequence[int]
) -> list[Finding]:
    """None of the servos answers: others may, or all of them at another baud rate."""
    if there:
        value = f"{_listed(settings.ids)} silent, on the line are {_listed(there)}"
        return [fail("servos", value, "correct the ids in the robot file or in the servos")]
    for baud_rate in get_args(DynamixelSettings.model_fields["baud_rate"].annotation):
        found = _heard_at(baud_rate, port, clock) if baud_rate != settings.baud_rate else []
        if found:
            value = f"silent at {settings.baud_rate} bit/s; at {baud_rate} bit/s: {_listed(found)}"
            return [fail("servos", value, f"set baud_rate: {baud_rate}, or change it in the servos")]
    return [fail("servos", "nobody answers at any baud rate", "check power supply, cable and adapter")]


def _heard_at(baud_rate: int, port: SerialPort, clock: Clock) -> list[int]:
    port.close()
    other = SerialPort(port.path, baud_rate, clock)
    try:
        other.open()
        return _ids_on_line(other, clock)
    except DeviceError:  # the adapter does not know this rate
        return []
    finally:
        other.close()
        port.open()


def _ids_on_line(port: SerialPort, clock: Clock) -> list[int]:
    """The ids of everybody who answers."""
    port.read_all()
    reader, ids = StatusReader(), set()
    port.write(protocol.ping(BROADCAST_ID))
    deadline_s = clock.now_s() + _PING_ALL_S
    while clock.now_s() < deadline_s:
        ids |= {packet.servo_id for packet in reader.feed(port.wait(deadline_s))}
    return sorted(ids)


def _look_at(access: DynamixelAccess, servo: ServoSettings, label: str) -> list[Finding]:
    """Model, firmware, supply and errors of one servo."""
    try:
        number, firmware = access.who(servo.id)
        return [
            _model(servo, label, number, firmware),
            _supply(access, servo, label),
            *_state(access, servo, label),
        ]
    except DeviceTimeoutError as error:
        return [fail(label, f"answers now and then: {error}", "check plugs, cable and ground")]


def _model(servo: ServoSettings, label: str, number: int, firmware: int) -> Finding:
    value = f"{model_name(number)}, firmware {firmware}"
    if number != servo.servo_model.number:
        return fail(label, f"{value}; the robot file says {servo.model}", "correct the model, or the ids")
    if firmware < WATCHDOG_FIRMWARE:
        return fail(label, f"{value}, without a bus watchdog", f"update it to {WATCHDOG_FIRMWARE} or newer")
    return ok(label, value)


def _supply(access: DynamixelAccess, servo: ServoSettings, label: str) -> Finding:
    read = access.read
    voltage, low, high = (
        0.1 * read(servo.id, register)
        for register in (tables.PRESENT_INPUT_VOLTAGE, tables.MIN_VOLTAGE_LIMIT, tables.MAX_VOLTAGE_LIMIT)
    )
    temperature = read(servo.id, tables.PRESENT_TEMPERATURE)
    value = f"{voltage:.1f} V (its limits {low:.1f} to {high:.1f} V), {temperature} °C"
    if not low < voltage < high:
        return fail(label, value, "check the power supply and the cable's cross-section")
    return ok(label, value)


def _state(access: DynamixelAccess, servo: ServoSettings, label: str) -> list[Finding]:
    observations = []
    errors = access.read(servo.id, tables.HARDWARE_ERROR_STATUS)
    if errors:
        names = tables.hardware_error_names(errors)
        observations.append(fail(label, f"hardware error: {names}", "remove the cause, then reboot it"))
    return observations + [fail(label, trouble, remedy) for trouble, remedy in access.setup_troubles(servo)]


def _listed(ids: Sequence[int]) -> str:
    return f"id{'s' if len(ids) > 1 else ''} {', '.join(map(str, ids))}"
