"""Which servos are on an emulated line, and how each sits on its joint."""

from collections.abc import Collection
from math import floor, pi
from typing import ClassVar

from robot_io.files.file_model import Positive
from sim_backend.emulators.dynamixel import control_table as table
from sim_backend.emulators.dynamixel.control_table import MODELS, Error, Item, Memory
from sim_backend.emulators.servo_wire import LineServo, ServoMounting
from sim_backend.emulators.shaft import Shaft


class Mounting(ServoMounting):
    """One servo as it is bolted to the arm."""

    emulated: ClassVar[Collection[str]] = MODELS

    homing_offset: int | None = None  # what a calibration has written into it
    # Of this very servo; None is as its model's data sheet says [N m/A].
    torque_constant_nm_a: Positive | None = None
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

    def __init__(self, mounting: Mounting, shaft: Shaft, now_s: float) -> None:
        super().__init__(mounting, shaft, now_s)
        self._model = table.MODELS[mounting.model]
        self.memory = Memory(table.items_of(self._model, mounting.id, mounting.firmware), self._model)
        self.memory.put(table.HOMING_OFFSET, mounting.homing_offset or 0)
        per_ampere = mounting.torque_constant_nm_a or self._model.torque_per_ampere_nm
        self._count_nm = self._direction * per_ampere * self._model.current_unit_a
        self._heard_s = now_s
        self._turn_counts: int | None = None

    def hear(self, now_s: float) -> None:
        """Any instruction on the line, for whomever, shows that the controller lives."""
        self._heard_s = now_s

    @property
    def alert(self) -> int:
        return ALERT if self.memory.get(table.HARDWARE_ERROR) else 0

    @property
    def return_level(self) -> int:
        """To what it answers beside a ping: 0 nothing, 1 reading, 2 everything."""
        return self.memory.get(table.STATUS_RETURN_LEVEL)

    @property
    def return_delay_s(self) -> float:
        return 2e-6 * self.memory.get(table.RETURN_DELAY)

    def ping(self) -> bytes:
        """Model number and firmware version."""
        firmware = self.memory.get(6)
        return self._model.number.to_bytes(2, "little") + bytes((firmware,))

    def read(self, address: int, size: int) -> bytes | Error:
        """What it answers to a read."""
        self._look()
        return self.memory.read(address, size)

    def write(self, address: int, data: bytes) -> Error:
        """Take a write, and do what it says."""
        mode = self.memory.get(table.OPERATING_MODE)
        error = self.memory.write(address, data, self._allowed)
        if self.memory.get(table.OPERATING_MODE) != mode:
            self.memory.put(table.GOAL_CURRENT, 0)
        self._exert()
        return error

    def _allowed(self, item: Item, value: int) -> Error:
        memory = self.memory
        if item.address < table.EEPROM_END and memory.get(table.TORQUE_ENABLE):
            return Error.ACCESS
        if item.address in table.GOALS and memory.get(table.BUS_WATCHDOG) == -1:
            return Error.DATA_RANGE
        if item.address == table.BUS_WATCHDOG and (value < 0 or (value and memory.get(item.address) == -1)):
            return Error.DATA_RANGE  # once it has fired, 0 clears it
        if item.address == table.GOAL_CURRENT and abs(value) > memory.get(table.CURRENT_LIMIT):
            return Error.DATA_LIMIT
        if item.address == table.TORQUE_ENABLE and value and self._shut_down:
            return Error.RESULT_FAIL  # only a reboot helps
        return Error.NONE

    @property
    def _shut_down(self) -> bool:
        return bool(self.memory.get(table.HARDWARE_ERROR) & self.memory.get(table.SHUTDOWN))

    def watch(self, now_s: float) -> None:
        """See `LineServo.watch`: its bus watchdog looks at the time."""
        limit = self.memory.get(table.BUS_WATCHDOG)
        on = self.memory.get(table.TORQUE_ENABLE)
        if on and limit > 0 and now_s - self._heard_s > limit * WATCHDOG_UNIT_S:
            self.memory.put(table.BUS_WATCHDOG, -1)
            self.memory.put(table.GOAL_CURRENT, 0)
            self._exert()

    def fail(self) -> None:
        """See `LineServo.fail`; it lets go if Shutdown names the error."""
        self.memory.put(table.HARDWARE_ERROR, self.memory.get(table.HARDWARE_ERROR) | OVERLOAD)
        if self._shut_down:
            self.memory.put(table.TORQUE_ENABLE, 0)
            self._exert()

    def reboot(self, now_s: float, away_s: float) -> None:
        """See `LineServo.reboot`: RAM, turns and errors are forgotten."""
        self.memory.lose_power()
        self._turn_counts = None
        self._awake_s = now_s + away_s
        self._exert()

    def _exert(self) -> None:
        memory = self.memory
        drives = memory.get(table.TORQUE_ENABLE) and memory.get(table.OPERATING_MODE) == CURRENT_CONTROL
        goal = memory.get(table.GOAL_CURRENT) if drives else 0
        self.shaft.exert(goal * self._count_nm)

    def _look(self) -> None:
        """Bring the present values up to date."""
        shown = self._shown()
        if shown is None:
            return  # it still shows what it had
        counts = round(shown.position_rad * COUNTS / (2 * pi))
        if self._turn_counts is None:
            self._turn_counts = floor(counts / COUNTS) * COUNTS
        memory = self.memory
        memory.put(table.PRESENT_POSITION, counts - self._turn_counts)
        memory.put(table.PRESENT_VELOCITY, round(shown.velocity_rad_s / VELOCITY_UNIT_RAD_S))
        current = round(shown.torque_nm / self._count_nm) if memory.get(table.TORQUE_ENABLE) else 0
        memory.put(table.PRESENT_CURRENT, current)
