"""Registers of servos, and the search, examination and switching of all servos of one bus."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, get_args

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.servo.joints import ServoBusSettings
from palpate.robot_io.drivers.servo.stream import PacketStream, ServoAnswer, ServoProtocol
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, ProtocolError
from palpate.robot_io.examination import Finding, fail, warn
from palpate.robot_io.serial_port import SerialPort


@dataclass(frozen=True, slots=True)
class Register:
    """One value of a servo."""

    name: str  # as in the manual
    address: int  # of its first byte
    size: int  # bytes
    signed: bool = False  # whether it can be negative, in two's complement
    sign_bit: int | None = None  # sign bit, if the other bits are the magnitude

    def encode(self, value: int) -> bytes:
        """Encode a value; raise `ProtocolError` if it does not fit.

        Args:
            value: number to write, in the register's unit.
        """
        number = value
        if self.sign_bit is not None:
            number = abs(value) | (value < 0) << self.sign_bit
            if abs(value) >> self.sign_bit:
                raise ProtocolError(
                    f"{value} does not fit into {self.name} ({self.sign_bit} bits and a sign)"
                )
        try:
            return number.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError as error:
            raise ProtocolError(f"{value} does not fit into {self.name} ({self.size} bytes)") from error

    def decode(self, data: bytes) -> int:
        """Decode a value in the register's unit; raise `ProtocolError` for another number of bytes.

        Args:
            data: bytes as they were read.
        """
        if len(data) != self.size:
            raise ProtocolError(f"{self.name} has {len(data)} bytes instead of {self.size}")
        return self.signed_value(int.from_bytes(data, "little", signed=self.signed))

    def signed_value(self, number: int) -> int:
        """Convert a number with an optional sign bit.

        Args:
            number: the raw number.
        """
        if self.sign_bit is None:
            return number
        magnitude = number & ((1 << self.sign_bit) - 1)
        return -magnitude if number >> self.sign_bit & 1 else magnitude


_PATIENCE_S = 0.02  # longest wait beyond the time on the wire: USB adapters may hold bytes back for 16 ms
_SECOND_ANSWER_S = 3e-3  # after this time, a second servo with the same id has answered too
_OVERHEAD = 12  # largest number of bytes of a packet in addition to its data


class RegisterAccess:
    """Reads and writes registers, by any servo protocol."""

    def __init__(self, dialect: ServoProtocol, port: SerialPort, clock: Clock) -> None:
        self._dialect, self._port, self._clock = dialect, port, clock
        self._alert = False  # of the last value that was read

    def ping(self, servo_id: int, size: int = 0) -> bytes:
        """Request the identity of a servo; return the data of its answer.

        Args:
            servo_id: id of the servo.
            size: Number of bytes of its answer.

        Raises:
            DeviceTimeoutError: No answer.
            DeviceError: The port failed, or the servo refused.
        """
        packet = self._ask(servo_id, self._dialect.ping(servo_id), size)
        self._check(packet, "ping")
        return packet.data

    def count_answers(self, servo_id: int, size: int = 0) -> tuple[int, int]:
        """Count the answers to one ping: two if two servos have the same id.

        Args:
            servo_id: id of the servo.
            size: Number of bytes of an answer.

        Returns:
            Number of answers, and of damaged ones: two servos that answer at once damage each other's.

        Raises:
            DeviceError: The port failed.
        """
        (reader, deadline_s), answers = self._send(self._dialect.ping(servo_id), size), 0
        while self._clock.now_s() < deadline_s:
            packets: list[ServoAnswer] = reader.feed(self._port.wait(deadline_s))
            new = sum(packet.servo_id == servo_id and len(packet.data) == size for packet in packets)
            if new and not answers:
                deadline_s = min(deadline_s, self._clock.now_s() + _SECOND_ANSWER_S)
            answers += new
        return answers, reader.rejected

    def read(self, servo_id: int, register: Register) -> int:
        """Read a register.

        Args:
            servo_id: id of the servo.
            register: register of the servo.

        Raises:
            DeviceTimeoutError: No answer.
            DeviceError: The port failed, or the servo refused.
        """
        packet = self._read(servo_id, register)
        self._check(packet, f"reading {register.name}")
        self._alert = packet.alert
        return register.decode(packet.data)

    def write(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register, and wait for the confirmation.

        Args:
            servo_id: id of the servo.
            register: register of the servo.
            value: New value, in the servo's unit.

        Raises:
            DeviceTimeoutError: No answer.
            DeviceError: The port failed, or the servo refused, with its hardware error if it has one.
        """
        self.write_bytes(servo_id, register.address, register.encode(value), f"setting {register.name}")

    def write_bytes(self, servo_id: int, address: int, data: bytes, what: str) -> None:
        """Set consecutive bytes, and wait for the confirmation; raise `DeviceError` as `write` does.

        Args:
            servo_id: id of the servo.
            address: address of the first byte.
            data: new bytes.
            what: name of the step in errors.
        """
        self._check(self._ask(servo_id, self._dialect.write(servo_id, address, data), 0), what)

    def write_and_verify(
        self, servo_id: int, register: Register, value: int, *, is_stored: bool = False
    ) -> None:
        """Set a register and read it back; raise `DeviceError` as `write` does, or if the value differs.

        Args:
            servo_id: id of the servo.
            register: register of the servo.
            value: New value, in the servo's unit.
            is_stored: Whether the register keeps its value without power. Its memory wears out with each
                writing, so it is only set if it differs.
        """
        if is_stored and self.read(servo_id, register) == value:
            return
        self.write(servo_id, register, value)
        self._confirm(servo_id, register, value)

    def write_unconfirmed(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register of a servo that may not answer to writing, and read it back; see `write_and_verify`.

        Args:
            servo_id: id of the servo.
            register: register of the servo.
            value: value in the servo's unit.
        """
        self._port.write(self._dialect.write(servo_id, register.address, register.encode(value)))
        self._confirm(servo_id, register, value)

    def describe_alert(self, servo_id: int) -> str:
        """Return the cause of the alert in a servo's answers, to be added to a message; empty if unknown."""
        return ""

    def _confirm(self, servo_id: int, register: Register, value: int) -> None:
        stored = self.read(servo_id, register)
        if stored != value:
            why = self.describe_alert(servo_id) if self._alert else ""
            raise DeviceError(
                f"servo {servo_id}: {register.name} is {stored} after it was set to {value}{why}"
            )

    def _read(self, servo_id: int, register: Register) -> ServoAnswer:
        request = self._dialect.read(servo_id, register.address, register.size)
        return self._ask(servo_id, request, register.size)

    def _ask(self, servo_id: int, request: bytes, size: int) -> ServoAnswer:
        reader, deadline_s = self._send(request, size)
        while True:
            packets: list[ServoAnswer] = reader.feed(self._port.wait(deadline_s))
            for packet in packets:
                if packet.servo_id == servo_id and (packet.refusal or len(packet.data) == size):
                    return packet
            if self._clock.now_s() >= deadline_s:
                damaged = f" ({reader.rejected} damaged answers)" if reader.rejected else ""
                raise DeviceTimeoutError(f"servo {servo_id}: no answer{damaged}")

    def _send(self, request: bytes, size: int) -> tuple[PacketStream[Any], float]:
        """Send a request; return the reader of its answers of `size` bytes, and the end of the wait [s]."""
        self._port.read_all()
        reader = self._dialect.packet_reader(request)
        self._port.write(request)
        wire_s = self._port.duration_s(len(request) + _OVERHEAD + size)
        return reader, self._clock.now_s() + wire_s + _PATIENCE_S

    def _check(self, packet: ServoAnswer, what: str) -> None:
        if not packet.refusal:
            return
        problem = f"servo {packet.servo_id}: {what}: {packet.refusal}"
        if packet.alert:
            problem += self.describe_alert(packet.servo_id)
        raise DeviceError(problem)


_SWITCH_OFF_ATTEMPTS = 3
TWO_SERVOS = "two servos have this id: connect one of them alone, and give it another id"


class PingResult(NamedTuple):
    """Servos that answer on a line."""

    answers: Counter[int]  # number of answers by id; more than one if several servos have this id
    damaged: tuple[int, ...]  # ids from which only damaged answers came


def _join_ids(ids: Iterable[int]) -> str:
    return ", ".join(map(str, ids))


class ServoLine(ABC):
    """Configures servos and switches their torque on and off; calls may take milliseconds."""

    dialect: ClassVar[ServoProtocol]
    torque_enable: ClassVar[Register]  # 0 is off
    present_position: ClassVar[Register]
    goal: ClassVar[Register]  # register written in each tick
    ping_size: ClassVar[int]  # bytes of a servo's answer to a ping
    ping_all_s: ClassVar[float]  # longest time until all ids have answered to a ping of all [s]

    def __init__(
        self, settings: ServoBusSettings[Any], registers: RegisterAccess, port: SerialPort, clock: Clock
    ) -> None:
        self._settings, self.registers, self.port, self.clock = settings, registers, port, clock
        self.ids = settings.ids

    @property
    @abstractmethod
    def unreachable_note(self) -> str:
        """What happens if a servo cannot be reached, for messages."""

    @abstractmethod
    def prepare(self) -> None:
        """Write the settings for a run and read them back; raise `DeviceError` if they differ.

        The torque is off from here on.
        """

    @abstractmethod
    def switch_on(self) -> object:
        """Switch the torque on, at zero; raise `DeviceError` if a servo refused."""

    def switch_off(self) -> None:
        """Switch the torque off until every servo confirms; raise `DeviceError` with the ids that did not."""
        still_on, problem = list(self.ids), ""
        off = self.torque_enable.encode(0)
        for _ in range(_SWITCH_OFF_ATTEMPTS):
            self.port.write(self.dialect.sync_write(self.torque_enable.address, dict.fromkeys(still_on, off)))
            failures = [(servo_id, self._switch_off_failure(servo_id)) for servo_id in still_on]
            still_on = [servo_id for servo_id, failure in failures if failure]
            problem = "; ".join(failure for _, failure in failures if failure)
            if not still_on:
                return
        raise DeviceError(f"the torque may still be on: {problem}; {self.unreachable_note}")

    def ping_each(self, registers: RegisterAccess) -> PingResult:
        """Ping each servo of the settings separately; raise `DeviceError` if the port failed.

        Args:
            registers: Access to the line, perhaps at another baud rate than that of the settings.
        """
        counts = {servo_id: registers.count_answers(servo_id, self.ping_size) for servo_id in self.ids}
        damaged = tuple(servo_id for servo_id, (answers, bad) in counts.items() if bad and not answers)
        return PingResult(Counter({servo_id: answers for servo_id, (answers, _) in counts.items()}), damaged)

    def _check_all_present(self) -> None:
        """Ping all servos; raise a `DeviceError` that names those that do not answer, or answer twice."""
        answers, damaged = self.ping_each(self.registers)
        missing = [servo_id for servo_id in self.ids if not answers[servo_id]]
        if missing:
            answering = _join_ids(+answers) or "none"
            why = "check power, cable, id and baud rate"
            if damaged:
                why = f"damaged answers from servo {_join_ids(damaged)}: do two servos have this id?"
            raise DeviceError(
                f"no answer from servo {_join_ids(missing)} at {self._settings.baud_rate} bit/s "
                f"(answering: {answering}): {why}"
            )
        for servo_id in self.ids:
            if answers[servo_id] > 1:
                raise DeviceError(f"servo {servo_id} answers twice: {TWO_SERVOS}")

    def _switch_off_failure(self, servo_id: int) -> str | None:
        try:
            on = self.registers.read(servo_id, self.torque_enable)
        except DeviceError as error:
            if not self.port.is_open:
                raise
            return str(error)
        return f"servo {servo_id}: reports that its torque is on" if on else None


IS_ON = "its torque is on, although it was switched off"
TOO_HOT = "let the servo cool down, check what it pushes against, and lower its load"


def examine_line(
    settings: ServoBusSettings[Any], line: ServoLine, examine_servo: Callable[[int, str], Iterable[Finding]]
) -> list[Finding]:
    """Find the servos on the line, examine each of the robot file; raise `DeviceError` if the port failed.

    Args:
        settings: Settings in the robot file.
        line: The line, whose port stays open.
        examine_servo: Examines one servo that answers, by its id and label.
    """
    answers, damaged = _ping_all(line, line.port)
    if not any(answers[servo_id] for servo_id in line.ids) and not damaged:
        return [_silence_finding(settings, line, answers)]
    unknown_ids = sorted(answers.keys() - set(line.ids))
    extra = f", but {_describe_ids(unknown_ids)}, which the robot file does not list" if unknown_ids else ""
    findings: list[Finding] = []
    for servo_id, label in zip(line.ids, settings.labels, strict=True):
        if answers[servo_id] > 1:
            findings.append(fail(label, "answers twice", TWO_SERVOS))
        elif servo_id in damaged:
            findings.append(
                fail(
                    label,
                    "its answers are damaged",
                    f"check cable and ground; if they are right, {TWO_SERVOS}",
                )
            )
        elif not answers[servo_id]:
            remedy = "check its cable and power, or set its id"
            findings.append(fail(label, f"does not answer{extra}", remedy))
        else:
            try:
                findings += list(examine_servo(servo_id, label))
            except DeviceTimeoutError as error:
                remedy = "check plugs, cable and ground"
                findings.append(fail(label, f"answers only sometimes: {error}", remedy))
            except DeviceError as error:
                remedy = "correct the model or the id, or set the servo up"
                findings.append(fail(label, str(error), remedy))
    if unknown_ids:
        remedy = "disconnect what is not in the robot file, or correct the ids there"
        findings.append(warn("other servos", f"{_describe_ids(unknown_ids)} also on the line", remedy))
    return findings


def _ping_all(line: ServoLine, port: SerialPort) -> PingResult:
    """Ping all, then each servo of the robot file, because some firmware answers only single pings."""
    port.read_all()
    request = line.dialect.ping_all()
    reader, answers = line.dialect.packet_reader(request), Counter[int]()
    port.write(request)
    deadline_s = line.clock.now_s() + line.ping_all_s
    while line.clock.now_s() < deadline_s:
        answers.update(packet.servo_id for packet in reader.feed(port.wait(deadline_s)))
    single = line.ping_each(RegisterAccess(line.dialect, port, line.clock))
    return PingResult(answers | single.answers, single.damaged)  # the larger number of each


def _silence_finding(settings: ServoBusSettings[Any], line: ServoLine, answers: Counter[int]) -> Finding:
    """Describe that no servo answers, and look for other ids and other baud rates."""
    if answers:
        value = f"{_describe_ids(line.ids)} silent; found on the line: {_describe_ids(sorted(answers))}"
        return fail("servos", value, "correct the ids in the robot file or in the servos")
    for baud_rate in get_args(type(settings).model_fields["baud_rate"].annotation):
        answering_ids = _ids_answering_at(line, baud_rate) if baud_rate != settings.baud_rate else []
        if answering_ids:
            value = (
                f"silent at {settings.baud_rate} bit/s; answering at {baud_rate} bit/s: "
                f"{_describe_ids(answering_ids)}"
            )
            return fail("servos", value, f"set baud_rate: {baud_rate}, or change it in the servos")
    return fail("servos", "no servo answers at any baud rate", "check power supply, cable and adapter")


def _ids_answering_at(line: ServoLine, baud_rate: int) -> list[int]:
    line.port.close()
    port = SerialPort(line.port.path, baud_rate, line.clock)
    try:
        port.open()
        return sorted(+_ping_all(line, port).answers)
    except DeviceError:  # the adapter does not support this rate
        return []
    finally:
        port.close()
        line.port.open()


def _describe_ids(ids: Sequence[int]) -> str:
    return f"id{'s' if len(ids) > 1 else ''} {_join_ids(ids)}"
