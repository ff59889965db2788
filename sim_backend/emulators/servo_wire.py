"""A half-duplex line of servos at the end of a pseudo terminal, with the time that bytes take."""

import errno
import os
import pty
import select
import tty
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from operator import attrgetter
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from palpate.robot_io.drivers.servo.joints import ServoMounting
from palpate.sim_backend.emulators.hardware import EmulatedWire, JointState, Plant, Shaft, baud_rate_matches

BROADCAST = 0xFE
REBOOT_S = 0.3  # default duration of a servo's absence
_HELD = JointState(0.0, 0.0, 0.0)  # state of a servo that turns nothing


class LineServo(ABC):
    """One servo of a line, powered from a time [s] on; without a shaft it only holds its position.

    Attributes:
        heard_s: time of the last instruction on the line, to any servo; it feeds the watchdog [s].
    """

    def __init__(self, mounting: ServoMounting, shaft: Shaft | None, now_s: float) -> None:
        self.id, self.shaft = mounting.id, shaft
        self._zero_rad, self._direction = mounting.zero_rad, -1 if mounting.reversed else 1
        self.awake_s = self.heard_s = now_s

    def _measured(self) -> JointState | None:
        """Return the readings of its own sensors at its horn, with the joint's torque.

        Returns:
            Angle from its position 0 [rad] and speed [rad/s] along its own direction, and torque [N m]; None
            before the plant's first sample.
        """
        state = self.shaft.state() if self.shaft else _HELD
        if not isfinite(state.position_rad):
            return None
        angle_rad = self._direction * (state.position_rad - self._zero_rad)
        return JointState(angle_rad, self._direction * state.velocity_rad_s, state.torque_nm)

    @property
    @abstractmethod
    def alert(self) -> int:
        """Error bits that all its answers carry."""

    @property
    @abstractmethod
    def return_delay_s(self) -> float:
        """Delay from the end of an instruction to the start of its answer [s]."""

    @abstractmethod
    def watch(self, now_s: float) -> None:
        """Advance the servo by one step.

        Args:
            now_s: emulator's clock [s].
        """


ServoType = TypeVar("ServoType", bound=LineServo)


@dataclass(frozen=True)
class ServoInstruction:
    """An instruction packet as a servo has understood it."""

    target: int  # id of the servo, or `BROADCAST`
    code: int  # what to do
    parameters: bytes  # with what, stuffing removed
    wire_bytes: int  # bytes that it took on the wire
    intact: bool = True  # whether the checksum was right


