"""Registers of one servo, and the protocol to read and write them; each answer is checked and may take ms."""

from dataclasses import dataclass
from typing import Protocol

from palpate.robot_io.clock import Clock
from palpate.robot_io.drivers.servo.stream import ServoDialect
from palpate.robot_io.errors import DeviceError, DeviceTimeoutError, ProtocolError
from palpate.robot_io.serial_port import SerialPort


@dataclass(frozen=True, slots=True)
class Register:
    """One value of a servo."""

    name: str  # as in the manual
    address: int  # of its first byte
    size: int  # bytes
    signed: bool = False  # whether it can be negative, in two's complement
    sign_bit: int | None = None  # the bit that says negative where the others are the magnitude

    def encode(self, value: int) -> bytes:
        """The bytes of a value. ProtocolError: it does not fit.

        Args:
            value: number to write.
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
        """The value of bytes. ProtocolError: not as many bytes as it has.

        Args:
            data: bytes as they were read.
        """
        if len(data) != self.size:
            raise ProtocolError(f"{self.name} came with {len(data)} bytes instead of {self.size}")
        return self.signed_value(int.from_bytes(data, "little", signed=self.signed))

    def signed_value(self, number: int) -> int:
        """The value of a number whose sign bit, if there is one, stands for minus.

        Args:
            number: as it was read, without a sign.
        """
        if self.sign_bit is None:
            return number
        magnitude = number & ((1 << self.sign_bit) - 1)
        return -magnitude if number >> self.sign_bit & 1 else magnitude


class Packet(Protocol):
    """What a servo answers."""

    @property
    def servo_id(self) -> int:
        """Who answers."""

    @property
    def data(self) -> bytes:
        """What it was asked for."""

    @property
    def alert(self) -> bool:
        """Whether the servo has an error of its own."""

    @property
    def refusal(self) -> str | None:
        """Why the instruction was refused, or None if it was not."""


_PATIENCE_S = 0.02  # beyond the time on the wire: USB adapters may hold bytes back for 16 ms
_SECOND_S = 3e-3  # after an answer: a second servo with the same id has answered too by then
_PACKET = 12  # bytes of a packet around its data, at most


class RegisterAccess:
    """Reads and writes registers, by any servo protocol.

    Args:
        dialect: The protocol.
        port: Port of the line; it may be opened later.
        clock: Clock of the deadlines.
    """

    def __init__(self, dialect: ServoDialect, port: SerialPort, clock: Clock) -> None:
        self._dialect, self._port, self._clock = dialect, port, clock
        self._alert = False  # of the last value that was read

    def ping(self, servo_id: int, size: int = 0) -> bytes:
        """Ask a servo who it is.

        Args:
            servo_id: Which servo.
            size: Number of bytes of its answer.

        Raises:
            DeviceTimeoutError: Nobody answers.
            DeviceError: The port failed, or the servo refused.
        """
        packet = self._ask(servo_id, self._dialect.ping(servo_id), size)
        self._check(packet, "ping")
        return packet.data

    def count_answers(self, servo_id: int, size: int = 0) -> tuple[int, int]:
        """Count the answers to one ping, which are two where two servos have the same id.

        Args:
            servo_id: Which servo.
            size: Number of bytes of an answer.

        Returns:
            Number of answers, and of damaged ones: two servos that answer at once spoil each other's.

        Raises:
            DeviceError: The port failed.
        """
        request, answers = self._dialect.ping(servo_id), 0
        self._port.read_all()
        reader = self._dialect.packet_reader(request)
        self._port.write(request)
        deadline_s = self._deadline_s(request, size)
        while self._clock.now_s() < deadline_s:
            packets: list[Packet] = reader.feed(self._port.wait(deadline_s))
            new = sum(packet.servo_id == servo_id and len(packet.data) == size for packet in packets)
            if new and not answers:
                deadline_s = min(deadline_s, self._clock.now_s() + _SECOND_S)
            answers += new
        return answers, reader.rejected

    def read(self, servo_id: int, register: Register) -> int:
        """Read a register.

        Args:
            servo_id: Which servo.
            register: Which of its registers.

        Raises:
            DeviceTimeoutError: No answer.
            DeviceError: The port failed, or the servo refused.
        """
        packet = self._read(servo_id, register)
        self._check(packet, f"reading {register.name}")
        self._alert = packet.alert
        return register.decode(packet.data)

    def write(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register, and wait until the servo says that it has.

        Args:
            servo_id: Which servo.
            register: Which of its registers.
            value: New value, in the servo's unit.

        Raises:
            DeviceTimeoutError: No answer.
            DeviceError: The port failed, or the servo refused, with its hardware error if it has one.
        """
        self.write_bytes(servo_id, register.address, register.encode(value), f"setting {register.name}")

    def write_bytes(self, servo_id: int, address: int, data: bytes, what: str) -> None:
        """Set bytes from `address` on; `what` is for the error. DeviceError: as `write`."""
        packet = self._ask(servo_id, self._dialect.write(servo_id, address, data), 0)
        self._check(packet, what)

    def settle(self, servo_id: int, register: Register, value: int, *, keeps: bool = False) -> None:
        """Set a register, and read it back.

        Args:
            servo_id: Which servo.
            register: Which of its registers.
            value: New value, in the servo's unit.
            keeps: Whether it keeps its value without power, in a memory that wears out with each writing; it
                is then only set if it differs.

        Raises:
            DeviceError: As `write`, or it has another value afterwards.
        """
        if keeps and self.read(servo_id, register) == value:
            return
        self.write(servo_id, register, value)
        self._confirm(servo_id, register, value)

    def settle_unanswered(self, servo_id: int, register: Register, value: int) -> None:
        """Set a register of a servo that may not answer to writing, and read it back; see `settle`."""
        self._port.write(self._dialect.write(servo_id, register.address, register.encode(value)))
        self._confirm(servo_id, register, value)

    def why_alert(self, servo_id: int) -> str:
        """Say what is behind the alert bit of a servo's answers; for the end of a message."""
        return ""

    def _confirm(self, servo_id: int, register: Register, value: int) -> None:
        shown = self.read(servo_id, register)
        if shown != value:
            why = self.why_alert(servo_id) if self._alert else ""
            raise DeviceError(
                f"servo {servo_id}: {register.name} is {shown} after it was set to {value}{why}"
            )

    def _read(self, servo_id: int, register: Register) -> Packet:
        request = self._dialect.read(servo_id, register.address, register.size)
        return self._ask(servo_id, request, register.size)

    def _ask(self, servo_id: int, request: bytes, size: int) -> Packet:
        self._port.read_all()
        reader = self._dialect.packet_reader(request)
        self._port.write(request)
        deadline_s = self._deadline_s(request, size)
        while True:
            packets: list[Packet] = reader.feed(self._port.wait(deadline_s))
            for packet in packets:
                if packet.servo_id == servo_id and (packet.refusal or len(packet.data) == size):
                    return packet
            if self._clock.now_s() >= deadline_s:
                damaged = f" ({reader.rejected} damaged answers)" if reader.rejected else ""
                raise DeviceTimeoutError(f"servo {servo_id}: no answer{damaged}")

    def _deadline_s(self, request: bytes, size: int) -> float:
        return self._clock.now_s() + self._port.duration_s(len(request) + _PACKET + size) + _PATIENCE_S

    def _check(self, packet: Packet, what: str) -> None:
        if not packet.refusal:
            return
        problem = f"servo {packet.servo_id}: {what}: {packet.refusal}"
        if packet.alert:
            problem += self.why_alert(packet.servo_id)
        raise DeviceError(problem)
