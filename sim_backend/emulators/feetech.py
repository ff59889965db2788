"""Feetech servos of the STS series on a pseudo terminal, with the simulated arm behind them.

Written from Feetech's protocol manual and memory table of the SMS/STS series and the data sheet of STS3215;
it shares no code with the driver but its settings. How the duty cycle follows from the position error is
Rhoban's measurement (BAM). Goal speeds are understood as "any" or "stop" only. What its D coefficient does is
not known, and left out. Values below address 40 outlive a restart if they were written while the lock was 0.
"""

from math import isfinite, pi
from typing import Any

from palpate.robot_io.drivers.feetech.tables import FeetechServo, FeetechSettings
from palpate.sim_backend.emulators.hardware import EmulatedWire, Shaft
from palpate.sim_backend.emulators.servo_wire import (
    LineServo,
    ServoInstruction,
    ServoReply,
    ServoWire,
)
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest


def parse_instruction(pending: bytearray) -> ServoInstruction | None:
    """See `ServoWire._parse`; damaged instructions get no answer.

    Args:
        pending: received bytes.
    """
    while len(pending) >= 6:
        if pending[0] != 0xFF or pending[1] != 0xFF or pending[3] < 2:
            del pending[0]
            continue
        total = pending[3] + 4
        if len(pending) < total:
            return None
        if _inverted_sum(pending[2 : total - 1]) != pending[total - 1]:
            del pending[0]
            continue
        packet = bytes(pending[:total])
        del pending[:total]
        return ServoInstruction(packet[2], packet[4], packet[5:-1], total)
    return None


def _inverted_sum(content: bytes | bytearray) -> int:
    """Compute the checksum of the bytes between header and checksum: all bits of their sum inverted."""
    return 255 - sum(content) % 256


