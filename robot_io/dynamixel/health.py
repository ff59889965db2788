"""What the feedback of the servos says about themselves, in words."""

from collections.abc import Sequence

from robot_io.dynamixel.feedback import Feedback
from robot_io.dynamixel.registers import WATCHDOG_FIRED, hardware_error_names


def feedback_problem(
    feedback: Sequence[Feedback], servo_ids: Sequence[int], watchdog: int, *, powered: bool
) -> str | None:
    """Why some of the feedback cannot be trusted, or None.

    Args:
        feedback: of all servos.
        servo_ids: their ids.
        watchdog: the value to which the bus watchdog was set.
        powered: whether the torque was switched on.
    """
    for joint, (servo_id, servo) in enumerate(zip(servo_ids, feedback, strict=True), 1):
        where = f"servo {servo_id} (joint {joint})"
        fired = servo.watchdog == WATCHDOG_FIRED
        if powered and fired:
            return f"{where}: its bus watchdog has fired, it let go"
        if servo.watchdog != watchdog and not fired:
            return f"{where}: has forgotten its settings; it has restarted"
        if powered and not servo.torque_on:
            names = hardware_error_names(servo.hardware_error)
            return f"{where}: has switched its torque off (hardware error: {names})"
    return None


def hardware_problem(feedback: Sequence[Feedback], servo_ids: Sequence[int]) -> str | None:
    """The hardware errors of all servos, by name, or None."""
    problems = [
        f"servo {servo_id} (joint {joint}): hardware error: {hardware_error_names(servo.hardware_error)}"
        for joint, (servo_id, servo) in enumerate(zip(servo_ids, feedback, strict=True), 1)
        if servo.alert or servo.hardware_error
    ]
    return "; ".join(problems) or None
