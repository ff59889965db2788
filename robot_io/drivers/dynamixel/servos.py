"""Setting up the servos of one bus, from the first ping to torque on and off; may take milliseconds."""

from collections.abc import Iterable
from dataclasses import dataclass

from robot_io.clock import Clock
from robot_io.drivers.dynamixel import protocol, tables
from robot_io.drivers.dynamixel.feedback import FeedbackReader, block_addresses
from robot_io.drivers.dynamixel.protocol import StatusPacket, StatusReader
from robot_io.drivers.dynamixel.settings import DynamixelSettings, ServoSettings
from robot_io.drivers.dynamixel.tables import (
    HARDWARE_ERROR_STATUS,
    WATCHDOG_FIRMWARE,
    Register,
    hardware_error_names,
    model_name,
)
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.serial_port import SerialPort

_PATIENCE_S = 0.02  # beyond the time on the wire: USB adapters may hold bytes back for 16 ms
_PACKET = 12  # bytes of a packet around its data


class RegisterAccess:
    """One servo at a time: ask, wait for the answer, check it.

    Args:
        port: an open port.
        clock: for how long to wait.
    """

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        self._port = port
        self._clock = clock
        self._alert = False  # of the last value that was read

    def ping(self, servo_id: int) -> tuple[int, int]:
        """Model number and firmware version.

        DeviceTimeoutError: nobody answers; DeviceError: the port failed, or the answer makes no sense.
        """
        packet = self._ask(servo_id, protocol.ping(servo_id), 3)
        self._check(packet, "ping")
        return packet.data[0] | packet.data[1] << 8, packet.data[2]

    def read(self, servo_id: int, register: Register) -> int:
        """The value of a register.

        DeviceTimeoutError: no answer; DeviceError: the port failed, or the servo refused.
        """
        request = protocol.read(servo_id, register.address, register.size)
        packet = self._ask(servo_id, request, register.size)
        self._check(packet, f"reading {register.name}")
        self._alert = packet.alert
        return register.decode(packet.data)

    def write(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register; the servo says that it has.

        DeviceTimeoutError: no answer; DeviceError: the port failed, or the servo refused, with its hardware
        error if it has one.
        """
        self.write_bytes(servo_id, register.address, register.encode(value), f"setting {register.name}")

    def write_bytes(self, servo_id: int, address: int, data: bytes, what: str) -> None:
        """Set bytes in a row; `what` is for the error. DeviceError: as `write`."""
        packet = self._ask(servo_id, protocol.write(servo_id, address, data), 0)
        self._check(packet, what)

    def settle(self, servo_id: int, register: Register, value: int, *, keeps: bool = False) -> None:
        """Set a register and read it back; one that keeps its value without power is only set if it differs.

        DeviceError: as `write`, or it has another value afterwards.
        """
        if keeps and self.read(servo_id, register) == value:
            return  # its memory wears out with each writing
        self.write(servo_id, register, value)
        self._confirm(servo_id, register, value)

    def insist(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register of a servo that may not answer to writing, and read it back.

        DeviceError: as `settle`.
        """
        self._port.write(protocol.write(servo_id, register.address, register.encode(value)))
        self._confirm(servo_id, register, value)

    def _confirm(self, servo_id: int, register: Register, value: int) -> None:
        found = self.read(servo_id, register)
        if found != value:
            why = self._hardware_error(servo_id) if self._alert else ""
            raise DeviceError(
                f"servo {servo_id}: {register.name} is {found} after it was set to {value}{why}"
            )

    def _ask(self, servo_id: int, request: bytes, size: int) -> StatusPacket:
        self._port.read_all()
        reader = StatusReader()
        self._port.write(request)
        wire_s = self._port.duration_s(len(request) + _PACKET + size)
        deadline_s = self._clock.now_s() + wire_s + _PATIENCE_S
        while True:
            for packet in reader.feed(self._port.wait(deadline_s)):
                if packet.servo_id == servo_id and (packet.refusal or len(packet.data) == size):
                    return packet
            if self._clock.now_s() >= deadline_s:
                damaged = f" ({reader.rejected} damaged answers)" if reader.rejected else ""
                raise DeviceTimeoutError(f"servo {servo_id}: no answer{damaged}")

    def _check(self, packet: StatusPacket, what: str) -> None:
        if not packet.refusal:
            return
        problem = f"servo {packet.servo_id}: {what}: {packet.refusal}"
        if packet.alert:
            problem += self._hardware_error(packet.servo_id)
        raise DeviceError(problem)

    def _hardware_error(self, servo_id: int) -> str:
        register = HARDWARE_ERROR_STATUS
        found = self._ask(servo_id, protocol.read(servo_id, register.address, register.size), register.size)
        names = hardware_error_names(register.decode(found.data))
        return f" (hardware error: {names}; it must be rebooted)"


_SWITCH_OFF_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """What a servo said of itself when it was looked at."""

    id: int  # its id
    model: str  # name of its model
    firmware: int  # firmware version
    voltage_v: float  # input voltage [V]
    temperature_c: float  # inside it [degrees Celsius]
    current_limit: int  # largest current it takes, in its unit
    hardware_error: str  # names of its hardware errors, or "none"


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
        self._registers.insist(servo.id, tables.STATUS_RETURN_LEVEL, tables.ANSWER_EVERYTHING)
        read = self._registers.read
        trouble = tables.drive_mode_trouble(read(servo.id, tables.DRIVE_MODE))
        if trouble:
            raise DeviceError(f"servo {servo.id}: its drive mode says: {trouble}")
        errors = tables.hardware_error_names(read(servo.id, tables.HARDWARE_ERROR_STATUS))
        return ServoIdentity(
            id=servo.id,
            model=servo.model,
            firmware=firmware,
            voltage_v=0.1 * read(servo.id, tables.PRESENT_INPUT_VOLTAGE),
            temperature_c=float(read(servo.id, tables.PRESENT_TEMPERATURE)),
            current_limit=min(read(servo.id, tables.CURRENT_LIMIT), servo.servo_model.largest_current),
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

        DeviceError: a servo did not do what it was told.
        """
        addresses = b"".join(address.to_bytes(2, "little") for address in block_addresses())
        for servo_id in self._ids:
            settle = self._registers.settle
            settle(servo_id, tables.TORQUE_ENABLE, 0)
            settle(servo_id, tables.RETURN_DELAY_TIME, self._settings.return_delay, keeps=True)
            what = "gathering its feedback"
            self._registers.write_bytes(servo_id, tables.INDIRECT_ADDRESS, addresses, what)
            settle(servo_id, tables.BUS_WATCHDOG, 0)  # forgets that it has fired
            settle(servo_id, tables.BUS_WATCHDOG, self._settings.watchdog)

    def prepare_torque(self) -> None:
        """Everything that a servo must do in a run, each setting read back.

        DeviceError: a servo did not do what it was told.
        """
        self.prepare_feedback()
        for servo_id in self._ids:
            mode = tables.CURRENT_CONTROL
            self._registers.settle(servo_id, tables.OPERATING_MODE, mode, keeps=True)

    def switch_on(self) -> None:
        """Torque on, at zero. DeviceError: a servo refused, with its hardware error if it has one."""
        for servo_id in self._ids:
            self._registers.settle(servo_id, tables.GOAL_CURRENT, 0)
        for servo_id in self._ids:
            self._registers.settle(servo_id, tables.TORQUE_ENABLE, 1)

    def switch_off(self) -> None:
        """Torque off, asked of every servo until it says so.

        DeviceError: some did not say so, by id; their watchdogs let go when nothing is sent any more.
        """
        still_on, problem = list(self._ids), ""
        for _ in range(_SWITCH_OFF_ATTEMPTS):
            self._port.write(protocol.sync_write(*self._torque_off(still_on)))
            failures = [(servo_id, self._why_still_on(servo_id)) for servo_id in still_on]
            still_on = [servo_id for servo_id, failure in failures if failure]
            problem = "; ".join(failure for _, failure in failures if failure)
            if not still_on:
                return
        raise DeviceError(f"torque not known to be off: {problem}; {self.last_resort}")

    @property
    def last_resort(self) -> str:
        """What happens when a servo cannot be told anything."""
        return f"its watchdog switches it off {self._settings.watchdog_s:g} s after the last command"

    @staticmethod
    def _torque_off(servo_ids: Iterable[int]) -> tuple[int, dict[int, bytes]]:
        register = tables.TORQUE_ENABLE
        return register.address, {servo_id: register.encode(0) for servo_id in servo_ids}

    def _why_still_on(self, servo_id: int) -> str | None:
        try:
            on = self._registers.read(servo_id, tables.TORQUE_ENABLE)
        except DeviceError as error:
            if not self._port.is_open:
                raise
            return str(error)
        return f"servo {servo_id}: says that it is on" if on else None
