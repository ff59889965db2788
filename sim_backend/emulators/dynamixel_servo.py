"""The control table of an X-series servo: meaning of the bytes, write permissions, and memory.

From the ROBOTIS e-manual, "Control Table" of the models below.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from math import floor, pi

from palpate.robot_io.drivers.dynamixel.tables import ServoSettings
from palpate.sim_backend.emulators.hardware import Shaft
from palpate.sim_backend.emulators.servo_wire import LineServo

EEPROM_END = 64  # below, values outlive a reboot


class Error(IntEnum):
    """Error numbers of a status packet (e-manual, "DYNAMIXEL Protocol 2.0", Status Packet)."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True)
class ControlTableItem:
    """One row of the control table."""

    address: int  # of the first byte
    size: int  # bytes
    writable: bool  # RW, or else R
    initial: int = 0  # value after a factory reset or, in RAM, after power-up
    low: int | None = None  # smallest value that may be written
    high: int | None = None  # largest value that may be written


@dataclass(frozen=True)
class EmulatedModel:
    """Properties of a model."""

    number: int  # model number
    current_unit_a: float  # [A]
    current_limit: int  # initial and largest current limit
    torque_per_ampere_nm: float  # stall torque over stall current at the recommended voltage [N m/A]
    indirect_data: int  # address of Indirect Data 1
    indirect_count: int  # how many of them are in a row
    shutdown: int  # initial value of Shutdown
    voltage: int  # present input voltage [0.1 V]
    voltage_limits: tuple[int, int]  # initial min and max voltage limit [0.1 V]


MODELS = {
    "XM430-W350": EmulatedModel(1020, 0.00269, 1193, 4.1 / 2.3, 224, 28, 52, 120, (95, 160)),
    "XM430-W210": EmulatedModel(1030, 0.00269, 1193, 3.0 / 2.3, 224, 28, 52, 120, (95, 160)),
    "XM540-W150": EmulatedModel(1130, 0.00269, 2047, 7.3 / 4.4, 224, 28, 52, 120, (95, 160)),
    "XM540-W270": EmulatedModel(1120, 0.00269, 2047, 10.6 / 4.4, 224, 28, 52, 120, (95, 160)),
    "XH540-W150": EmulatedModel(1110, 0.00269, 2047, 7.1 / 4.9, 224, 28, 52, 120, (95, 160)),
    "XH540-W270": EmulatedModel(1100, 0.00269, 2047, 9.9 / 4.9, 224, 28, 52, 120, (95, 160)),
    "XL330-M077": EmulatedModel(1190, 0.001, 1750, 0.215 / 1.47, 208, 20, 53, 50, (35, 70)),
    "XL330-M288": EmulatedModel(1200, 0.001, 1750, 0.52 / 1.47, 208, 20, 53, 50, (35, 70)),
    "XC330-T181": EmulatedModel(1210, 0.001, 910, 0.76 / 0.80, 208, 20, 52, 111, (55, 140)),
    "XC330-T288": EmulatedModel(1220, 0.001, 910, 0.92 / 0.80, 208, 20, 52, 111, (55, 140)),
    "XC330-M181": EmulatedModel(1230, 0.001, 2352, 0.60 / 1.80, 208, 20, 52, 50, (35, 70)),
    "XC330-M288": EmulatedModel(1240, 0.001, 2352, 0.93 / 1.80, 208, 20, 52, 50, (35, 70)),
}

INDIRECT_ADDRESS = 168
BUS_WATCHDOG, GOAL_CURRENT, CURRENT_LIMIT = 98, 102, 38
OPERATING_MODE, DRIVE_MODE, SECONDARY_ID, SHUTDOWN, RETURN_DELAY, HOMING_OFFSET = 11, 10, 12, 63, 9, 20
TORQUE_ENABLE, STATUS_RETURN_LEVEL, HARDWARE_ERROR = 64, 68, 70
PRESENT_CURRENT, PRESENT_VELOCITY, PRESENT_POSITION = 126, 128, 132
GOALS = range(100, 120)


