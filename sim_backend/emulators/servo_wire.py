"""A half-duplex line of servos at the end of a pseudo terminal, with the time that bytes take, and faults."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from operator import attrgetter
from typing import Any, Generic, NamedTuple, TypeVar

from palpate.robot_io.drivers.servo.joints import ServoMounting
from palpate.sim_backend.emulators.faults import Fault, FaultKind, Faults
from palpate.sim_backend.emulators.hardware import EmulatedWire, JointState, Plant, PseudoTerminal, Shaft

BROADCAST = 0xFE
REBOOT_S = 0.3  # default duration of a servo's absence
_SLIP_RAD = 0.1  # slip angle of a horn
_HELD = JointState(0.0, 0.0, 0.0)  # state of a servo that turns nothing


class LineServo(ABC):
    """One servo of a line, powered from a time [s] on; without a shaft it only holds its position.

    Attributes:
        stuck: whether its position sensor has frozen.
        deaf: whether it heeds no goals.
        heard_s: time of the last instruction on the line, to any servo; it feeds the watchdog [s].
    """

    def __init__(self, mounting: ServoMounting, shaft: Shaft | None, now_s: float) -> None:
        self.id, self.shaft = mounting.id, shaft
        self._zero_rad, self._direction = mounting.zero_rad, -1 if mounting.reversed else 1
        self.awake_s = self.heard_s = now_s
        self.stuck = self.deaf = False
        self._frozen: JointState | None = None

    def _measured(self) -> JointState | None:
        """Return angle from position 0 and rate in its own direction, and torque; None before a sample."""
        state = self.shaft.state() if self.shaft else _HELD
        if not isfinite(state.position_rad):
            return None
        self._frozen = (self._frozen or state) if self.stuck else None
        seen = self._frozen or state
        speed_rad_s = 0.0 if self.stuck else seen.velocity_rad_s
        angle_rad = self._direction * (seen.position_rad - self._zero_rad)
        return JointState(angle_rad, self._direction * speed_rad_s, state.torque_nm)

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

    @abstractmethod
    def fail(self) -> None:
        """Raise a device error."""

    @abstractmethod
    def reboot(self, now_s: float, downtime_s: float) -> None:
        """Lose power for `downtime_s` [s].

        Args:
            now_s: emulator's clock [s].
            downtime_s: duration without power [s].
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


class ServoReply(NamedTuple):
    """Answer of one servo."""

    servo: LineServo
    data: bytes = b""
    error: int = 0


@dataclass(frozen=True)
class ServoFrame:
    """Bytes for the wire, their sender, and the time at which the last one has been sent."""

    device: int
    data: bytes
    due_s: float


