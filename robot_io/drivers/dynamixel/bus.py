"""A bus of Dynamixel servos of the X series in current control."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.dynamixel import tables
from palpate.robot_io.drivers.dynamixel.servos import DynamixelFeedback, DynamixelLine
from palpate.robot_io.drivers.dynamixel.tables import DynamixelSettings, ServoSettings
from palpate.robot_io.drivers.joint_bus import joint_drivers
from palpate.robot_io.drivers.servo.bus import ServoBus, ServoEncoder
from palpate.robot_io.drivers.servo.feedback import FeedbackReader
from palpate.robot_io.drivers.servo.line import IS_ON, TOO_HOT
from palpate.robot_io.examination import Finding, Level, fail, graded, ok
from palpate.robot_io.types import FloatArray


def count_steps(servos: Sequence[ServoSettings]) -> FloatArray:
    """Compute one count of each servo along its joint's axis [rad, rad/s, N m], shape (3, m).

    Args:
        servos: m servos that turn joints.
    """
    direction = np.array([servo.direction for servo in servos])
    per_ampere = [servo.torque_constant_nm_a or servo.servo_model.torque_constant_nm_a for servo in servos]
    current_a = [servo.servo_model.current_step_a for servo in servos]
    torque_nm = np.array(per_ampere) * np.array(current_a)
    steps = tables.POSITION_STEP_RAD, tables.VELOCITY_STEP_RAD_S, torque_nm
    return np.array([direction * step for step in steps])


class DynamixelBus(ServoBus[DynamixelFeedback]):
    """Servos of the X series in current control, Protocol 2.0.

    Torques, commanded and measured, are motor currents; they do not include the friction of the gears. The
    servo's velocity has steps of 0.024 rad/s.
    """

    name = "dynamixel_bus"
    _settings: DynamixelSettings
    _line: DynamixelLine

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(DynamixelSettings, settings)
        super().__init__(validated, count_steps(validated.turning), context)
        self._line = DynamixelLine(validated, self._port, context.clock)
        self._torque_steps_nm: list[float] = self._joints.steps[2].tolist()
        self._largest_current = [servo.servo_model.largest_current for servo in validated.turning]
        self._watchdog = validated.watchdog
        nothing, watchdog = (0,) * len(self._ids), (self._watchdog,) * len(self._ids)
        # Error, torque on, hardware error and watchdog of healthy servos, by whether they are powered.
        self._healthy = [(nothing, (on,) * len(self._ids), nothing, watchdog) for on in (0, 1)]
        self._servos = {servo.id: servo for servo in validated.turning}

    def _examine_servo(self, servo_id: int, label: str) -> Iterator[Finding]:
        access, servo = self._line.registers, self._servos[servo_id]
        read = access.read
        number, firmware = access.servo_label(servo.id)
        value = f"{servo.name_model(number)}, firmware {firmware}"
        if number != servo.servo_model.number:
            value += f", but the robot file states {servo.model}"
            yield fail(label, value, "correct the model, or the ids")
        elif firmware < tables.WATCHDOG_FIRMWARE:
            value += ", without a bus watchdog"
            yield fail(label, value, f"update it to {tables.WATCHDOG_FIRMWARE} or newer")
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
        if errors := read(servo.id, tables.HARDWARE_ERROR_STATUS):
            names = tables.hardware_error_names(errors)
            yield fail(label, f"hardware error: {names}", "remove the cause, then switch it off and on")
        for trouble, remedy in access.setup_problems(servo):
            yield fail(label, trouble, remedy)

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`; the servos wait before they answer."""
        wire_s = super().tick_wire_s()
        return None if wire_s is None else wire_s + self._settings.return_delay_s * len(self._ids)

    def _prepare_feedback(self) -> FeedbackReader[DynamixelFeedback]:
        self._line.identify()
        self._line.prepare_feedback()
        steps_nm = np.abs(self._joints.steps[2])
        limits_nm: list[float] = (np.array(self._line.current_limits) * steps_nm).tolist()
        counts = self._pairs.limit_to_weaker(limits_nm) / steps_nm + 1e-9
        self._largest_current = counts.astype(int).tolist()
        return self._line.feedback_reader()

    def _counts(self, feedback: DynamixelFeedback) -> Sequence[Sequence[float]]:
        return feedback.position, feedback.velocity, feedback.current

    def _is_healthy(self, feedback: DynamixelFeedback) -> bool:
        return feedback[:4] == self._healthy[self._powered]

    def _problem(self, feedback: DynamixelFeedback) -> str | None:
        states = feedback.torque_on, feedback.hardware_error, feedback.watchdog
        for label, torque_on, hardware_error, watchdog in zip(self._labels, *states, strict=True):
            if torque_on and not self._powered:
                return f"{label}: {IS_ON}"
            has_fired = watchdog == tables.WATCHDOG_FIRED
            if self._powered and has_fired:
                return f"{label}: its bus watchdog has fired; its torque is off"
            if watchdog != self._watchdog and not has_fired:
                return f"{label}: has lost its settings; it has restarted"
            if self._powered and not torque_on:
                names = tables.hardware_error_names(hardware_error)
                return f"{label}: has switched its torque off (hardware error: {names})"
        return None

    def _goals(self, torque_nm: list[float]) -> tuple[list[int], FloatArray]:
        counts, sent_nm = [], []
        shares_nm = self._pairs.split_torques(torque_nm)
        for torque, step, largest in zip(
            shares_nm, self._torque_steps_nm, self._largest_current, strict=True
        ):
            count = round(torque / step)
            count = -largest if count < -largest else min(count, largest)
            counts.append(count)
            sent_nm.append(count * step)
        return counts, np.array(self._pairs.sum_pairs(sent_nm))


DynamixelEncoder, DynamixelTorque = joint_drivers(DynamixelBus, "dynamixel", ServoEncoder)