class InstructionParser(ABC):
    """Parses instructions from received bytes."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def take(self, data: bytes) -> Iterator[ServoInstruction]:
        """Yield the instructions that are complete now.

        Args:
            data: received bytes.
        """
        self._pending += data
        while (instruction := self._next()) is not None:
            yield instruction

    @abstractmethod
    def _next(self) -> ServoInstruction | None:
        """Remove and return the next complete instruction; None if none is complete."""


class ServoReply(NamedTuple):
    """Answer of one servo."""

    servo: LineServo
    data: bytes = b""
    error: int = 0


@dataclass(frozen=True)
class ServoFrame:
    """Bytes for the wire, and the time at which the last one has been sent."""

    data: bytes
    due_s: float


class ServoWire(EmulatedWire, Generic[ServoType]):
    """Servos on one line.

    Args:
        mountings: servo of each joint, from base to tip, with its second one.
        plant: the arm.
        hold: servos that turn nothing.
        baud_rate: determines the time on the wire [bit/s]; with None, bytes take no time.
        start_s: time from which the servos have power, emulator's clock [s].

    Attributes:
        servos: the servos by id.
        path: device file for the driver.
        echoes: whether the adapter receives its own bytes, as some do.
    """

    echoes = False
    parser: ClassVar[type[InstructionParser]]

    def __init__(
        self,
        mountings: Sequence[ServoMounting],
        plant: Plant,
        *,
        hold: Sequence[ServoMounting] = (),
        baud_rate: int | None,
        start_s: float = 0.0,
    ) -> None:
        placed: list[tuple[ServoMounting, Shaft | None]] = []
        for joint, mounting in enumerate(mountings):
            shaft = Shaft(plant, joint)
            placed.append((mounting, shaft))
            if mounting.second:
                shaft.beside = Shaft(plant, joint)
                shaft.beside.beside = shaft
                placed.append((mounting.second, shaft.beside))
        placed += [(mounting, None) for mounting in hold]
        self.servos: dict[int, ServoType] = {
            mounting.id: self._servo(mounting, shaft, start_s) for mounting, shaft in placed
        }
        self._receiver = self.parser()
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        self._baud_rate = baud_rate
        self._byte_s = 10.0 / baud_rate if baud_rate else 0.0
        self._outgoing: list[ServoFrame] = []
        self._in_use = False  # whether the driver has opened the port
        self._free_s = start_s  # when the line is free again

    @staticmethod
    @abstractmethod
    def _servo(mounting: Any, shaft: Any, now_s: float) -> Any:  # noqa: ANN401, of each maker
        """Make a servo on a shaft, or on None, that gets power now."""

    @abstractmethod
    def _execute(self, instruction: ServoInstruction, servo: ServoType, now_s: float) -> ServoReply | None:
        """Execute an instruction to one servo; return its answer, or None."""

    @abstractmethod
    def _execute_broadcast(
        self, instruction: ServoInstruction, awake: dict[int, ServoType], now_s: float
    ) -> None:
        """Let all servos in `awake` (by id) execute an instruction and answer."""

    @staticmethod
    @abstractmethod
    def _status(servo_id: int, error: int, data: bytes) -> bytes:
        """Return the packet of an answer."""

    def fileno(self) -> int:
        """See `EmulatedWire.fileno`; a port that is not open would always be readable."""
        return self._master if self._in_use else -1

    def next_due_s(self) -> float:
        return min((frame.due_s for frame in self._outgoing), default=inf)

    def receive(self, now_s: float) -> None:
        for servo in self.servos.values():
            servo.watch(now_s)
        data = self._incoming()
        if self.echoes and data:
            self._outgoing.append(ServoFrame(data, now_s))
        for instruction in self._receiver.take(data):
            awake = {servo_id: servo for servo_id, servo in self.servos.items() if now_s >= servo.awake_s}
            for servo in awake.values():
                servo.heard_s = now_s
            self._free_s = now_s + self._byte_s * instruction.wire_bytes
            if instruction.target in awake:
                if answer := self._execute(instruction, awake[instruction.target], now_s):
                    self._answer([answer], now_s)
            elif instruction.target == BROADCAST and instruction.intact:
                self._execute_broadcast(instruction, awake, now_s)

    def send(self, now_s: float) -> None:
        due = [frame for frame in self._outgoing if frame.due_s <= now_s]
        if due and self._master >= 0:
            self._outgoing = [frame for frame in self._outgoing if frame.due_s > now_s]
            os.write(self._master, b"".join(frame.data for frame in sorted(due, key=attrgetter("due_s"))))

    def close(self) -> None:
        """See `EmulatedWire.close`; the driver sees an unplugged cable."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        self._outgoing = []

    def _incoming(self) -> bytes:
        if self._master >= 0 and not self._poll.poll(0):  # faster than a read that fails
            self._in_use = True
            return b""
        try:
            data = os.read(self._master, 4096) if self._master >= 0 else b""
        except BlockingIOError:
            data = b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._in_use = False  # the port is not open
            return b""
        self._in_use = True
        return data if data and baud_rate_matches(self._master, self._baud_rate) else b""

    def _answer(self, answers: Iterable[ServoReply], now_s: float) -> None:
        """Send one packet per answer, in order."""
        for servo, data, error in answers:
            packet = self._status(servo.id, error | servo.alert, data)
            self._outgoing.append(self._transmit(servo, packet, now_s))

    def _transmit(self, first: LineServo, packet: bytes, now_s: float) -> ServoFrame:
        """Return a packet behind all that the line is to send, after the return delay of its first servo."""
        self._free_s = max(self._free_s, now_s) + first.return_delay_s + self._byte_s * len(packet)
        return ServoFrame(packet, self._free_s)
