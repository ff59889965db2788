"""Set up the servos of one Feetech bus, from the first ping to torque on and off."""

from collections.abc import Mapping
from dataclasses import dataclass

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.feetech import protocol, tables
from palpate.robot_io.drivers.feetech.tables import FeetechServo, FeetechSettings
from palpate.robot_io.drivers.servo.line import RegisterAccess, ServoLine
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.serial_port import SerialPort

_VOLTAGE_SHARE = 0.25  # largest deviation from the model's voltage; distinguishes 7.4 and 12 V

# Settings that reduce the servo's control law to the one in `tables`, except the P coefficient. They hold
# until the servo restarts, because the lock is set first. The position limits are opened, because a goal
# beyond those of a calibration would be clipped and give another torque.
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
    """Identity and state of a servo at its examination."""

    servo: FeetechServo  # its settings in the robot file
    firmware: str  # version
    voltage_v: float  # input voltage [V]
    voltage_limits_v: tuple[float, float]  # lowest and highest that it takes [V]
    temperature_c: int  # inside it [degrees Celsius]
    temperature_limit_c: int  # from which on it protects itself [degrees Celsius]
    homing_offset: int  # subtracted from its position [counts]

    @property
    def problem(self) -> str | None:
        """Why the servo does not fit the robot file, or None."""
        nominal_v, (low_v, high_v) = self.servo.servo_model.voltage_v, self.voltage_limits_v
        is_near = abs(self.voltage_v - nominal_v) <= _VOLTAGE_SHARE * nominal_v
        if not (is_near and low_v <= self.voltage_v <= high_v):
            return f"is supplied with {self.voltage_v:.1f} V, but {self.servo.model} needs {nominal_v:g} V"
        return self.servo.homing_problem(self.homing_offset)


class FeetechLine(ServoLine):
    """See `ServoLine`.

    Args:
        torque_limits: Largest duty cycle of each servo, in its unit, by id.
    """

    dialect = protocol.DIALECT
    torque_enable = tables.TORQUE_ENABLE
    present_position = tables.PRESENT_POSITION
    goal = tables.GOAL_POSITION
    ping_size = protocol.ID_SIZE
    ping_all_s = 0.8  # 3 ms for each id: huggingface/lerobot, which finds servos in this way
    _settings: FeetechSettings
    unreachable_note = "the servos have no watchdog and hold their last goals; switch their supply off"

    def __init__(
        self, settings: FeetechSettings, torque_limits: Mapping[int, int], port: SerialPort, clock: Clock
    ) -> None:
        super().__init__(settings, RegisterAccess(protocol.DIALECT, port, clock), port, clock)
        self.torque_limits = torque_limits

    def identify(self) -> None:
        """Compare the servos with the settings; raise `DeviceError` if one is silent or different."""
        self._check_all_present()
        for servo_id in self.ids:
            self.registers.write_unconfirmed(servo_id, tables.LOCK, 1)
            self.registers.write_unconfirmed(servo_id, tables.RESPONSE_LEVEL, tables.ANSWER_EVERYTHING)
            self.registers.write_and_verify(servo_id, tables.TORQUE_ENABLE, 0)
        for identity in [self.identify_servo(servo) for servo in self._settings.turning]:
            if identity.problem:
                raise DeviceError(f"servo {identity.servo.id}: {identity.problem}")

    def identify_servo(self, servo: FeetechServo) -> ServoIdentity:
        """Read the identity of a servo; raise `DeviceError` if its model or its way to count differs.

        Args:
            servo: Its settings in the robot file.
        """
        read, servo_id = self.registers.read, servo.id
        servo.refuse_other_model(read(servo_id, tables.MODEL_NUMBER))
        phase = read(servo_id, tables.PHASE)
        for bit, needed, trouble in tables.PHASE_BITS:
            if phase >> bit & 1 != needed:
                state = "set" if needed else "clear"
                raise DeviceError(f"servo {servo_id} {trouble}: {state} bit {bit} of its phase (18)")
        firmware = read(servo_id, tables.FIRMWARE)
        limits_v = (read(servo_id, tables.MIN_VOLTAGE), read(servo_id, tables.MAX_VOLTAGE))
        return ServoIdentity(
            servo,
            firmware=f"{firmware & 0xFF}.{firmware >> 8}",
            voltage_v=0.1 * read(servo_id, tables.PRESENT_VOLTAGE),
            voltage_limits_v=(0.1 * limits_v[0], 0.1 * limits_v[1]),
            temperature_c=read(servo_id, tables.PRESENT_TEMPERATURE),
            temperature_limit_c=read(servo_id, tables.MAX_TEMPERATURE),
            homing_offset=read(servo_id, tables.HOMING_OFFSET),
        )

    def prepare(self) -> None:
        """See `ServoLine.prepare`; every servo is to follow its goal by the plain law."""
        write = self.registers.write_and_verify
        for servo_id in self.ids:
            write(servo_id, tables.TORQUE_ENABLE, 0)
            for register, value in (*_PLAIN_LAW, (tables.P_GAIN, self._settings.p_gain)):
                write(servo_id, register, value)
            write(servo_id, tables.TORQUE_LIMIT, self.torque_limits[servo_id])

    def switch_on(self) -> dict[int, int]:
        """Switch the torque on at the present positions; return them by id, or raise `DeviceError`."""
        registers, goals = self.registers, {}
        for servo_id in self.ids:
            goals[servo_id] = registers.read(servo_id, tables.PRESENT_POSITION)
            registers.write_and_verify(servo_id, tables.GOAL_POSITION, goals[servo_id])
        for servo_id in self.ids:
            registers.write_and_verify(servo_id, tables.TORQUE_ENABLE, 1)
        return goals
