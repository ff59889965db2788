"""What a Feetech servo says of itself, held against the robot file."""

from palpate.robot_io.drivers.feetech.protocol import error_names
from palpate.robot_io.drivers.feetech.servos import FeetechLine, identity_trouble
from palpate.robot_io.drivers.feetech.settings import FeetechServo
from palpate.robot_io.drivers.feetech.tables import LARGEST_LIMIT, STATUS
from palpate.robot_io.drivers.servo.examination import TOO_HOT
from palpate.robot_io.examination import Finding, Level, graded


def examine_servo(line: FeetechLine, servo: FeetechServo, label: str) -> Finding:
    """Look at model, supply, temperature, errors and setup of one servo.

    Args:
        line: Its line.
        servo: What the robot file says of it.
        label: What to call it.

    Raises:
        DeviceError: It does not answer, is another model or set up otherwise, or the port failed.
    """
    identity, errors = line.identify_servo(servo), line.registers.read(servo.id, STATUS)
    trouble = identity_trouble(servo, identity)
    is_hot = identity.temperature_c > identity.temperature_limit_c
    value = (
        f"{identity.model}, firmware {identity.firmware}, {identity.voltage_v:.1f} V, "
        f"{identity.temperature_c} °C (its limit {identity.temperature_limit_c} °C), "
        f"homing offset {identity.homing_offset}"
    )
    if errors:
        value += f"; error: {error_names(errors)}"
    elif trouble:
        value += f"; {trouble}"
    elif not is_hot:
        if line.torque_limits[servo.id] == LARGEST_LIMIT:
            value += "; its torque limit is at stall, so that the guard alone holds it to 'limits'"
        value += "; no watchdog: it holds its last goal when the program dies"
    return graded(
        label,
        value,
        (Level.FAIL, errors, "remove the cause, then restart it"),
        (Level.FAIL, trouble, "correct the robot file, or the supply"),
        (Level.WARN, is_hot, TOO_HOT),
    )
