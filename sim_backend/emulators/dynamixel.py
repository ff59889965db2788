"""Dynamixel servos of the X series on a pseudo terminal, with the simulated arm behind them.

Written from the ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0" (packet structure, processing order of reception
and transmission, Fast Sync Read) and "CRC Calculation"; it shares no code with the driver but its settings.
"""

from collections.abc import Sequence
from typing import Any

from palpate.robot_io.drivers.dynamixel.tables import DynamixelSettings
from palpate.sim_backend.emulators.dynamixel_servo import GOALS, DynamixelMounting, EmulatedServo, Error
from palpate.sim_backend.emulators.faults import FaultKind
from palpate.sim_backend.emulators.hardware import EmulatedWire
from palpate.sim_backend.emulators.servo_wire import (
    BROADCAST,
    REBOOT_S,
    LineServo,
    ServoInstruction,
    ServoReply,
    ServoWire,
)
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest

STATUS_INSTRUCTION = 0x55
_START = bytes((0xFF, 0xFF, 0xFD))
_STUFFING = 0xFD
_STUFFED = bytes((*_START, _STUFFING))
_TOO_LONG = 0x3FF  # no servo takes more


def checksum(data: bytes) -> int:
    """Compute the CRC-16 of x^16 + x^15 + x^2 + 1, most significant bit first, 0 at the start.

    Args:
        data: bytes that it covers.
    """
    remainder = 0
    for byte in data:
        remainder = (remainder << 8 & 0xFFFF) ^ _QUOTIENTS[remainder >> 8 ^ byte]
    return remainder


_QUOTIENTS = [byte << 8 for byte in range(256)]
for _ in range(8):
    _QUOTIENTS = [(rest << 1) & 0xFFFF ^ 0x8005 * (rest >> 15) for rest in _QUOTIENTS]


def parse_instruction(pending: bytearray) -> ServoInstruction | None:
    """Remove and return the next complete instruction; see `ServoWire._parse`.

    Args:
        pending: received bytes.
    """
    while (begin := pending.find(_START)) >= 0:
        del pending[:begin]
        if len(pending) < 7:
            return None
        length = pending[5] + 256 * pending[6]
        if pending[3] == _STUFFING or not 3 <= length <= _TOO_LONG:
            del pending[:3]  # stuffed data, or noise that looked like a start
            continue
        if len(pending) < 7 + length:
            return None
        packet = bytes(pending[: 7 + length])
        del pending[: 7 + length]
        sent = packet[-2] + 256 * packet[-1]
        body = packet[7:-2].replace(_STUFFED, _START)
        return ServoInstruction(packet[4], body[0], body[1:], len(packet), checksum(packet[:-2]) == sent)
    del pending[: max(0, len(pending) - 2)]
    return None


