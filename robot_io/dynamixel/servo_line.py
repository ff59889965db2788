"""The servos of one bus, from the first ping to torque on and off."""

from collections.abc import Iterable
from dataclasses import dataclass

from robot_io.clock import Clock
from robot_io.dynamixel import instructions, registers
from robot_io.dynamixel.feedback import block_addresses
from robot_io.dynamixel.feedback_reader import FeedbackReader
from robot_io.dynamixel.models import WATCHDOG_FIRMWARE, model_name
from robot_io.dynamixel.port import SerialPort
from robot_io.dynamixel.register_access import RegisterAccess
from robot_io.dynamixel.settings import DynamixelSettings, ServoSettings
from robot_io.errors import DeviceError, DeviceTimeoutError

_SWITCH_OFF_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """What a servo said of itself when it was looked at.

    Attributes:
        id: its id.
        model: name of its model.
        firmware: firmware version.
        voltage_v: input voltage [V].
        temperature_c: inside it [degrees Celsius].
        current_limit: largest current it takes, in its unit.
        hardware_error: names of its hardware errors, or "none".
    """

    id: int
    model: str
    firmware: int
    voltage_v: float
    temperature_c: float
    current_limit: int
    hardware_error: str


class ServoLine:
    """Sets servos up and switches them; everything here may take milliseconds.

    Args:
        settings: the bus.
        port: its port.
        clock: for how long to wait.

    Attributes:
        identities: one per servo, once they have been looked at.
    """

    def __init__(self, settings: DynamixelSettings, port: SerialPort, clock: Clock) -> None:
        self._settings = settings
        self._port = port
        self._clock = clock
        self._registers = RegisterAccess(port, clock)
        self._ids = [servo.id for servo in settings.servos]
        self.identities: tuple[ServoIdentity, ...] = ()

    def identify(self) -> None:
        """Look who is there, and compare with the settings.

        Raises:
            DeviceError: a servo is missing, is another model, is too old, or does not fit as it is set up.
        """
        self._find_all()
        self.identities = tuple(self._identify(servo) for servo in self._settings.servos)

    def _find_all(self) -> None:
        missing = [servo_id for servo_id in self._ids if not self._is_there(servo_id)]
        if missing:
            there = ", ".join(str(servo_id) for servo_id in self._ids if servo_id not in missing) or "none"
            raise DeviceError(
                f"no answer from servo {', '.join(map(str, missing))} at {self._settings.baud_rate} bit/s "
                f"(answering: {there}): check power, cable, id and baud rate"
            )

    def _is_there(self, servo_id: int) -> bool:
        try:
            self._registers.ping(servo_id)
        except DeviceTimeoutError:
            return False
        return True

    def _identify(self, servo: ServoSettings) -> ServoIdentity:
        number, firmware = self._registers.ping(servo.id)
        if number != servo.servo_model.number:
            raise DeviceError(
                f"servo {servo.id} is a {model_name(number)}, the robot file says {servo.model}"
            )
        if firmware < WATCHDOG_FIRMWARE:
            raise DeviceError(
                f"servo {servo.id} has firmware {firmware}: update it, there is no bus watchdog before "
                f"{WATCHDOG_FIRMWARE}"
            )
        read = self._registers.read
        trouble = registers.drive_mode_trouble(read(servo.id, registers.DRIVE_MODE))
        if trouble:
            raise DeviceError(f"servo {servo.id}: its drive mode says: {trouble}")
        errors = registers.hardware_error_names(read(servo.id, registers.HARDWARE_ERROR_STATUS))
        return ServoIdentity(
            id=servo.id,
            model=servo.model,
            firmware=firmware,
            voltage_v=0.1 * read(servo.id, registers.PRESENT_INPUT_VOLTAGE),
            temperature_c=float(read(servo.id, registers.PRESENT_TEMPERATURE)),
            current_limit=min(read(servo.id, registers.CURRENT_LIMIT), servo.servo_model.largest_current),
            hardware_error=errors,
        )

    def feedback_reader(self) -> FeedbackReader:
        """What reads the servos in each tick, by the fastest way that all of them know."""
        fast = self._settings.fast_sync_read and all(
            identity.firmware >= servo.servo_model.fast_sync_read_firmware
            for identity, servo in zip(self.identities, self._settings.servos, strict=True)
        )
        indirect_data = self._settings.servos[0].servo_model.indirect_data
        return FeedbackReader(self._port, self._clock, self._ids, indirect_data, fast=fast)

    def prepare_feedback(self) -> None:
        """Gather what is read in each tick, set return delay and watchdog; the torque is off from here on.

        Raises:
            DeviceError: a servo did not do what it was told.
        """
        addresses = b"".join(address.to_bytes(2, "little") for address in block_addresses())
        for servo_id in self._ids:
            settle = self._registers.settle
            self._registers.insist(servo_id, registers.STATUS_RETURN_LEVEL, registers.ANSWER_EVERYTHING)
            settle(servo_id, registers.TORQUE_ENABLE, 0)
            settle(servo_id, registers.RETURN_DELAY_TIME, self._settings.return_delay, keeps=True)
            what = "gathering its feedback"
            self._registers.write_bytes(servo_id, registers.INDIRECT_ADDRESS, addresses, what)
            settle(servo_id, registers.BUS_WATCHDOG, 0)  # forgets that it has fired
            settle(servo_id, registers.BUS_WATCHDOG, self._settings.watchdog)

    def prepare_torque(self) -> None:
        """Everything that a servo must do in a run, each setting read back.

        Raises:
            DeviceError: a servo did not do what it was told.
        """
        self.prepare_feedback()
        for servo_id in self._ids:
            mode = registers.CURRENT_CONTROL
            self._registers.settle(servo_id, registers.OPERATING_MODE, mode, keeps=True)

    def switch_on(self) -> None:
        """Torque on, at zero.

        Raises:
            DeviceError: a servo refused, with its hardware error if it has one.
        """
        for servo_id in self._ids:
            self._registers.settle(servo_id, registers.GOAL_CURRENT, 0)
        for servo_id in self._ids:
            self._registers.settle(servo_id, registers.TORQUE_ENABLE, 1)

    def switch_off(self) -> None:
        """Torque off, asked of every servo until it says so.

        Raises:
            DeviceError: some did not say so, by id; their watchdogs let go when nothing is sent any more.
        """
        still_on, problem = list(self._ids), ""
        for _ in range(_SWITCH_OFF_ATTEMPTS):
            self._port.write(instructions.sync_write(*self._torque_off(still_on)))
            failures = [(servo_id, self._why_still_on(servo_id)) for servo_id in still_on]
            still_on = [servo_id for servo_id, failure in failures if failure]
            problem = "; ".join(failure for _, failure in failures if failure)
            if not still_on:
                return
        raise DeviceError(f"torque not known to be off: {problem}; {self.last_resort}")

    @property
    def last_resort(self) -> str:
        """What happens when a servo cannot be told anything."""
        return f"its watchdog lets go {self._settings.watchdog_s:g} s after the last command"

    @staticmethod
    def _torque_off(servo_ids: Iterable[int]) -> tuple[int, dict[int, bytes]]:
        register = registers.TORQUE_ENABLE
        return register.address, {servo_id: register.encode(0) for servo_id in servo_ids}

    def _why_still_on(self, servo_id: int) -> str | None:
        try:
            on = self._registers.read(servo_id, registers.TORQUE_ENABLE)
        except DeviceError as error:
            if not self._port.is_open:
                raise
            return str(error)
        return f"servo {servo_id}: says that it is on" if on else None