class ServoWire(EmulatedWire, Generic[ServoType]):
    """Servos on one line.

    Args:
        mountings: servo of each joint, from base to tip, with its second one.
        plant: the arm.
        faults: faults of the line and its servos, which are named by their ids; None for none so far.
        hold: servos that turn nothing.
        baud_rate: determines the time on the wire [bit/s]; with None, bytes take no time.
        start_s: time from which the servos have power, emulator's clock [s].

    Attributes:
        servos: the servos by id.
        path: device file for the driver.
        faults: the faults; more can be added at any time.
        echoes: whether the adapter receives its own bytes, as some do.
    """

    echoes = False

    def __init__(
        self,
        mountings: Sequence[ServoMounting],
        plant: Plant,
        faults: Faults | None = None,
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
        self._pending = bytearray()  # received bytes that were not parsed yet
        self._port = PseudoTerminal(baud_rate, kept_open=False)
        self.path = self._port.path
        self.faults = faults or Faults(start_s=start_s)
        self._byte_s = 10.0 / baud_rate if baud_rate else 0.0
        self._outgoing: list[ServoFrame] = []
        self._had_faults = False  # whether faults were planned in the last step
        self._free_s = start_s  # when the line is free again
        self._due_s = start_s  # when the last answer arrives, which none behind it overtakes

    @staticmethod
    @abstractmethod
    def _servo(mounting: Any, shaft: Any, now_s: float) -> Any:  # noqa: ANN401, of each maker
        """Make a servo on a shaft, or on None, that gets power now."""

    @staticmethod
    @abstractmethod
    def _parse(pending: bytearray) -> ServoInstruction | None:
        """Remove and return the next complete instruction; None if none is complete."""

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
        return self._port.fileno()

    def next_due_s(self) -> float:
        return min((frame.due_s for frame in self._outgoing), default=inf)

    def receive(self, now_s: float) -> None:
        planned = self.faults.planned
        for servo in self.servos.values():
            if planned or self._had_faults:  # once more after the last, to release stuck devices
                self._apply_faults(servo, now_s)
            servo.watch(now_s)
        self._had_faults = planned
        if self.faults.trigger(FaultKind.UNPLUG, "line", now_s):
            self.close()
        data = self._port.read()
        if self.echoes and data:
            self._outgoing.append(ServoFrame(0, data, now_s))
        self._pending += data
        while (instruction := self._parse(self._pending)) is not None:
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
        if due:
            self._outgoing = [frame for frame in self._outgoing if frame.due_s > now_s]
            self._port.write(b"".join(frame.data for frame in sorted(due, key=attrgetter("due_s"))))

    def close(self) -> None:
        """See `EmulatedWire.close`; the driver sees an unplugged cable."""
        self._port.close()
        self._outgoing = []

    def _apply_faults(self, servo: LineServo, now_s: float) -> None:
        """Apply the faults of a servo itself."""

        def trigger(kind: FaultKind) -> bool:
            return self.faults.trigger(kind, servo.id, now_s) is not None

        if trigger(FaultKind.ALERT):
            servo.fail()
        if reboot := self.faults.trigger(FaultKind.REBOOT, servo.id, now_s):
            servo.reboot(now_s, reboot.delay_s or REBOOT_S)
        servo.stuck, servo.deaf = trigger(FaultKind.STUCK), trigger(FaultKind.DEAF)
        if shaft := servo.shaft:
            shaft.limp, shaft.backwards = trigger(FaultKind.LIMP), trigger(FaultKind.REVERSED)
            shaft.slipped_rad = _SLIP_RAD if trigger(FaultKind.SLIPPED) else 0.0

    def _answer(self, answers: Iterable[ServoReply], now_s: float) -> None:
        """Send one packet per answer, in order, subject to the faults."""
        frames = []
        for servo, data, error in answers:
            packet = self._status(self._sent_id(servo.id, now_s), error | servo.alert, data)
            if not self.faults.trigger(FaultKind.DROP, servo.id, now_s):
                frames.append(self._transmit([servo], packet, now_s))
        for k in range(len(frames) - 1):
            if self.faults.trigger(FaultKind.REORDER, frames[k].device, now_s):
                first, second = frames[k], frames[k + 1]
                frames[k] = replace(second, due_s=first.due_s)
                frames[k + 1] = replace(first, due_s=second.due_s)
        self._outgoing += frames

    def _transmit(self, senders: Sequence[LineServo], packet: bytes, now_s: float) -> ServoFrame:
        """Append answers of servos to the line."""

        def trigger(kind: FaultKind) -> list[Fault]:
            faults = (self.faults.trigger(kind, servo.id, now_s) for servo in senders)
            return [fault for fault in faults if fault]

        if trigger(FaultKind.CORRUPT):
            packet = self.faults.flip_a_bit(packet)
        if trigger(FaultKind.LOSE):
            packet = self.faults.lose_a_byte(packet)
        if trigger(FaultKind.DUPLICATE):
            packet += packet
        self._free_s = max(self._free_s, now_s) + senders[0].return_delay_s
        self._free_s += self._byte_s * len(packet)
        late_s = max((fault.delay_s for fault in trigger(FaultKind.DELAY)), default=0.0)
        self._due_s = max(self._due_s, self._free_s + late_s)
        return ServoFrame(senders[0].id, packet, self._due_s)

    def _sent_id(self, servo_id: int, now_s: float) -> int:
        wrong = self.faults.trigger(FaultKind.WRONG_ID, servo_id, now_s)
        return (servo_id + 100) % 253 if wrong else servo_id
