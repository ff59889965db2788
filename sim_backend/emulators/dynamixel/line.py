"""What servos of a line answer to instructions of Dynamixel Protocol 2.0."""

from collections.abc import Sequence
from typing import Any

from robot_io.files.file_model import FileModel, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.dynamixel import wire
from sim_backend.emulators.dynamixel.control_table import GOALS, Error
from sim_backend.emulators.dynamixel.servo import EmulatedServo, Mounting
from sim_backend.emulators.faults import FaultKind, Faults
from sim_backend.emulators.plant import Plant
from sim_backend.emulators.servo_wire import REBOOT_S, Answer, LineServo, ServoWire, on_shafts
from sim_backend.emulators.wiring import WireMaker, WireRequest

_PING, _READ, _WRITE, _REBOOT = 0x01, 0x02, 0x03, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A


class DynamixelLine(ServoWire):
    """Servos of one line, see `ServoWire`.

    Each turns the joint at its place in the list, with its second one.
    """

    _status = staticmethod(wire.status)

    def __init__(
        self,
        mountings: Sequence[Mounting],
        plant: Plant,
        faults: Faults | None = None,
        *,
        baud_rate: int | None = 4_000_000,
        start_s: float = 0.0,
    ) -> None:
        self.servos = {
            mounting.id: EmulatedServo(mounting, shaft, start_s)
            for mounting, shaft in on_shafts(mountings, plant)
        }
        super().__init__(self.servos, faults, baud_rate, start_s)
        self._receiver = wire.Receiver()

    def _hear(self, data: bytes, now_s: float) -> None:
        for instruction in self._receiver.take(data):
            self._obey(instruction, now_s)

    def _obey(self, instruction: wire.Instruction, now_s: float) -> None:
        awake = {servo_id: servo for servo_id, servo in self.servos.items() if servo.is_awake(now_s)}
        for servo in awake.values():
            servo.hear(now_s)
        self._quiet_s = now_s + self._byte_s * instruction.wire_bytes
        if not instruction.intact:
            target = awake.get(instruction.target)
            if target is not None:
                self._answer([Answer(target, error=Error.CRC)], now_s)
            return
        if instruction.target == wire.BROADCAST:
            self._obey_all(instruction, awake, now_s)
        elif instruction.target in awake:
            servo = awake[instruction.target]
            answer = self._obey_one(instruction, servo, now_s)
            if answer:
                self._answer([answer], now_s)

    def _obey_one(self, instruction: wire.Instruction, servo: EmulatedServo, now_s: float) -> Answer | None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            return Answer(servo, servo.ping())
        if code == _READ and len(parameters) == 4:
            return self._read(servo, parameters) if servo.return_level else None
        error = Error.INSTRUCTION
        if code == _WRITE and len(parameters) > 2:
            error = servo.write(_word(parameters), parameters[2:])
        elif code == _REBOOT:
            error = Error.NONE
        answer = Answer(servo, error=error) if servo.return_level == 2 else None
        if code == _REBOOT:
            servo.reboot(now_s, REBOOT_S)
        return answer

    @staticmethod
    def _read(servo: EmulatedServo, parameters: bytes) -> Answer:
        found = servo.read(_word(parameters), _word(parameters[2:]))
        return Answer(servo, error=found) if isinstance(found, Error) else Answer(servo, found)

    def _obey_all(self, instruction: wire.Instruction, awake: dict[int, EmulatedServo], now_s: float) -> None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            self._answer((Answer(servo, servo.ping()) for servo in awake.values()), now_s)
        elif code == _SYNC_WRITE and len(parameters) > 4:
            step = 1 + _word(parameters[2:])
            for start in range(4, len(parameters) - step + 1, step):
                servo = awake.get(parameters[start])
                if servo is not None and not (servo.deaf and _word(parameters) in GOALS):
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
                servo.reboot(now_s, REBOOT_S)

    def _answer_fast(self, answers: Sequence[Answer | None], size: int, now_s: float) -> None:
        """All in one packet; it ends before the first servo that is silent."""
        parts: list[tuple[int, int, bytes]] = []
        speaking: list[LineServo] = []
        for answer in answers:
            if answer is None or self.faults.strikes(FaultKind.DROP, answer.servo.id, now_s):
                break
            data = answer.data.ljust(size, b"\0")
            parts.append((self._said_id(answer.servo.id, now_s), answer.error | answer.servo.alert, data))
            speaking.append(answer.servo)
        if parts:
            packet = wire.fast_status(self._swapped(parts, now_s), len(answers))
            self._outgoing.append(self._transmit(speaking, packet, now_s))

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

    name = "dynamixel_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        line = DynamixelLine(
            own.servos, request.plant, request.faults, baud_rate=own.baud_rate, start_s=request.start_s
        )
        return line, {"port": line.path}
