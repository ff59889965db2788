"""All servos of one bus: found, examined, and their torque switched on and off."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NamedTuple, get_args

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.servo.access import Register, RegisterAccess
from palpate.robot_io.drivers.servo.settings import ServoBusSettings
from palpate.robot_io.drivers.servo.stream import ServoDialect
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError
from palpate.robot_io.examination import Finding, fail, warn
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


TOO_HOT = "let it cool down; see what it pushes against, and lower its load"


def examine_line(
    settings: ServoBusSettings[Any], line: ServoLine, examine_servo: Callable[[int, str], Iterable[Finding]]
) -> list[Finding]:
    """Find out who is on the line, and look at every servo of the robot file.

    Args:
        settings: What the robot file says.
        line: The line, whose port is open and stays so.
        examine_servo: Looks at one servo that answers, by its id and label.

    Raises:
        DeviceError: The port failed.
    """
    answers, damaged = _ask_everybody(line, line.port)
    if not any(answers[servo_id] for servo_id in line.ids) and not damaged:
        return [_nobody(settings, line, answers)]
    strangers = sorted(answers.keys() - set(line.ids))
    others = f", but {_ids(strangers)}, which the robot file does not have" if strangers else ""
    findings: list[Finding] = []
    for servo_id, label in zip(line.ids, settings.labels, strict=True):
        if answers[servo_id] > 1:
            findings.append(fail(label, "answers twice", TWO_SERVOS))
        elif servo_id in damaged:
            findings.append(
                fail(label, "its answers are damaged", f"check cable and ground; or {TWO_SERVOS}")
            )
        elif not answers[servo_id]:
            remedy = "check its cable and power, or set its id"
            findings.append(fail(label, f"does not answer{others}", remedy))
        else:
            findings += _look_at(servo_id, label, examine_servo)
    if strangers:
        remedy = "take it off the line, or correct the ids"
        findings.append(warn("other servos", f"{_ids(strangers)} on the line too", remedy))
    return findings


def _look_at(
    servo_id: int, label: str, examine_servo: Callable[[int, str], Iterable[Finding]]
) -> list[Finding]:
    try:
        return list(examine_servo(servo_id, label))
    except DeviceTimeoutError as error:
        return [fail(label, f"answers now and then: {error}", "check plugs, cable and ground")]
    except DeviceError as error:
        return [fail(label, str(error), "correct the model or the id, or set the servo up")]


def _ask_everybody(line: ServoLine, port: SerialPort) -> Survey:
    """Ping all at once, and those of the robot file by themselves: some firmware answers only the latter."""
    port.read_all()
    request = line.dialect.ping_all()
    reader, answers = line.dialect.packet_reader(request), Counter[int]()
    port.write(request)
    deadline_s = line.clock.now_s() + line.ping_all_s
    while line.clock.now_s() < deadline_s:
        answers.update(packet.servo_id for packet in reader.feed(port.wait(deadline_s)))
    own = line.survey(RegisterAccess(line.dialect, port, line.clock))
    return Survey(answers | own.answers, own.damaged)  # the larger number of each


def _nobody(settings: ServoBusSettings[Any], line: ServoLine, answers: Counter[int]) -> Finding:
    """None of the servos answers: others may, or all of them at another baud rate."""
    if answers:
        value = f"{_ids(line.ids)} silent, on the line are {_ids(sorted(answers))}"
        return fail("servos", value, "correct the ids in the robot file or in the servos")
    for baud_rate in get_args(type(settings).model_fields["baud_rate"].annotation):
        there = _heard_at(line, baud_rate) if baud_rate != settings.baud_rate else []
        if there:
            value = f"silent at {settings.baud_rate} bit/s; at {baud_rate} bit/s: {_ids(there)}"
            return fail("servos", value, f"set baud_rate: {baud_rate}, or change it in the servos")
    return fail("servos", "nobody answers at any baud rate", "check power supply, cable and adapter")


def _heard_at(line: ServoLine, baud_rate: int) -> list[int]:
    line.port.close()
    port = SerialPort(line.port.path, baud_rate, line.clock)
    try:
        port.open()
        return sorted(+_ask_everybody(line, port).answers)
    except DeviceError:  # the adapter does not know this rate
        return []
    finally:
        port.close()
        line.port.open()


def _ids(ids: Iterable[int]) -> str:
    known = list(ids)
    return f"id{'s' if len(known) > 1 else ''} {listed(known)}"
