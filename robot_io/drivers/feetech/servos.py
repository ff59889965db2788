"""Setting up the servos of one Feetech bus, from the first ping to torque on and off."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from robot_io.clock import Clock
from robot_io.drivers.feetech import protocol, tables
from robot_io.drivers.feetech.settings import FeetechServo, FeetechSettings
from robot_io.drivers.feetech.tables import model_name
from robot_io.drivers.servo.access import RegisterAccess
from robot_io.drivers.servo.dialect import Dialect
from robot_io.drivers.servo.line import ServoLine
from robot_io.errors import DeviceError
from robot_io.serial_port import SerialPort

_VOLTAGE_SHARE = 0.25  # of the model's voltage; 7.4 and 12 V are told apart

# What makes the servo's own law the plain one of `tables`, beside the P coefficient; held until it restarts,
# for the lock is set first. A goal beyond limits that its calibration left would be another torque.
_PLAIN_LAW = (
    (tables.OPERATING_MODE, tables.POSITION_CONTROL),
    (tables.RETURN_DELAY, 0),
    (tables.MIN_POSITION, 0),
    (tables.MAX_POSITION, tables.COUNTS_PER_REVOLUTION - 1),
    (tables.D_GAIN, 0),
    (tables.I_GAIN, 0),
    (tables.STARTUP_FORCE, 0),
    (tables.CW_DEAD_ZONE, 0),
    (tables.CCW_DEAD_ZONE, 0),
    (tables.ACCELERATION, 0),
    (tables.GOAL_TIME, 0),
    (tables.GOAL_SPEED, 0),
)


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """What a servo said of itself when it was looked at."""

    model: str  # name of its model
    firmware: str  # version
    voltage_v: float  # input voltage [V]
    voltage_limits_v: tuple[float, float]  # lowest and highest that it takes [V]
    temperature_c: float  # inside it [degrees Celsius]
    homing_offset: int  # what is taken off its position [counts]


class FeetechLine(ServoLine):
    """See `ServoLine`.

    Attributes:
        torque_limits: largest duty cycle of each servo, in its unit, by id.
    """

    dialect: ClassVar[Dialect] = protocol
    torque_enable = tables.TORQUE_ENABLE
    present_position = tables.PRESENT_POSITION
    goal = tables.GOAL_POSITION
    ping_size = protocol.ID_SIZE
    last_resort = "it has no watchdog and holds its last goal: switch its supply off"

    def __init__(
        self, settings: FeetechSettings, torque_limits: Mapping[int, int], port: SerialPort, clock: Clock
    ) -> None:
        super().__init__(port, RegisterAccess(protocol, port, clock), settings.ids)
        self._settings, self.torque_limits = settings, torque_limits

    def identify(self) -> None:
        """Look who is there, and compare with the settings.

        DeviceError: a servo is missing, is another model, or does not fit as it is set up.
        """
        self._check_all_there(self._settings.baud_rate)
        for servo_id in self._settings.ids:
            self.registers.settle_unanswered(servo_id, tables.LOCK, 1)
            self.registers.settle_unanswered(servo_id, tables.RESPONSE_LEVEL, tables.ANSWER_EVERYTHING)
            self.registers.settle(servo_id, tables.TORQUE_ENABLE, 0)
        looked_at = [(servo, self.identify_one(servo)) for servo in self._settings.turning]
        for servo, found in looked_at:
            trouble = identity_trouble(servo, found)
            if trouble:
                raise DeviceError(f"servo {servo.id}: {trouble}")

    def identify_one(self, servo: FeetechServo) -> ServoIdentity:
        """What a servo says of itself. DeviceError: it is another model, or counts over several turns."""
        read, servo_id = self.registers.read, servo.id
        number = read(servo_id, tables.MODEL_NUMBER)
        if number != servo.servo_model.number:
            raise DeviceError(
                f"servo {servo_id} is a {model_name(number)}, the robot file says {servo.model}"
            )
        if read(servo_id, tables.PHASE) & tables.SEVERAL_TURNS:
            raise DeviceError(f"servo {servo_id} counts over several turns: clear bit 4 of its phase (18)")
        firmware = read(servo_id, tables.FIRMWARE)
        limits_v = (read(servo_id, tables.MIN_VOLTAGE), read(servo_id, tables.MAX_VOLTAGE))
        return ServoIdentity(
            model=servo.model,
            firmware=f"{firmware & 0xFF}.{firmware >> 8}",
            voltage_v=0.1 * read(servo_id, tables.PRESENT_VOLTAGE),
            voltage_limits_v=(0.1 * limits_v[0], 0.1 * limits_v[1]),
            temperature_c=float(read(servo_id, tables.PRESENT_TEMPERATURE)),
            homing_offset=read(servo_id, tables.HOMING_OFFSET),
        )

    def prepare(self) -> None:
        """See `ServoLine.prepare`; every servo is to follow its goal by the plain law."""
        settle, own = self.registers.settle, self._settings
        for servo_id in own.ids:
            settle(servo_id, tables.TORQUE_ENABLE, 0)
            for register, value in (*_PLAIN_LAW, (tables.P_GAIN, own.p_gain)):
                settle(servo_id, register, value)
            settle(servo_id, tables.TORQUE_LIMIT, self.torque_limits[servo_id])

    def switch_on(self) -> dict[int, int]:
        """Torque on, each servo where it stands; returns these goals by id.

        DeviceError: a servo refused, or has an error.
        """
        registers, goals = self.registers, {}
        for servo_id in self._settings.ids:
            goals[servo_id] = registers.read(servo_id, tables.PRESENT_POSITION)
            registers.settle(servo_id, tables.GOAL_POSITION, goals[servo_id])
        for servo_id in self._settings.ids:
            registers.settle(servo_id, tables.TORQUE_ENABLE, 1)
        return goals


def identity_trouble(servo: FeetechServo, found: ServoIdentity) -> str | None:
    """Why a servo does not fit the robot file, or None."""
    nominal_v = servo.servo_model.voltage_v
    low_v, high_v = found.voltage_limits_v
    if not max(low_v, (1 - _VOLTAGE_SHARE) * nominal_v) <= found.voltage_v <= high_v or (
        found.voltage_v > (1 + _VOLTAGE_SHARE) * nominal_v
    ):
        return f"is supplied with {found.voltage_v:.1f} V, a {servo.model} needs {nominal_v:g} V"
    return servo.homing_trouble(found.homing_offset)
