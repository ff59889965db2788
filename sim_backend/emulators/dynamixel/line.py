"""An emulated line of servos at the end of a pseudo terminal, with the time that bytes take, and faults."""

import errno
import os
import pty
import tty
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any, ClassVar

from robot_io.files.file_model import FileModel, validate
from sim_backend.emulators.bench import EmulatedWire, heard_at
from sim_backend.emulators.dynamixel import wire
from sim_backend.emulators.dynamixel.control_table import Error
from sim_backend.emulators.dynamixel.servo import EmulatedServo, Mounting
from sim_backend.emulators.faults import Fault, FaultKind, Faults
from sim_backend.emulators.plant import Plant
from sim_backend.emulators.wiring import WireMaker, WireRequest

_PING, _READ, _WRITE, _REBOOT = 0x01, 0x02, 0x03, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A
_REBOOT_S = 0.3  # how long a servo is away, unless a fault says otherwise


@dataclass(frozen=True)
class _Answer:
    """What one servo wants to say: its error byte and its data."""

    servo: EmulatedServo
    error: int
    data: bytes


@dataclass(frozen=True)
class _Frame:
    """Bytes for the wire, from whom, and when the last of them is out."""

    device: int
    data: bytes
    due_s: float


class DynamixelLine(EmulatedWire):
    """Servos on one half-duplex line. `path` is the port for the driver.

    Args:
        mountings: the servos; each turns the joint at its place in the list.
        plant: the arm.
        faults: what goes wrong; devices are called by their ids.
        baud_rate: for the time on the wire [bit/s]; None: bytes take no time.
        start_s: when the servos get power [s].

    Attributes:
        path: device file of the port.
        servos: the servos by id.
        faults: may be added to at any time.
    """

    def __init__(
        self,
        mountings: Sequence[Mounting],
        plant: Plant,
        faults: Faults | None = None,
        *,
        baud_rate: int | None = 4_000_000,
        start_s: float = 0.0,
    ) -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self.servos = {
            mounting.id: EmulatedServo(mounting, plant, joint, start_s)
            for joint, mounting in enumerate(mountings)
        }
        self.faults = faults or Faults(start_s=start_s)
        self._baud_rate = baud_rate
        self._byte_s = 10.0 / baud_rate if baud_rate else 0.0
        self._receiver = wire.Receiver()
        self._outgoing: list[_Frame] = []
        self._in_use = False
        self._quiet_s = start_s  # when the line is free again

    def fileno(self) -> int:
        """See `EmulatedWire.fileno`; a port that nobody has opened would always be readable."""
        return self._master if self._in_use else -1

    def next_due_s(self) -> float:
        return min((frame.due_s for frame in self._outgoing), default=inf)

    def receive(self, now_s: float) -> None:
        for servo in self.servos.values():
            self._befall(servo, now_s)
            servo.watch(now_s)
        if self.faults.strikes(FaultKind.UNPLUG, "line", now_s):
            self.close()
        for instruction in self._receiver.take(self._incoming()):
            self._obey(instruction, now_s)

    def send(self, now_s: float) -> None:
        due = [frame for frame in self._outgoing if frame.due_s <= now_s]
        if due and self._master >= 0:
            self._outgoing = [frame for frame in self._outgoing if frame.due_s > now_s]
            for frame in sorted(due, key=lambda frame: frame.due_s):
                os.write(self._master, frame.data)

    def close(self) -> None:
        """See `EmulatedWire.close`; for the driver, the cable is pulled."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
        self._outgoing = []

    def _incoming(self) -> bytes:
        try:
            data = os.read(self._master, 4096) if self._master >= 0 else b""
        except BlockingIOError:
            data = b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._in_use = False  # nobody has opened the port
            return b""
        self._in_use = True
        return data if data and heard_at(self._master, self._baud_rate) else b""

    def _befall(self, servo: EmulatedServo, now_s: float) -> None:
        """What happens to a servo itself."""
        strikes = self.faults.strikes
        if strikes(FaultKind.ALERT, servo.id, now_s):
            servo.fail()
        reboot = strikes(FaultKind.REBOOT, servo.id, now_s)
        if reboot:
            servo.reboot(now_s, reboot.delay_s or _REBOOT_S)
        servo.stuck = strikes(FaultKind.STUCK, servo.id, now_s) is not None

    def _obey(self, instruction: wire.Instruction, now_s: float) -> None:
        awake = {servo_id: servo for servo_id, servo in self.servos.items() if servo.is_awake(now_s)}
        for servo in awake.values():
            servo.hear(now_s)
        self._quiet_s = now_s + self._byte_s * instruction.wire_bytes
        if not instruction.intact:
            target = awake.get(instruction.target)
            if target is not None:
                self._answer([_Answer(target, Error.CRC, b"")], now_s)
            return
        if instruction.target == wire.BROADCAST:
            self._obey_all(instruction, awake, now_s)
        elif instruction.target in awake:
            servo = awake[instruction.target]
            answer = self._obey_one(instruction, servo, now_s)
            if answer:
                self._answer([answer], now_s)

    def _obey_one(self, instruction: wire.Instruction, servo: EmulatedServo, now_s: float) -> _Answer | None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            return _Answer(servo, Error.NONE, servo.ping())
        if code == _READ and len(parameters) == 4:
            return self._read(servo, parameters) if servo.answers_reading else None
        error = Error.INSTRUCTION
        if code == _WRITE and len(parameters) > 2:
            error = servo.write(_word(parameters), parameters[2:])
        elif code == _REBOOT:
            error = Error.NONE
        answer = _Answer(servo, error, b"") if servo.answers_everything else None
        if code == _REBOOT:
            servo.reboot(now_s, _REBOOT_S)
        return answer

    @staticmethod
    def _read(servo: EmulatedServo, parameters: bytes) -> _Answer:
        found = servo.read(_word(parameters), _word(parameters[2:]))
        return _Answer(servo, found, b"") if isinstance(found, Error) else _Answer(servo, Error.NONE, found)

    def _obey_all(self, instruction: wire.Instruction, awake: dict[int, EmulatedServo], now_s: float) -> None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            everybody = [_Answer(servo, Error.NONE, servo.ping()) for servo in awake.values()]
            self._answer(everybody, now_s)
        elif code == _SYNC_WRITE and len(parameters) > 4:
            step = 1 + _word(parameters[2:])
            for start in range(4, len(parameters) - step + 1, step):
                servo = awake.get(parameters[start])
                if servo is not None:
                    servo.write(_word(parameters), parameters[start + 1 : start + step])
        elif code in (_SYNC_READ, _FAST_SYNC_READ) and len(parameters) > 4:
            asked = parameters[4:]
            answers = [self._read(awake[i], parameters) if i in awake else None for i in asked]
            if code == _SYNC_READ:
                self._answer([answer for answer in answers if answer], now_s)
            else:
                self._answer_fast(answers, _word(parameters[2:]), now_s)
        elif code == _REBOOT:
            for servo in awake.values():
                servo.reboot(now_s, _REBOOT_S)

    def _answer(self, answers: Sequence[_Answer], now_s: float) -> None:
        """One packet each, in turn, as the faults let them."""
        frames = []
        for answer in answers:
            servo = answer.servo
            said_id = self._said_id(servo.id, now_s)
            packet = wire.status(said_id, answer.error | servo.alert, answer.data)
            if not self.faults.strikes(FaultKind.DROP, servo.id, now_s):
                frames.append(self._transmit([servo], packet, now_s))
        self._outgoing += self._misordered(frames, now_s)

    def _answer_fast(self, answers: Sequence[_Answer | None], size: int, now_s: float) -> None:
        """All in one packet; it ends before the first servo that is silent."""
        parts: list[tuple[int, int, bytes]] = []
        speaking: list[EmulatedServo] = []
        for answer in answers:
            if answer is None or self.faults.strikes(FaultKind.DROP, answer.servo.id, now_s):
                break
            data = answer.data.ljust(size, b"\0")
            parts.append((self._said_id(answer.servo.id, now_s), answer.error | answer.servo.alert, data))
            speaking.append(answer.servo)
        if parts:
            packet = wire.fast_status(self._swapped(parts, now_s), len(answers))
            self._outgoing.append(self._transmit(speaking, packet, now_s))

    def _transmit(self, speaking: Sequence[EmulatedServo], packet: bytes, now_s: float) -> _Frame:
        """Put what some servos say on the line, after what is on it already."""

        def strikes(kind: FaultKind) -> list[Fault]:
            found = (self.faults.strikes(kind, servo.id, now_s) for servo in speaking)
            return [fault for fault in found if fault]

        if strikes(FaultKind.CORRUPT):
            packet = self.faults.flip_a_bit(packet)
        if strikes(FaultKind.LOSE):
            packet = self.faults.lose_a_byte(packet)
        if strikes(FaultKind.DUPLICATE):
            packet += packet
        self._quiet_s = max(self._quiet_s, now_s) + speaking[0].return_delay_s
        self._quiet_s += self._byte_s * len(packet)
        late_s = max((fault.delay_s for fault in strikes(FaultKind.DELAY)), default=0.0)
        return _Frame(speaking[0].id, packet, self._quiet_s + late_s)

    def _said_id(self, servo_id: int, now_s: float) -> int:
        wrong = self.faults.strikes(FaultKind.WRONG_ID, servo_id, now_s)
        return (servo_id + 100) % 253 if wrong else servo_id

    def _misordered(self, frames: list[_Frame], now_s: float) -> list[_Frame]:
        for k in range(len(frames) - 1):
            if self.faults.strikes(FaultKind.REORDER, frames[k].device, now_s):
                first, second = frames[k], frames[k + 1]
                frames[k] = replace(second, due_s=first.due_s)
                frames[k + 1] = replace(first, due_s=second.due_s)
        return frames

    def _swapped(self, parts: list[tuple[int, int, bytes]], now_s: float) -> list[tuple[int, int, bytes]]:
        for k in range(len(parts) - 1):
            if self.faults.strikes(FaultKind.REORDER, parts[k][0], now_s):
                parts[k], parts[k + 1] = parts[k + 1], parts[k]
        return parts


def _word(data: bytes) -> int:
    return data[0] + 256 * data[1]


class _Settings(FileModel, extra="ignore"):
    servos: tuple[Mounting, ...]
    baud_rate: int = 4_000_000


class DynamixelWires(WireMaker):
    """Servos that are set up as the robot file says, on a pseudo terminal."""

    name: ClassVar[str] = "dynamixel_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        line = DynamixelLine(
            own.servos, request.plant, request.faults, baud_rate=own.baud_rate, start_s=request.start_s
        )
        return line, {"port": line.path}