def control_table(model: EmulatedModel, servo_id: int, firmware: int) -> dict[int, ControlTableItem]:
    """Return the rows of a model's control table by address, without rows that the emulator does not use.

    Args:
        model: model of the servo.
        servo_id: id of the servo.
        firmware: version.
    """
    rows = [
        ControlTableItem(0, 2, False, model.number),
        ControlTableItem(2, 4, False),
        ControlTableItem(6, 1, False, firmware),
        ControlTableItem(7, 1, True, servo_id, 0, 252),
        ControlTableItem(8, 1, True, 1, 0, 7),
        ControlTableItem(RETURN_DELAY, 1, True, 250, 0, 254),
        ControlTableItem(DRIVE_MODE, 1, True, 0, 0, 13),
        ControlTableItem(OPERATING_MODE, 1, True, 3, 0, 16),
        ControlTableItem(SECONDARY_ID, 1, True, 255, 0, 255),
        ControlTableItem(13, 1, True, 2, 1, 22),
        ControlTableItem(HOMING_OFFSET, 4, True, 0, -1044479, 1044479),
        ControlTableItem(31, 1, True, 80 if model.voltage_limits[1] > 150 else 70, 0, 100),
        ControlTableItem(32, 2, True, model.voltage_limits[1], *model.voltage_limits),
        ControlTableItem(34, 2, True, model.voltage_limits[0], *model.voltage_limits),
        ControlTableItem(CURRENT_LIMIT, 2, True, model.current_limit, 0, model.current_limit),
        ControlTableItem(SHUTDOWN, 1, True, model.shutdown, 0, 255),
        ControlTableItem(TORQUE_ENABLE, 1, True, 0, 0, 1),
        ControlTableItem(65, 1, True, 0, 0, 1),
        ControlTableItem(STATUS_RETURN_LEVEL, 1, True, 2, 0, 2),
        ControlTableItem(69, 1, False),
        ControlTableItem(HARDWARE_ERROR, 1, False),
        ControlTableItem(BUS_WATCHDOG, 1, True, 0, -1, 127),
        ControlTableItem(100, 2, True, 885, -885, 885),
        ControlTableItem(GOAL_CURRENT, 2, True, 0, -32768, 32767),
        ControlTableItem(104, 4, True, 0, -2047, 2047),
        ControlTableItem(116, 4, True, 0),
        ControlTableItem(120, 2, False),
        ControlTableItem(122, 1, False),
        ControlTableItem(123, 1, False),
        ControlTableItem(124, 2, False),
        ControlTableItem(PRESENT_CURRENT, 2, False),
        ControlTableItem(PRESENT_VELOCITY, 4, False),
        ControlTableItem(PRESENT_POSITION, 4, False),
        ControlTableItem(136, 4, False),
        ControlTableItem(140, 4, False),
        ControlTableItem(144, 2, False, model.voltage),
        ControlTableItem(146, 1, False, 32),
    ]
    end = model.indirect_data + model.indirect_count
    for k in range(model.indirect_count):
        default = model.indirect_data + k
        rows.append(ControlTableItem(INDIRECT_ADDRESS + 2 * k, 2, True, default, EEPROM_END, end - 1))
        rows.append(ControlTableItem(default, 1, True, 0, 0, 255))
    return {row.address: row for row in rows}


