"""The servos of one line as a whole: who is there, and torque on and off."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.servo.access import Register, RegisterAccess, ServoDialect
from palpate.robot_io.drivers.servo.settings import ServoBusSettings
from palpate.robot_io.errors import DeviceError
from palpate.robot_io.serial_port import SerialPort

_SWITCH_OFF_ATTEMPTS = 3
TWO_SERVOS = "two servos have this id: connect one of them alone, and give it another"


class Survey(NamedTuple):
    """Who answers on a line."""

    answers: Counter[int]  # number of answers by id; more than one where several servos have it
    damaged: tuple[int, ...]  # ids from which nothing but damaged answers came


def listed(ids: Iterable[int]) -> str:
    """Join ids for a message."""
    return ", ".join(map(str, ids))


class ServoLine(ABC):
    """Sets servos up and switches them, which may take milliseconds. A maker's adds what is its own.

    Args:
        settings: What the robot file says.
        registers: Access to single servos on `port`.
        port: Port of the line; it may be opened later.
        clock: Clock of the deadlines.
    """

    dialect: ClassVar[ServoDialect]
    torque_enable: ClassVar[Register]  # 0 is off
    present_position: ClassVar[Register]
    goal: ClassVar[Register]  # what is written in each tick
    ping_size: ClassVar[int]  # bytes of what a servo says to a ping
    ping_all_s: ClassVar[float]  # until all ids have answered to a ping of all [s]

    def __init__(
        self, settings: ServoBusSettings[Any], registers: RegisterAccess, port: SerialPort, clock: Clock
    ) -> None:
        self._settings, self.registers, self.port, self.clock = settings, registers, port, clock
        self.ids = settings.ids

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
        still_on, problem = list(self.ids), ""
        off = self.torque_enable.encode(0)
        for _ in range(_SWITCH_OFF_ATTEMPTS):
            told = dict.fromkeys(still_on, off)
            self.port.write(self.dialect.sync_write(self.torque_enable.address, told))
            failures = [(servo_id, self._why_still_on(servo_id)) for servo_id in still_on]
            still_on = [servo_id for servo_id, failure in failures if failure]
            problem = "; ".join(failure for _, failure in failures if failure)
            if not still_on:
                return
        raise DeviceError(f"the torque may still be on: {problem}; {self.last_resort}")

    def survey(self, registers: RegisterAccess) -> Survey:
        """Ping each servo of the settings by itself.

        Args:
            registers: Access to the line, perhaps at another baud rate than that of the settings.

        Raises:
            DeviceError: The port failed.
        """
        counts = {servo_id: registers.count_answers(servo_id, self.ping_size) for servo_id in self.ids}
        damaged = tuple(servo_id for servo_id, (answers, bad) in counts.items() if bad and not answers)
        return Survey(Counter({servo_id: answers for servo_id, (answers, _) in counts.items()}), damaged)

    def _check_all_there(self) -> None:
        """Ping everybody. DeviceError: somebody does not answer, or answers twice; with all who do not."""
        answers, damaged = self.survey(self.registers)
        missing = [servo_id for servo_id in self.ids if not answers[servo_id]]
        if missing:
            there = listed(+answers) or "none"
            why = "check power, cable, id and baud rate"
            if damaged:
                why = f"damaged answers from servo {listed(damaged)}: do two servos have this id?"
            raise DeviceError(
                f"no answer from servo {listed(missing)} at {self._settings.baud_rate} bit/s "
                f"(answering: {there}): {why}"
            )
        for servo_id in self.ids:
            if answers[servo_id] > 1:
                raise DeviceError(f"servo {servo_id} answers twice: {TWO_SERVOS}")

    def _why_still_on(self, servo_id: int) -> str | None:
        try:
            on = self.registers.read(servo_id, self.torque_enable)
        except DeviceError as error:
            if not self.port.is_open:
                raise
            return str(error)
        return f"servo {servo_id}: says that it is on" if on else None