def status(servo_id: int, error: int, data: bytes = b"") -> bytes:
    """Make a status packet with its checksum.

    Args:
        servo_id: id of the sender.
        error: number, with the alert bit.
        data: parameters.
    """
    body = (bytes((STATUS_INSTRUCTION, error)) + data).replace(_START, _STUFFED)
    length = len(body) + 2
    packet = _START + bytes((0, servo_id, length % 256, length // 256)) + body
    return packet + checksum(packet).to_bytes(2, "little")


def fast_status(parts: Sequence[tuple[int, int, bytes]], requested_count: int) -> bytes:
    """Make the joint answer of servos to a fast sync read.

    The parts are id, error and data of the answering servos. The chain ends at the first silent servo, but
    the header announces the answers of all.

    Args:
        parts: id, error and data of each servo that answers.
        requested_count: number of servos of which the request asks.
    """
    part_size = len(parts[0][2]) + 4
    length = 1 + requested_count * part_size
    packet = _START + bytes((0, BROADCAST, length % 256, length // 256, STATUS_INSTRUCTION))
    for servo_id, error, data in parts:
        packet += bytes((error, servo_id)) + data
        packet += checksum(packet).to_bytes(2, "little")
    return packet


_PING, _READ, _WRITE, _REBOOT = 0x01, 0x02, 0x03, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A


class EmulatedDynamixelLine(ServoWire[EmulatedServo]):
    """Servos of one line, see `ServoWire`."""

    _parse = staticmethod(parse_instruction)
    _servo = staticmethod(EmulatedServo)
    _status = staticmethod(status)

    def _execute(
        self, instruction: ServoInstruction, servo: EmulatedServo, now_s: float
    ) -> ServoReply | None:
        if not instruction.intact:
            return ServoReply(servo, error=Error.CRC)
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            return ServoReply(servo, servo.ping())
        if code == _READ and len(parameters) == 4:
            return self._read(servo, parameters) if servo.return_level else None
        error = Error.INSTRUCTION
        if code == _WRITE and len(parameters) > 2:
            error = servo.write(_word(parameters), parameters[2:])
        elif code == _REBOOT:
            error = Error.NONE
        answer = ServoReply(servo, error=error) if servo.return_level == 2 else None
        if code == _REBOOT:
            servo.reboot(now_s, REBOOT_S)
        return answer

    @staticmethod
    def _read(servo: EmulatedServo, parameters: bytes) -> ServoReply:
        content = servo.read(_word(parameters), _word(parameters[2:]))
        return ServoReply(servo, error=content) if isinstance(content, Error) else ServoReply(servo, content)

    def _execute_broadcast(
        self, instruction: ServoInstruction, awake: dict[int, EmulatedServo], now_s: float
    ) -> None:
        code, parameters = instruction.code, instruction.parameters
        if code == _PING:
            self._answer((ServoReply(servo, servo.ping()) for servo in awake.values()), now_s)
        elif code == _SYNC_WRITE and len(parameters) > 4:
            step = 1 + _word(parameters[2:])
            for start in range(4, len(parameters) - step + 1, step):
                servo, address = awake.get(parameters[start]), _word(parameters)
                if servo is not None and not (servo.deaf and address in GOALS):
                    servo.write(address, parameters[start + 1 : start + step])
        elif code in (_SYNC_READ, _FAST_SYNC_READ) and len(parameters) > 4:
            requested_ids = parameters[4:]
            answers = [self._read(awake[i], parameters) if i in awake else None for i in requested_ids]
            if code == _SYNC_READ:
                self._answer([answer for answer in answers if answer], now_s)
            else:
                self._answer_fast(answers, _word(parameters[2:]), now_s)
        elif code == _REBOOT:
            for servo in awake.values():
                servo.reboot(now_s, REBOOT_S)

    def _answer_fast(self, answers: Sequence[ServoReply | None], size: int, now_s: float) -> None:
        """Send all answers in one packet, which ends before the first silent servo."""
        parts: list[tuple[int, int, bytes]] = []
        senders: list[LineServo] = []
        for answer in answers:
            if answer is None or self.faults.trigger(FaultKind.DROP, answer.servo.id, now_s):
                break
            data = answer.data.ljust(size, b"\0")
            parts.append((self._sent_id(answer.servo.id, now_s), answer.error | answer.servo.alert, data))
            senders.append(answer.servo)
        if parts:
            for k in range(len(parts) - 1):
                if self.faults.trigger(FaultKind.REORDER, parts[k][0], now_s):
                    parts[k], parts[k + 1] = parts[k + 1], parts[k]
            self._outgoing.append(self._transmit(senders, fast_status(parts, len(answers)), now_s))


def _word(data: bytes) -> int:
    return data[0] + 256 * data[1]


class _DynamixelSettings(DynamixelSettings):
    servos: tuple[DynamixelMounting, ...]


class DynamixelWires(WireMaker):
    """Servos configured as in the robot file, on a pseudo terminal."""

    name = "dynamixel_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        settings = request.settings_as(_DynamixelSettings)
        baud_rate, start_s = settings.baud_rate, request.start_s
        line = EmulatedDynamixelLine(
            settings.servos, request.plant, request.faults, baud_rate=baud_rate, start_s=start_s
        )
        return line, {"port": line.path}
