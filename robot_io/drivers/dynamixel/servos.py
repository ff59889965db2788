"""Setting up the servos of one bus, from the first ping to torque on and off; may take milliseconds."""

from collections.abc import Iterator

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.dynamixel import protocol, tables
from palpate.robot_io.drivers.dynamixel.feedback import DynamixelFeedback, block_addresses, feedback_reader
from palpate.robot_io.drivers.dynamixel.settings import DynamixelSettings, ServoSettings
from palpate.robot_io.drivers.dynamixel.tables import (
    HARDWARE_ERROR_STATUS,
    WATCHDOG_FIRMWARE,
    hardware_error_names,
    model_name,
)
from palpate.robot_io.drivers.servo.access import RegisterAccess
from palpate.robot_io.drivers.servo.feedback import FeedbackReader
from palpate.robot_io.drivers.servo.line import TOO_HOT, ServoLine
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.examination import Finding, Level, fail, graded, ok
from palpate.robot_io.serial_port import SerialPort


class DynamixelAccess(RegisterAccess):
    """Registers of Dynamixel servos, and what is behind an alert."""

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        super().__init__(protocol.DIALECT, port, clock)

    def who(self, servo_id: int) -> tuple[int, int]:
        """Read model number and firmware version of a servo. DeviceError: as `ping`."""
        data = self.ping(servo_id, protocol.PING_SIZE)
        return data[0] | data[1] << 8, data[2]

    def setup_troubles(self, servo: ServoSettings) -> Iterator[tuple[str, str]]:
        """Find what is set in a servo that must not be.

        Args:
            servo: What the robot file says of it.

        Yields:
            What is wrong, and what to do.

        Raises:
            DeviceError: As `read`.
        """
        mode = tables.drive_mode_trouble(self.read(servo.id, tables.DRIVE_MODE))
        if mode:
            yield f"drive mode: {mode}", "set its drive mode to 0"
        secondary = self.read(servo.id, tables.SECONDARY_ID)
        if secondary < tables.NO_SECONDARY_ID:
            yield f"secondary id {secondary}: it obeys what that servo is told", "set its secondary id to 255"
        moved = servo.homing_trouble(self.read(servo.id, tables.HOMING_OFFSET))
        if moved:
            yield moved, "calibrate its zero again, and state the new offset"

    def why_alert(self, servo_id: int) -> str:
        names = hardware_error_names(
            HARDWARE_ERROR_STATUS.decode(self._read(servo_id, HARDWARE_ERROR_STATUS).data)
        )
        return f" (hardware error: {names}; it must be rebooted)"


class DynamixelLine(ServoLine):
    """See `ServoLine`.

    Attributes:
        current_limits: largest current that each servo takes, in its unit, once they have been looked at.
    """

    dialect = protocol.DIALECT
    torque_enable = tables.TORQUE_ENABLE
    present_position = tables.PRESENT_POSITION
    goal = tables.GOAL_CURRENT
    ping_size = protocol.PING_SIZE
    ping_all_s = 0.3
    registers: DynamixelAccess
    _settings: DynamixelSettings

    def __init__(self, settings: DynamixelSettings, port: SerialPort, clock: Clock) -> None:
        super().__init__(settings, DynamixelAccess(port, clock), port, clock)
        self.current_limits: list[int] = []
        self._fast = False  # whether all servos know the fast sync read, and may use it

    def identify(self) -> None:
        """Look who is there, and compare with the settings.

        DeviceError: a servo is missing, is another model, is too old, or does not fit as it is set up.
        """
        self._check_all_there()
        servos = [(servo, servo.servo_model) for servo in self._settings.turning]
        know_fast = [self._identify(servo) >= model.fast_sync_read_firmware for servo, model in servos]
        self._fast = self._settings.fast_sync_read and all(know_fast)
        read, limit = self.registers.read, tables.CURRENT_LIMIT
        self.current_limits = [min(read(servo.id, limit), model.largest_current) for servo, model in servos]

    def _identify(self, servo: ServoSettings) -> int:
        """The firmware of a servo that is as the settings say."""
        number, firmware = self.registers.who(servo.id)
        if number != servo.servo_model.number:
            raise DeviceError(
                f"servo {servo.id} is a {model_name(number)}, the robot file says {servo.model}"
            )
        if firmware < WATCHDOG_FIRMWARE:
            raise DeviceError(
                f"servo {servo.id} has firmware {firmware}: update it, there is no bus watchdog before "
                f"{WATCHDOG_FIRMWARE}"
            )
        self.registers.settle_unanswered(servo.id, tables.STATUS_RETURN_LEVEL, tables.ANSWER_EVERYTHING)
        for trouble, remedy in self.registers.setup_troubles(servo):
            raise DeviceError(f"servo {servo.id}: {trouble}; {remedy}")
        return firmware

    def feedback_reader(self) -> FeedbackReader[DynamixelFeedback]:
        """What reads the servos in each tick, by the fastest way that all of them know."""
        indirect_data = self._settings.servos[0].servo_model.indirect_data
        return feedback_reader(self.port, self.clock, self.ids, indirect_data, fast=self._fast)

    def prepare_feedback(self) -> None:
        """Gather what is read in each tick, set return delay and watchdog; the torque is off from here on.

        DeviceError: a servo did not do what it was told.
        """
        addresses = b"".join(address.to_bytes(2, "little") for address in block_addresses())
        for servo_id in self.ids:
            settle = self.registers.settle
            settle(servo_id, tables.TORQUE_ENABLE, 0)
            settle(servo_id, tables.RETURN_DELAY_TIME, self._settings.return_delay, keeps=True)
            what = "gathering its feedback"
            self.registers.write_bytes(servo_id, tables.INDIRECT_ADDRESS, addresses, what)
            settle(servo_id, tables.BUS_WATCHDOG, 0)  # forgets that it has fired
            settle(servo_id, tables.BUS_WATCHDOG, self._settings.watchdog)

    def prepare(self) -> None:
        """See `ServoLine.prepare`; current control as well."""
        self.prepare_feedback()
        for servo_id in self.ids:
            mode = tables.CURRENT_CONTROL
            self.registers.settle(servo_id, tables.OPERATING_MODE, mode, keeps=True)

    def switch_on(self) -> None:
        """Torque on, at zero. DeviceError: a servo refused, with its hardware error if it has one."""
        for servo_id in self.ids:
            self.registers.settle(servo_id, tables.GOAL_CURRENT, 0)
        for servo_id in self.ids:
            self.registers.settle(servo_id, tables.TORQUE_ENABLE, 1)

    @property
    def last_resort(self) -> str:
        return f"its watchdog switches it off {self._settings.watchdog_s:g} s after the last command"


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
