"""The servos of one line as a whole: who is there, and torque on and off."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from robot_io.drivers.servo.access import RegisterAccess
from robot_io.drivers.servo.dialect import Dialect
from robot_io.drivers.servo.register import Register
from robot_io.errors import DeviceError, DeviceTimeoutError
from robot_io.serial_port import SerialPort

_SWITCH_OFF_ATTEMPTS = 3


class ServoLine(ABC):
    """Sets servos up and switches them, which may take milliseconds. A maker's adds what is its own."""

    dialect: ClassVar[Dialect]
    torque_enable: ClassVar[Register]  # 0 is off
    present_position: ClassVar[Register]
    goal: ClassVar[Register]  # what is written in each tick
    ping_size: ClassVar[int]  # bytes of what a servo says to a ping

    def __init__(self, port: SerialPort, registers: RegisterAccess, servo_ids: Sequence[int]) -> None:
        self._port, self.registers, self._ids = port, registers, servo_ids

    @property
    @abstractmethod
    def last_resort(self) -> str:
        """What happens where a servo cannot be told anything."""

    @abstractmethod
    def prepare(self) -> None:
        """Set what a run needs, and read it back; the torque is off from here on.

        DeviceError: a servo did not do what it was told.
        """

    @abstractmethod
    def switch_on(self) -> object:
        """Torque on, at zero. DeviceError: a servo refused."""

    def switch_off(self) -> None:
        """Torque off, asked of every servo until it says so. DeviceError: some did not say so, by id."""
        still_on, problem = list(self._ids), ""
        off = self.torque_enable.encode(0)
        for _ in range(_SWITCH_OFF_ATTEMPTS):
            told = dict.fromkeys(still_on, off)
            self._port.write(self.dialect.sync_write(self.torque_enable.address, told))
            failures = [(servo_id, self._why_still_on(servo_id)) for servo_id in still_on]
            still_on = [servo_id for servo_id, failure in failures if failure]
            problem = "; ".join(failure for _, failure in failures if failure)
            if not still_on:
                return
        raise DeviceError(f"torque not known to be off: {problem}; {self.last_resort}")

    def _check_all_there(self, baud_rate: int) -> None:
        """Ping everybody. DeviceError: somebody does not answer; with all who do not, and all who do."""
        missing = [servo_id for servo_id in self._ids if not self._is_there(servo_id)]
        if missing:
            there = ", ".join(str(servo_id) for servo_id in self._ids if servo_id not in missing) or "none"
            raise DeviceError(
                f"no answer from servo {', '.join(map(str, missing))} at {baud_rate} bit/s "
                f"(answering: {there}): check power, cable, id and baud rate"
            )

    def _is_there(self, servo_id: int) -> bool:
        try:
            self.registers.ping(servo_id, self.ping_size)
        except DeviceTimeoutError:
            return False
        return True

    def _why_still_on(self, servo_id: int) -> str | None:
        try:
            on = self.registers.read(servo_id, self.torque_enable)
        except DeviceError as error:
            if not self._port.is_open:
                raise
            return str(error)
        return f"servo {servo_id}: says that it is on" if on else None
