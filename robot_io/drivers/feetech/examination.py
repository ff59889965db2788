"""Looks at the servos of a Feetech line one by one."""

from robot_io.drivers.feetech.protocol import ID_SIZE, error_names
from robot_io.drivers.feetech.servos import FeetechLine, identity_trouble
from robot_io.drivers.feetech.settings import FeetechServo, FeetechSettings
from robot_io.drivers.feetech.tables import LARGEST_LIMIT, STATUS
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.examination import Finding, fail, ok


def examine_servos(settings: FeetechSettings, line: FeetechLine) -> list[Finding]:
    """What every servo of the robot file says of itself. DeviceError: the port failed."""
    labels = dict(zip(settings.ids, settings.labels, strict=True))
    findings = [_look_at(line, servo, labels[servo.id]) for servo in settings.turning]
    return findings + [_is_there(line, servo_id, labels[servo_id]) for servo_id in settings.hold]


def _look_at(line: FeetechLine, servo: FeetechServo, label: str) -> Finding:
    there = _is_there(line, servo.id, label)
    if there.remedy:
        return there
    try:
        found, errors = line.identify_one(servo), line.registers.read(servo.id, STATUS)
    except DeviceTimeoutError as error:
        return fail(label, f"answers now and then: {error}", "check plugs, cable and ground")
    except DeviceError as error:
        return fail(label, str(error), "correct the model or the id, or set the servo up")
    value = (
        f"{found.model}, firmware {found.firmware}, {found.voltage_v:.1f} V, {found.temperature_c:.0f} °C, "
        f"homing offset {found.homing_offset}"
    )
    if errors:
        return fail(label, f"{value}; error: {error_names(errors)}", "remove the cause, then restart it")
    trouble = identity_trouble(servo, found)
    if trouble:
        return fail(label, f"{value}; {trouble}", "correct the robot file, or the supply")
    if line.torque_limits[servo.id] == LARGEST_LIMIT:
        value += "; its torque limit is at stall, so that the guard alone holds it to 'limits'"
    return ok(label, f"{value}; no watchdog: it holds its last goal when the program dies")


def _is_there(line: FeetechLine, servo_id: int, label: str) -> Finding:
    try:
        line.registers.ping(servo_id, ID_SIZE)
    except DeviceTimeoutError:
        remedy = "check its cable, power, id and baud rate (1 Mbit/s as delivered)"
        return fail(label, "does not answer", remedy)
    return ok(label, "answers, and holds where it stands while the torque is on")
