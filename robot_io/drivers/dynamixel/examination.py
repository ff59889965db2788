"""What a servo of the X series says of itself, held against the robot file."""

from collections.abc import Iterator

from palpate.robot_io.drivers.dynamixel import tables
from palpate.robot_io.drivers.dynamixel.servos import DynamixelAccess
from palpate.robot_io.drivers.dynamixel.settings import ServoSettings
from palpate.robot_io.drivers.dynamixel.tables import WATCHDOG_FIRMWARE, model_name
from palpate.robot_io.drivers.servo.examination import TOO_HOT
from palpate.robot_io.examination import Finding, Level, fail, graded, ok


def examine_servo(access: DynamixelAccess, servo: ServoSettings, label: str) -> Iterator[Finding]:
    """Look at model, firmware, supply, temperature, errors and setup of one servo.

    Args:
        access: Access to its registers.
        servo: What the robot file says of it.
        label: What to call it.

    Raises:
        DeviceError: It does not answer, or the port failed.
    """
    read = access.read
    number, firmware = access.who(servo.id)
    value = f"{model_name(number)}, firmware {firmware}"
    if number != servo.servo_model.number:
        value += f"; the robot file says {servo.model}"
        yield fail(label, value, "correct the model, or the ids")
    elif firmware < WATCHDOG_FIRMWARE:
        value += ", without a bus watchdog"
        yield fail(label, value, f"update it to {WATCHDOG_FIRMWARE} or newer")
    else:
        yield ok(label, value)
    voltage, low, high = (
        0.1 * read(servo.id, register)
        for register in (tables.PRESENT_INPUT_VOLTAGE, tables.MIN_VOLTAGE_LIMIT, tables.MAX_VOLTAGE_LIMIT)
    )
    celsius, limit = read(servo.id, tables.PRESENT_TEMPERATURE), read(servo.id, tables.TEMPERATURE_LIMIT)
    yield graded(
        label,
        f"{voltage:.1f} V (its limits {low:.1f} to {high:.1f} V), {celsius} °C (its limit {limit} °C)",
        (Level.FAIL, not low < voltage < high, "check the power supply and the cable's cross-section"),
        (Level.WARN, celsius > limit, TOO_HOT),
    )
    errors = read(servo.id, tables.HARDWARE_ERROR_STATUS)
    if errors:
        names = tables.hardware_error_names(errors)
        yield fail(label, f"hardware error: {names}", "remove the cause, then reboot it")
    for trouble, remedy in access.setup_troubles(servo):
        yield fail(label, trouble, remedy)