class Memory:
    """One servo's memory, from the rows of its control table by address."""

    def __init__(self, items: dict[int, ControlTableItem], model: EmulatedModel) -> None:
        self._items = items
        self._indirect = range(model.indirect_data, model.indirect_data + model.indirect_count)
        self._bytes = bytearray(self._indirect.stop)
        for item in items.values():
            self.put(item.address, item.initial)

    def lose_power(self) -> None:
        """Reset everything above the EEPROM to its initial state."""
        for item in self._items.values():
            if item.address >= EEPROM_END:
                self.put(item.address, item.initial)

    def get(self, address: int) -> int:
        """Return the value of an item, signed if the item's range goes below zero.

        Args:
            address: address of the item.
        """
        item = self._items[address]
        signed = item.low is not None and item.low < 0
        return int.from_bytes(self._bytes[address : address + item.size], "little", signed=signed)

    def put(self, address: int, value: int) -> None:
        """Set an item from inside the servo; nothing is checked."""
        item = self._items[address]
        data = (value % (1 << 8 * item.size)).to_bytes(item.size, "little")
        self._bytes[address : address + item.size] = data

    def read(self, address: int, size: int) -> bytes | Error:
        """Read consecutive bytes for an instruction, or return why they cannot be read.

        Args:
            address: address of the first byte.
            size: bytes.
        """
        if size < 1 or address + size > len(self._bytes):
            return Error.ACCESS
        return bytes(self._bytes[self._resolve(current)] for current in range(address, address + size))

    def write(self, address: int, data: bytes, allowed: Callable[[ControlTableItem, int], Error]) -> Error:
        """Write whole consecutive items at an address, and return the error.

        `allowed` decides for an item and its new value whether the servo accepts it now.

        Args:
            address: address of the first byte.
            data: bytes to write.
            allowed: judges an item and its new value.
        """
        current, end = address, address + len(data)
        while current < end:
            item = self._items.get(self._resolve(current))
            if item is None or not item.writable:
                return Error.ACCESS
            raw = data[current - address : current - address + item.size]
            if len(raw) < item.size:
                return Error.DATA_LENGTH
            value = int.from_bytes(raw, "little", signed=item.low is not None and item.low < 0)
            low, high = value if item.low is None else item.low, value if item.high is None else item.high
            error = allowed(item, value) if low <= value <= high else Error.DATA_RANGE
            if error:
                return error
            current += item.size
        for offset, byte in enumerate(data):
            self._bytes[self._resolve(address + offset)] = byte
        return Error.NONE

    def _resolve(self, address: int) -> int:
        """Return the address to which an indirect address refers; other addresses are unchanged."""
        if address not in self._indirect:
            return address
        at = INDIRECT_ADDRESS + 2 * (address - self._indirect.start)
        return self._bytes[at] + 256 * self._bytes[at + 1]


class DynamixelMounting(ServoSettings):
    """One servo as it is bolted to the arm, which may differ from the robot file."""

    firmware: int = 46  # version


COUNTS = 4096
VELOCITY_UNIT_RAD_S = 0.229 * 2 * pi / 60
WATCHDOG_UNIT_S = 0.020
ALERT = 0x80
OVERLOAD = 0x20
CURRENT_CONTROL = 0