def status(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """Make a status packet with its checksum.

    Args:
        servo_id: id of the sender.
        error: bits.
        data: parameters.
    """
    content = bytes((servo_id, len(data) + 2, error)) + data
    return b"\xff\xff" + content + bytes((_inverted_sum(content),))


_KG_CM = 0.0980665
MODELS = {  # supply [V], stall torque [N m], no-load speed [rad/s]
    "STS3215-7.4V": (7.4, 19.5 * _KG_CM, 60 / 0.222 * pi / 180),
    "STS3215-12V": (12.0, 30.0 * _KG_CM, 60 / 0.222 * pi / 180),
}
COUNTS = 4096
EPROM_END = 40
OVERLOAD = 0x20
FINE_SPEEDS, ZERO_IS_ANY_SPEED = 0x04, 0x08  # bits of the phase
_PROTECTED = 0.2  # of the duty cycle, once it is overloaded

# Address, size, value as delivered.
_TABLE = (
    *(
        (0, 1, 3),
        (1, 1, 9),
        (3, 2, 777),
        (5, 1, 1),
        (6, 1, 0),
        (7, 1, 0),
        (8, 1, 1),
        (9, 2, 0),
        (11, 2, 4095),
    ),
    *((13, 1, 70), (14, 1, 140), (15, 1, 40), (16, 2, 1000), (18, 1, 12), (19, 1, 44), (20, 1, 47)),
    *((21, 1, 32), (22, 1, 32), (23, 1, 0), (24, 2, 16), (26, 1, 1), (27, 1, 1), (28, 2, 500), (30, 1, 1)),
    *((31, 2, 0), (33, 1, 0), (34, 1, 20), (35, 1, 200), (36, 1, 80), (37, 1, 10), (38, 1, 200), (39, 1, 10)),
    *((40, 1, 0), (41, 1, 0), (42, 2, 2048), (44, 2, 0), (46, 2, 0), (48, 2, 1000), (55, 1, 1)),
    *((56, 2, 2048), (58, 2, 0), (60, 2, 0), (62, 1, 0), (63, 1, 30), (65, 1, 0), (66, 1, 0), (69, 2, 0)),
)
_READ_ONLY = {0, 1, 3, 4, *range(56, 71)}


class EmulatedSts(LineServo):
    """A servo that turns one joint of a plant, or only holds its position.

    Attributes:
        error: error bits of the servo.
        stall_nm: torque of its motor at full duty [N m]; differs from servo to servo.
        no_load_rad_s: speed without a load [rad/s].
        duty_per_rad: duty cycle for a position error and a P coefficient of 1 [1/rad].
    """

    def __init__(self, mounting: FeetechServo, shaft: Shaft | None, now_s: float) -> None:
        super().__init__(mounting, shaft, now_s)
        self._voltage_v, self.stall_nm, self.no_load_rad_s = MODELS[mounting.model]
        self.duty_per_rad = 0.166
        self._memory = bytearray(90)
        for address, size, value in _TABLE:
            self.put(address, value, size)
        self.put(5, mounting.id, 1)
        offset = mounting.homing_offset or 0
        self.put(31, abs(offset) | (0x800 if offset < 0 else 0))
        self._saved = bytes(self._memory[:EPROM_END])
        self.error = 0
        self.supply_v = self._voltage_v
        self._watched: tuple[object, ...] = ()  # state of its control
        self._sample_position()

    def get(self, address: int, size: int = 2) -> int:
        """Return a value of the memory, without a sign.

        Args:
            address: address of the first byte.
            size: bytes, 1 or 2.
        """
        low = self._memory[address]
        return low if size == 1 else low | self._memory[address + 1] << 8

    def put(self, address: int, value: int, size: int = 2) -> None:
        """Set a value from inside the servo; nothing is checked.

        Args:
            address: address of the first byte.
            value: value without a sign.
            size: bytes.
        """
        self._memory[address : address + size] = value.to_bytes(size, "little")

    @property
    def alert(self) -> int:
        return self.error

    @property
    def return_delay_s(self) -> float:
        return 2e-6 * self.get(7, 1)

    def read(self, address: int, size: int) -> bytes:
        """Answer a read.

        Args:
            address: address of the first byte.
            size: bytes.
        """
        return bytes(self._memory[address : address + size])

    def write(self, address: int, data: bytes) -> None:
        """Execute a write; registers that cannot be written are unchanged.

        Args:
            address: address of the first byte.
            data: bytes to write.
        """
        was_on = self.get(40, 1)
        for place, byte in enumerate(data, address):
            if place < len(self._memory) and place not in _READ_ONLY:
                self._memory[place] = byte
        if address < EPROM_END and not self.get(55, 1):
            self._saved = bytes(self._memory[:EPROM_END])
        if self.get(40, 1) and not was_on:
            self.error &= ~OVERLOAD
        self._drive()

    def watch(self, now_s: float) -> None:
        """Read the position sensor and control the position; steps are shorter than samples of the joint."""
        shaft = self.shaft
        joint = (shaft.state(), shaft.limp, shaft.backwards) if shaft else None
        if (joint, self.stuck, self.error, self.supply_v, self._memory) == self._watched:
            return
        self._sample_position()
        self._drive()
        self._watched = (joint, self.stuck, self.error, self.supply_v, bytes(self._memory))

    def fail(self) -> None:
        self.error |= OVERLOAD

    def reboot(self, now_s: float, downtime_s: float) -> None:
        """See `LineServo.reboot`; values below address 40 are as last saved, the others as delivered."""
        for address, size, value in _TABLE:
            self.put(address, value, size)
        self._memory[:EPROM_END] = self._saved
        self.put(48, self.get(16))
        self.error = 0
        self.awake_s = now_s + downtime_s
        self._sample_position()
        self._drive()

    def _sample_position(self) -> None:
        measured = self._measured()
        if measured is None:
            return
        self.put(56, round(measured.position_rad * COUNTS / (2 * pi)) % COUNTS)
        step = 1 if self.get(18, 1) & FINE_SPEEDS else 50  # counts/s
        self.put(58, _signed(round(measured.velocity_rad_s * COUNTS / (2 * pi) / step), 15))
        self.put(62, round(10 * self.supply_v), 1)
        self.put(65, self.error, 1)

    def _drive(self) -> None:
        duty = self._duty() if self.get(40, 1) else 0.0
        self.put(60, _signed(round(1000 * duty), 10))
        if self.shaft:
            drag = self._direction * self.shaft.state().velocity_rad_s / self.no_load_rad_s
            effort = duty - drag if self.get(40, 1) and isfinite(drag) else 0.0
            self.shaft.exert(self._direction * effort * self.stall_nm)

    def _duty(self) -> float:
        if not (self.get(46) or self.get(18, 1) & ZERO_IS_ANY_SPEED):
            return 0.0  # the goal speed is a stop
        goal = self.get(42)
        target = -(goal & 0x7FFF) if goal & 0x8000 else goal
        target = min(max(target, self.get(9)), self.get(11))
        error = target - self.get(56)
        if -self.get(27, 1) < error < self.get(26, 1):
            return 0.0
        duty = self.duty_per_rad * self.get(21, 1) * error * 2 * pi / COUNTS
        largest = min(self.get(48), 1000) / 1000
        largest = min(largest, _PROTECTED) if self.error & OVERLOAD else largest
        return min(max(duty, -largest), largest)


def _signed(value: int, bit: int) -> int:
    """Encode as sign and magnitude; clipped to the largest number."""
    return min(abs(value), (1 << bit) - 1) | (1 << bit if value < 0 else 0)


_GOAL = 42
_PING, _READ, _WRITE, _SYNC_READ, _SYNC_WRITE = 0x01, 0x02, 0x03, 0x82, 0x83


class EmulatedFeetechLine(ServoWire[EmulatedSts]):
    """Servos of one line, see `ServoWire`."""

    _parse = staticmethod(parse_instruction)
    _servo = staticmethod(EmulatedSts)
    _status = staticmethod(status)

    def _execute(self, instruction: ServoInstruction, servo: EmulatedSts, now_s: float) -> ServoReply | None:
        code, parameters = instruction.code, instruction.parameters
        if code == _READ and len(parameters) == 2:
            return ServoReply(servo, servo.read(*parameters))
        if code == _PING:
            return ServoReply(servo)
        if code == _WRITE and len(parameters) > 1:
            servo.write(parameters[0], parameters[1:])
            return ServoReply(servo) if servo.get(8, 1) else None
        return None

    def _execute_broadcast(
        self, instruction: ServoInstruction, awake: dict[int, EmulatedSts], now_s: float
    ) -> None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            self._answer((ServoReply(servo) for _, servo in sorted(awake.items())), now_s)
        elif code == _SYNC_READ:
            address, size, *requested_ids = parameters
            answering = [awake[servo_id] for servo_id in requested_ids if servo_id in awake]
            self._answer((ServoReply(servo, servo.read(address, size)) for servo in answering), now_s)
        elif code == _SYNC_WRITE:
            address, size = parameters[:2]
            for start in range(2, len(parameters) - size, size + 1):
                servo = awake.get(parameters[start])
                if servo is not None and not (servo.deaf and address == _GOAL):
                    servo.write(address, parameters[start + 1 : start + 1 + size])


class FeetechWires(WireMaker):
    """Servos configured as in the robot file, on a pseudo terminal."""

    name = "feetech_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        settings = request.settings_as(FeetechSettings)
        line = EmulatedFeetechLine(
            settings.servos,
            request.plant,
            request.faults,
            hold=[FeetechServo(id=servo_id, model=settings.servos[0].model) for servo_id in settings.hold],
            baud_rate=settings.baud_rate,
            start_s=request.start_s,
        )
        return line, {"port": line.path}
