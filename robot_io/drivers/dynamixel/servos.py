"""Setting up the servos of one bus, from the first ping to torque on and off; may take milliseconds."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from robot_io.clock import Clock
from robot_io.drivers.dynamixel import protocol, tables
from robot_io.drivers.dynamixel.feedback import Feedback, block_addresses, feedback_reader
from robot_io.drivers.dynamixel.settings import DynamixelSettings, ServoSettings
from robot_io.drivers.dynamixel.tables import (
    HARDWARE_ERROR_STATUS,
    WATCHDOG_FIRMWARE,
    hardware_error_names,
    model_name,
)
from robot_io.drivers.servo.access import RegisterAccess
from robot_io.drivers.servo.dialect import Dialect
from robot_io.drivers.servo.feedback import FeedbackReader
from robot_io.drivers.servo.line import ServoLine
from robot_io.errors import DeviceError
from robot_io.serial_port import SerialPort


class DynamixelAccess(RegisterAccess):
    """Registers of Dynamixel servos, and what is behind an alert."""

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        super().__init__(protocol, port, clock)

    def who(self, servo_id: int) -> tuple[int, int]:
        """Model number and firmware version. DeviceError: as `ping`."""
        data = self.ping(servo_id, protocol.PING_SIZE)
        return data[0] | data[1] << 8, data[2]

    def setup_troubles(self, servo: ServoSettings) -> Iterator[tuple[str, str]]:
        """What is set in a servo that must not be, and what to do. DeviceError: as `read`."""
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


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """What a servo said of itself when it was looked at."""

    id: int  # its id
    model: str  # name of its model
    firmware: int  # firmware version
    voltage_v: float  # input voltage [V]
    temperature_c: float  # inside it [degrees Celsius]
    homing_offset: int  # what is added to its position [counts]
    current_limit: int  # largest current it takes, in its unit
    hardware_error: str  # names of its hardware errors, or "none"


class DynamixelLine(ServoLine):
    """See `ServoLine`.

    Attributes:
        identities: one per servo, once they have been looked at.
    """

    dialect: ClassVar[Dialect] = protocol
    torque_enable = tables.TORQUE_ENABLE
    present_position = tables.PRESENT_POSITION
    ping_size = protocol.PING_SIZE
    registers: DynamixelAccess

    def __init__(self, settings: DynamixelSettings, port: SerialPort, clock: Clock) -> None:
        super().__init__(port, DynamixelAccess(port, clock), settings.ids)
        self._settings, self._clock = settings, clock
        self.identities: tuple[ServoIdentity, ...] = ()

    def identify(self) -> None:
        """Look who is there, and compare with the settings.

        DeviceError: a servo is missing, is another model, is too old, or does not fit as it is set up.
        """
        self._check_all_there(self._settings.baud_rate)
        self.identities = tuple(self._identify(servo) for servo in self._settings.turning)

    def _identify(self, servo: ServoSettings) -> ServoIdentity:
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
        read = self.registers.read
        for trouble, remedy in self.registers.setup_troubles(servo):
            raise DeviceError(f"servo {servo.id}: {trouble}; {remedy}")
        errors = tables.hardware_error_names(read(servo.id, tables.HARDWARE_ERROR_STATUS))
        return ServoIdentity(
            id=servo.id,
            model=servo.model,
            firmware=firmware,
            voltage_v=0.1 * read(servo.id, tables.PRESENT_INPUT_VOLTAGE),
            temperature_c=float(read(servo.id, tables.PRESENT_TEMPERATURE)),
            homing_offset=read(servo.id, tables.HOMING_OFFSET),
            current_limit=min(read(servo.id, tables.CURRENT_LIMIT), servo.servo_model.largest_current),
            hardware_error=errors,
        )

    def feedback_reader(self) -> FeedbackReader[Feedback]:
        """What reads the servos in each tick, by the fastest way that all of them know."""
        fast = self._settings.fast_sync_read and all(
            identity.firmware >= servo.servo_model.fast_sync_read_firmware
            for identity, servo in zip(self.identities, self._settings.turning, strict=True)
        )
        indirect_data = self._settings.servos[0].servo_model.indirect_data
        return feedback_reader(self._port, self._clock, self._ids, indirect_data, fast=fast)

    def prepare_feedback(self) -> None:
        """Gather what is read in each tick, set return delay and watchdog; the torque is off from here on.

        DeviceError: a servo did not do what it was told.
        """
        addresses = b"".join(address.to_bytes(2, "little") for address in block_addresses())
        for servo_id in self._ids:
            settle = self.registers.settle
            settle(servo_id, tables.TORQUE_ENABLE, 0)
            settle(servo_id, tables.RETURN_DELAY_TIME, self._settings.return_delay, keeps=True)
            what = "gathering its feedback"
            self.registers.write_bytes(servo_id, tables.INDIRECT_ADDRESS, addresses, what)
            settle(servo_id, tables.BUS_WATCHDOG, 0)  # forgets that it has fired
            settle(servo_id, tables.BUS_WATCHDOG, self._settings.watchdog)

    def prepare_torque(self) -> None:
        """Everything that a servo must do in a run, each setting read back.

        DeviceError: a servo did not do what it was told.
        """
        self.prepare_feedback()
        for servo_id in self._ids:
            mode = tables.CURRENT_CONTROL
            self.registers.settle(servo_id, tables.OPERATING_MODE, mode, keeps=True)

    def switch_on(self) -> None:
        """Torque on, at zero. DeviceError: a servo refused, with its hardware error if it has one."""
        for servo_id in self._ids:
            self.registers.settle(servo_id, tables.GOAL_CURRENT, 0)
        for servo_id in self._ids:
            self.registers.settle(servo_id, tables.TORQUE_ENABLE, 1)

    @property
    def last_resort(self) -> str:
        return f"its watchdog switches it off {self._settings.watchdog_s:g} s after the last command"