class EmulatedServo(LineServo):
    """A servo that turns one joint of a plant; `memory` is its control table."""

    shaft: Shaft

    def __init__(self, mounting: DynamixelMounting, shaft: Shaft, now_s: float) -> None:
        super().__init__(mounting, shaft, now_s)
        self._model = MODELS[mounting.model]
        self.memory = Memory(control_table(self._model, mounting.id, mounting.firmware), self._model)
        self.memory.put(HOMING_OFFSET, mounting.homing_offset or 0)
        per_ampere = mounting.torque_constant_nm_a or self._model.torque_per_ampere_nm
        self._count_nm = self._direction * per_ampere * self._model.current_unit_a
        self._turn_counts: int | None = None

    @property
    def alert(self) -> int:
        return ALERT if self.memory.get(HARDWARE_ERROR) else 0

    @property
    def return_level(self) -> int:
        """Status return level: 0 answers only pings, 1 also reads, 2 everything."""
        return self.memory.get(STATUS_RETURN_LEVEL)

    @property
    def return_delay_s(self) -> float:
        return 2e-6 * self.memory.get(RETURN_DELAY)

    def ping(self) -> bytes:
        """Model number and firmware version."""
        firmware = self.memory.get(6)
        return self._model.number.to_bytes(2, "little") + bytes((firmware,))

    def read(self, address: int, size: int) -> bytes | Error:
        """Answer a read, with the newest sample of the sensors, or return why it cannot be answered.

        Args:
            address: address of the first byte.
            size: bytes.
        """
        self._sample_position()
        return self.memory.read(address, size)

    def write(self, address: int, data: bytes) -> Error:
        """Execute a write, and return the error.

        Args:
            address: address of the first byte.
            data: bytes to write.
        """
        mode = self.memory.get(OPERATING_MODE)
        error = self.memory.write(address, data, self._allowed)
        if self.memory.get(OPERATING_MODE) != mode:
            self.memory.put(GOAL_CURRENT, 0)
        self._exert()
        return error

    def _allowed(self, item: ControlTableItem, value: int) -> Error:
        memory = self.memory
        if item.address < EEPROM_END and memory.get(TORQUE_ENABLE):
            return Error.ACCESS
        if item.address in GOALS and memory.get(BUS_WATCHDOG) == -1:
            return Error.DATA_RANGE
        if item.address == BUS_WATCHDOG and (value < 0 or (value and memory.get(item.address) == -1)):
            return Error.DATA_RANGE  # once it has fired, 0 clears it
        if item.address == GOAL_CURRENT and abs(value) > memory.get(CURRENT_LIMIT):
            return Error.DATA_LIMIT
        if item.address == TORQUE_ENABLE and value and self._shut_down:
            return Error.RESULT_FAIL  # only a reboot helps
        return Error.NONE

    @property
    def _shut_down(self) -> bool:
        return bool(self.memory.get(HARDWARE_ERROR) & self.memory.get(SHUTDOWN))

    def watch(self, now_s: float) -> None:
        """See `LineServo.watch`: checks the bus watchdog."""
        silent_s = now_s - self.heard_s
        if silent_s <= WATCHDOG_UNIT_S:  # the shortest limit
            return
        limit = self.memory.get(BUS_WATCHDOG)
        if self.memory.get(TORQUE_ENABLE) and 0.0 < limit * WATCHDOG_UNIT_S < silent_s:
            self.memory.put(BUS_WATCHDOG, -1)
            self.memory.put(GOAL_CURRENT, 0)
            self._exert()

    def fail(self) -> None:
        """See `LineServo.fail`; the torque goes off if Shutdown includes the error."""
        self.memory.put(HARDWARE_ERROR, self.memory.get(HARDWARE_ERROR) | OVERLOAD)
        if self._shut_down:
            self.memory.put(TORQUE_ENABLE, 0)
            self._exert()

    def reboot(self, now_s: float, downtime_s: float) -> None:
        """See `LineServo.reboot`: RAM, turns and errors are cleared."""
        self.memory.lose_power()
        self._turn_counts = None
        self.awake_s = now_s + downtime_s
        self._exert()

    def _exert(self) -> None:
        memory = self.memory
        drives = memory.get(TORQUE_ENABLE) and memory.get(OPERATING_MODE) == CURRENT_CONTROL
        goal = memory.get(GOAL_CURRENT) if drives else 0
        self.shaft.exert(goal * self._count_nm)

    def _sample_position(self) -> None:
        """Bring the present values up to date."""
        measured = self._measured()
        if measured is None:
            return  # the old values remain
        counts = round(measured.position_rad * COUNTS / (2 * pi))
        if self._turn_counts is None:
            self._turn_counts = floor(counts / COUNTS) * COUNTS
        memory = self.memory
        memory.put(PRESENT_POSITION, counts - self._turn_counts)
        memory.put(PRESENT_VELOCITY, round(measured.velocity_rad_s / VELOCITY_UNIT_RAD_S))
        current = round(measured.torque_nm / self._count_nm) if memory.get(TORQUE_ENABLE) else 0
        memory.put(PRESENT_CURRENT, current)
