"""Faults of emulated wires: what is planned, and its effect on devices and on the frames that they send.

`install_faults` turns a wire of `sim_backend.emulators` into one with faults.
"""

import struct
from abc import abstractmethod
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from enum import StrEnum
from math import inf
from typing import Annotated, Any

import can
import numpy as np
from pydantic import Field

from palpate.robot_io.clock import Clock
from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive
from palpate.robot_io.robot_file import RobotFile
from palpate.sim_backend.emulators import dynamixel_servo, feetech
from palpate.sim_backend.emulators.can_line import CanWire, EmulatedMotor
from palpate.sim_backend.emulators.dynamixel import EmulatedDynamixelLine, fast_status
from palpate.sim_backend.emulators.hardware import EmulatedWire
from palpate.sim_backend.emulators.mit import EmulatedDamiao, EmulatedMitMotor, EmulatedRobstride
from palpate.sim_backend.emulators.moteus import FAULT, STOPPED, EmulatedMoteus
from palpate.sim_backend.emulators.net_ft import EmulatedNetFt, EmulatedNetFtLine
from palpate.sim_backend.emulators.odrive import ALERT_BIT, EmulatedOdrive
from palpate.sim_backend.emulators.serial_line import PtyLine, SensorWire, SerialSensor
from palpate.sim_backend.emulators.serial_sensors import (
    EmulatedBota,
    EmulatedCell,
    EmulatedLoadstar,
    EmulatedLorenz,
    EmulatedMark10,
)
from palpate.sim_backend.emulators.servo_wire import REBOOT_S, LineServo, ServoFrame, ServoReply, ServoWire
from palpate.sim_backend.emulators.wiring import WiredArm, wire_up
from palpate.sim_backend.hooks import NO_EFFECTS, HiddenEffects
from palpate.sim_backend.scenario import Scenario


class FaultKind(StrEnum):
    """Kind of fault. An emulator supports the kinds that its wire and its devices can have."""

    DROP = "drop"  # a frame of the device is not sent
    DELAY = "delay"  # a frame is sent `delay_s` late
    CORRUPT = "corrupt"  # one bit of a frame is flipped after its checksum was computed
    LOSE = "lose"  # one byte of a frame is lost; not on CAN, where such a frame is rejected
    DUPLICATE = "duplicate"  # a frame is sent twice
    REORDER = "reorder"  # a frame is swapped with the next one
    WRONG_ID = "wrong_id"  # a frame carries another device's id
    ALERT = "alert"  # the device reports an error
    REBOOT = "reboot"  # the device restarts with its power-up settings, silent for `delay_s`
    UNPLUG = "unplug"  # the port or interface is gone
    STUCK = "stuck"  # the sensor's value is frozen
    NOT_A_NUMBER = "not_a_number"  # the sensor sends a value that is not a number
    SATURATED = "saturated"  # the sensor sends the end of its range
    REVERSED = "reversed"  # the sensor's sign is wrong, or the motor's
    LIMP = "limp"  # the motor exerts no torque, but otherwise works
    DEAF = "deaf"  # a servo ignores new goals and keeps its last one
    SLIPPED = "slipped"  # the motor's horn slips on its joint, by 0.1 rad


class Fault(FileModel):
    """One fault; a test scenario is a list of faults."""

    kind: FaultKind  # kind of fault
    # Device, by its name or number in the emulator; None for every device.
    device: str | int | None = None
    from_s: NotNegative = 0.0  # start, after the start of the emulator [s]
    for_s: Positive | None = None  # duration [s]; None for no end
    # Largest number of occurrences; None for no limit.
    times: Annotated[int, Field(gt=0, strict=True)] | None = None
    # Probability at each opportunity, from 0 to 1.
    probability: Annotated[Number, Field(gt=0, le=1)] = 1.0
    delay_s: NotNegative = 0.0  # delay, or duration of absence, for the kinds that need it [s]


class Faults:
    """Decides at each opportunity whether a fault occurs; equal seeds give equal faults.

    The emulator started at `start_s` on its own clock [s]. `generator` draws the details, such as which bit
    is flipped.
    """

    def __init__(self, faults: Iterable[Fault] = (), *, seed: int = 0, start_s: float = 0.0) -> None:
        self._planned: defaultdict[FaultKind, list[Fault]] = defaultdict(list)
        self._occurrences: Counter[tuple[FaultKind, int]] = Counter()  # by kind and index in its list
        self._start_s = start_s
        self.add(*faults)
        self.generator = np.random.default_rng(seed)

    @property
    def planned(self) -> bool:
        """Whether any fault is planned, now or later."""
        return bool(self._planned)

    def add(self, *faults: Fault) -> None:
        """Plan further faults, even while the emulator runs."""
        for fault in faults:
            self._planned[fault.kind].append(fault)

    def clear(self) -> None:
        """Remove all faults."""
        self._planned.clear()
        self._occurrences.clear()

    def trigger(self, kind: FaultKind, device: str | int, now_s: float) -> Fault | None:
        """Draw whether a fault of this kind occurs in a device now; each call is one opportunity.

        Args:
            kind: kind of fault.
            device: name or number of the device in its emulator.
            now_s: emulator's clock [s].
        """
        for index, fault in enumerate(self._planned.get(kind, ())):
            if (
                fault.device in (None, device)
                and 0.0 <= now_s - self._start_s - fault.from_s < (fault.for_s or inf)
                and self._occurrences[kind, index] < (fault.times or inf)
                and (fault.probability == 1.0 or self.generator.random() < fault.probability)
            ):
                self._occurrences[kind, index] += 1
                return fault
        return None

    def lose_a_byte(self, frame: bytes) -> bytes:
        """Remove one byte of a frame, drawn at random.

        Args:
            frame: at least one byte.
        """
        index = int(self.generator.integers(len(frame)))
        return frame[:index] + frame[index + 1 :]

    def flip_a_bit(self, frame: bytes, first: int = 0) -> bytes:
        """Flip one bit of a frame, drawn at random.

        Args:
            frame: bytes.
            first: index of the first byte in which a bit may change.
        """
        changed = bytearray(frame)
        index = int(self.generator.integers(first, len(frame)))
        changed[index] ^= 1 << int(self.generator.integers(8))
        return bytes(changed)


class FaultyFrames(EmulatedWire):
    """Mixin for a wire whose frames may be dropped, late, damaged, doubled or reordered.

    Attributes:
        faults: what goes wrong; more can be added at any time.
        stalls: whether a late frame holds back all frames behind it, which then arrive together, as on a
            serial line that stalls. Otherwise later frames overtake it.
    """

    faults: Faults
    stalls = False

    def begin(self) -> None:
        """Start without faulty frames."""
        self._late: list[tuple[float, Any]] = []
        self._held_back: dict[str | int, Any] = {}
        self._silent_until_s: dict[Any, float] = {}

    @abstractmethod
    def _damaged(self, device: str | int, frame: Any, now_s: float) -> Any:
        """Return a device's frame after the faults that change it."""

    def _deliver_one(self, device: str | int, frame: Any, now_s: float) -> None:
        """Send a device's frame, subject to the faults."""
        trigger = self.faults.trigger
        if trigger(FaultKind.DROP, device, now_s):
            return
        frame = self._damaged(device, frame, now_s)
        if trigger(FaultKind.REORDER, device, now_s) and device not in self._held_back:
            self._held_back[device] = frame
            return
        if self.stalls and self._late:
            self._late.append((self._late[-1][0], frame))
            return
        if delay := trigger(FaultKind.DELAY, device, now_s):
            self._late.append((now_s + delay.delay_s, frame))
            return
        self._put(frame, now_s)
        if trigger(FaultKind.DUPLICATE, device, now_s):
            self._put(frame, now_s)
        if device in self._held_back:
            self._put(self._held_back.pop(device), now_s)

    def _deliver_late(self, now_s: float) -> None:
        """Send frames that were delayed until now."""
        if not self._late:
            return
        due = [frame for due_s, frame in self._late if due_s <= now_s]
        self._late = [late for late in self._late if late[0] > now_s]
        for frame in due:
            self._put(frame, now_s)

    def _is_silent(self, device: Any, now_s: float) -> bool:
        """Return whether a device is still starting after a reboot."""
        return now_s < self._silent_until_s.get(device, -inf)


_BUS_OFF_ERROR_FRAME = 0x040  # linux/can/error.h: CAN_ERR_BUSOFF
_STRANGER = 0x7E5  # an id that none of the nodes has
_HOT_MIT, _HOT_DAMIAO, HOT_MOTEUS = 6, 11, 38  # errors: over temperature
_HOT_STATE, _HOT_FAULT = 1 << 2, 1 << 0  # the same of Robstride, in a state and in a fault frame


class FaultyCanWire(FaultyFrames, CanWire):
    """A CAN bus with faults of its nodes and their frames; unplugged, it goes off with an error frame."""

    def begin(self) -> None:
        super().begin()
        self._unplugged = False
        self._reports: list[tuple[EmulatedMotor, can.Message]] = []

    def receive(self, now_s: float) -> None:
        while (message := self._bus.recv(timeout=0.0)) is not None:
            if self._unplugged or message.is_error_frame:
                continue
            for node in self._nodes:
                if not self._is_silent(node, now_s):
                    self._deliver(node, node.receive(message, now_s), now_s)

    def send(self, now_s: float) -> None:
        unplugged = self.faults.trigger(FaultKind.UNPLUG, "bus", now_s) is not None
        if unplugged and not self._unplugged:
            bus_off = can.Message(arbitration_id=_BUS_OFF_ERROR_FRAME, is_error_frame=True, data=bytes(8))
            self._put(bus_off, now_s)
        self._unplugged = unplugged
        if unplugged:
            for node in self._nodes:
                node.send_unrequested(now_s)  # discarded; the watchdog runs regardless
            return
        self._deliver_late(now_s)
        for node in self._nodes:
            for kind in (FaultKind.ALERT, FaultKind.REBOOT, FaultKind.STUCK):
                if fault := self.faults.trigger(kind, node.number, now_s):
                    self._strike(node, fault, now_s)
            reports = [report for reporter, report in self._reports if reporter is node]
            self._reports = [pair for pair in self._reports if pair[0] is not node]
            is_silent = isinstance(node, EmulatedOdrive) and self._is_silent(node, now_s)
            unrequested = [] if is_silent else node.send_unrequested(now_s)
            self._deliver(node, [*reports, *unrequested], now_s)

    def report_faults(self, motor: EmulatedRobstride, bits: int) -> None:
        """Let a motor of Robstride report fault bits without a request."""
        self._reports.append((motor, motor._message(21, motor.number, struct.pack("<II", bits, 0))))

    def _strike(self, motor: EmulatedMotor, fault: Fault, now_s: float) -> None:
        """Apply a fault of a motor itself: an error, a restart, or an encoder that is stuck from now on."""
        if fault.kind is FaultKind.REBOOT:
            self._silent_until_s[motor] = now_s + fault.delay_s
            if isinstance(motor, EmulatedMoteus):
                motor.mode, motor.fault = STOPPED, 0
            else:
                motor._start_up()
        elif fault.kind is FaultKind.STUCK:
            if not isinstance(motor, _StuckMotor):
                motor.frozen = motor.shaft
                motor.__class__ = type("Stuck", (_StuckMotor, type(motor)), {})
        elif isinstance(motor, EmulatedMoteus):
            motor.mode, motor.fault = FAULT, HOT_MOTEUS
        elif isinstance(motor, EmulatedOdrive):
            motor._disarm(ALERT_BIT[motor._firmware])
        elif isinstance(motor, EmulatedDamiao):
            motor.error, motor.enabled = _HOT_DAMIAO, False
        elif isinstance(motor, EmulatedRobstride):
            motor.error, motor.enabled = _HOT_STATE, False
            self.report_faults(motor, _HOT_FAULT)
        elif isinstance(motor, EmulatedMitMotor):
            motor.error = _HOT_MIT
        motor._drive()

    def _deliver(self, node: EmulatedMotor, frames: Iterable[can.Message], now_s: float) -> None:
        for frame in frames:
            self._deliver_one(node.number, frame, now_s)

    def _damaged(self, device: str | int, frame: can.Message, now_s: float) -> can.Message:
        """CAN's own CRC catches flipped bits, so a damaged frame is shortened."""
        if self.faults.trigger(FaultKind.CORRUPT, device, now_s):
            frame.data = frame.data[:3]
            frame.dlc = 3
        if self.faults.trigger(FaultKind.WRONG_ID, device, now_s):
            if frame.is_extended_id:  # the id contains the sender
                frame.arbitration_id = frame.arbitration_id & ~0xFF00 | 0xFE00
            else:
                frame.arbitration_id = _STRANGER
                frame.data = bytearray([0xFE, *frame.data[1:]])
        return frame


class _StuckMotor:
    """Mixin for a motor whose encoder is stuck; its torque is still measured."""

    @property
    def shaft(self):
        return self.frozen._replace(torque_nm=super().shaft.torque_nm)


class FaultySensorWire(FaultyFrames, SensorWire):
    """Mixin for a line whose force sensor and readings have faults."""

    def begin(self) -> None:
        super().begin()
        self._stuck_n: float | None = None

    def send(self, now_s: float) -> None:
        trigger, sensor = self.faults.trigger, self._sensor
        if trigger(FaultKind.UNPLUG, sensor.name, now_s):
            self.close()
        if reboot := trigger(FaultKind.REBOOT, sensor.name, now_s):
            self._silent_until_s[sensor] = now_s + reboot.delay_s
            power_up(sensor, now_s)
        self._deliver_late(now_s)
        if not self._is_silent(sensor, now_s) and sensor.due(now_s):
            reading = sensor.reading(sensor.sign * self._faulty_force_n(now_s))
            self._deliver_one(sensor.name, reading, now_s)

    def _faulty_force_n(self, now_s: float) -> float:
        trigger, name = self.faults.trigger, self._sensor.name
        force_n = self._plant.force[0] if self._plant.force else float("nan")
        if trigger(FaultKind.STUCK, name, now_s):
            self._stuck_n = force_n if self._stuck_n is None else self._stuck_n
            return self._stuck_n
        self._stuck_n = None
        if trigger(FaultKind.NOT_A_NUMBER, name, now_s):
            return float("nan")
        force_n = self._force_n()
        force_n = -force_n if trigger(FaultKind.REVERSED, name, now_s) else force_n
        return self._sensor.range_n if trigger(FaultKind.SATURATED, name, now_s) else force_n

    def _corrupted(self, data: bytes) -> bytes:
        return self.faults.flip_a_bit(data)

    def _damaged(self, device: str | int, frame: bytes, now_s: float) -> bytes:
        if self.faults.trigger(FaultKind.CORRUPT, device, now_s):
            frame = self._corrupted(frame)
        if self.faults.trigger(FaultKind.LOSE, device, now_s):
            frame = self.faults.lose_a_byte(frame)
        return frame


class FaultyPtyLine(FaultySensorWire, PtyLine):
    """A pseudo terminal with faults of its sensor."""

    def receive(self, now_s: float) -> None:
        if not (self._late or self._is_silent(self._sensor, now_s)):
            super().receive(now_s)
            return
        answers: list[bytes] = []
        put, receive = self._put, self._sensor.receive
        self._put = lambda answer, _: answers.append(answer)
        if self._is_silent(self._sensor, now_s):
            self._sensor.receive = lambda *_: b""
        super().receive(now_s)
        self._put, self._sensor.receive = put, receive
        for answer in filter(None, answers):  # nothing overtakes on a line
            self._late.append((max((due_s for due_s, _ in self._late), default=now_s), answer))


class FaultyNetFtLine(FaultySensorWire, EmulatedNetFtLine):
    """A network with faults of its sensor; UDP's checksum lets no flipped bit through, so a byte is lost."""

    def _corrupted(self, data: bytes) -> bytes:
        return self.faults.lose_a_byte(data)


def power_up(sensor: SerialSensor, now_s: float) -> None:
    """Reset the host's settings of a force sensor to those of power-up.

    Args:
        sensor: the sensor.
        now_s: emulator's clock [s].
    """
    match sensor:
        case EmulatedLoadstar():
            sensor._timer.stop()
            sensor._tare_n, sensor._input = 0.0, b""
        case EmulatedLorenz():
            sensor._timer.stop()
            sensor._input = b""
        case EmulatedMark10():
            sensor._input, sensor._due_s = b"", inf
        case EmulatedCell():  # streams again without a request
            sensor._counter = 0
        case EmulatedBota():  # streams again with its stored settings
            sensor._length, sensor._time_us = 512, 0.0
            sensor._run(now_s)
        case EmulatedNetFt():  # sends nothing until the host requests it again
            sensor._timer.stop()


class ServoFaults:
    """Faults of one servo itself, as they are in this step.

    Attributes:
        saved: values that a Feetech servo keeps without power: those below address 40 that were written
            while the lock was 0.
    """

    saved = b""

    def __init__(self) -> None:
        self.stuck = self.deaf = False
        self.frozen: Any = None
        self.limp = self.backwards = False
        self.slipped_rad = 0.0


def spoil(servo: LineServo) -> ServoFaults:
    """Let a servo and its shaft obey the faults that are returned.

    Args:
        servo: servo of a line.
    """
    faults, measured, shaft, write = ServoFaults(), servo._measured, servo.shaft, servo.write
    if isinstance(servo, feetech.EmulatedSts):
        faults.saved = bytes(servo._memory[:EPROM_END])
    goals = dynamixel_servo.GOALS if isinstance(servo, dynamixel_servo.EmulatedServo) else (42,)

    def measure():
        if not faults.stuck:
            faults.frozen = None
            return measured()
        now = measured()
        faults.frozen = faults.frozen or now
        return now and faults.frozen._replace(velocity_rad_s=0.0, torque_nm=now.torque_nm)

    def obey(address: int, data: bytes):
        answer = None if faults.deaf and address in goals else write(address, data)
        if isinstance(servo, feetech.EmulatedSts) and address < EPROM_END and not servo.get(55, 1):
            faults.saved = bytes(servo._memory[:EPROM_END])
        return answer

    servo._measured, servo.write = measure, obey
    if shaft is not None:
        exert, state = shaft.exert, shaft.state
        shaft.exert = lambda nm: exert(0.0 if faults.limp else -nm if faults.backwards else nm)

        def slipped():
            now = state()
            return (
                now._replace(position_rad=now.position_rad + faults.slipped_rad)
                if faults.slipped_rad
                else now
            )

        shaft.state = slipped
    return faults


def fail(servo: LineServo) -> None:
    """Raise an overload error in a servo, with its consequences.

    Args:
        servo: servo of a line.
    """
    if isinstance(servo, feetech.EmulatedSts):
        servo.error |= feetech.OVERLOAD
        return
    memory, register = servo.memory, dynamixel_servo.HARDWARE_ERROR
    memory.put(register, memory.get(register) | OVERLOAD)
    if servo._shut_down:
        memory.put(dynamixel_servo.TORQUE_ENABLE, 0)
        servo._exert()


OVERLOAD = 0x20
EPROM_END = 40  # of a Feetech servo's addresses
SLIP_RAD = 0.1  # slip angle of a horn


def reboot(servo: LineServo, saved: bytes, now_s: float, downtime_s: float) -> None:
    """Let a servo lose power for a time.

    Args:
        servo: servo of a line.
        saved: see `ServoFaults`.
        now_s: emulator's clock [s].
        downtime_s: duration without power [s].
    """
    if not isinstance(servo, feetech.EmulatedSts):
        servo.reboot(now_s, downtime_s)
        return
    for address, size, value in feetech._TABLE:
        servo.put(address, value, size)
    servo._memory[:EPROM_END] = saved
    servo.put(48, servo.get(16))
    servo.error = 0
    servo.awake_s = now_s + downtime_s
    servo._sample_position()
    servo._drive()


class FaultyServoWire(ServoWire):
    """Mixin for a line with faults of its servos, which are named by their ids, and of their packets.

    Attributes:
        of_servos: faults of the servos themselves by id, as they are in this step.
    """

    faults: Faults

    def begin(self) -> None:
        """Start without faults of the servos."""
        self._had_faults = False  # whether faults were planned in the last step
        self.of_servos = {servo_id: spoil(servo) for servo_id, servo in self.servos.items()}

    def receive(self, now_s: float) -> None:
        planned = self.faults.planned
        if planned or self._had_faults:  # once more after the last, to release stuck devices
            for servo in self.servos.values():
                self._apply_faults(servo, now_s)
        self._had_faults = planned
        if self.faults.trigger(FaultKind.UNPLUG, "line", now_s):
            self.close()
        super().receive(now_s)

    def _apply_faults(self, servo: LineServo, now_s: float) -> None:
        def trigger(kind: FaultKind) -> bool:
            return self.faults.trigger(kind, servo.id, now_s) is not None

        if trigger(FaultKind.ALERT):
            fail(servo)
        if restart := self.faults.trigger(FaultKind.REBOOT, servo.id, now_s):
            self.reboot(servo, now_s, restart.delay_s or REBOOT_S)
        own = self.of_servos[servo.id]
        before = own.stuck, own.limp, own.backwards
        own.stuck, own.deaf = trigger(FaultKind.STUCK), trigger(FaultKind.DEAF)
        if servo.shaft:
            own.limp, own.backwards = trigger(FaultKind.LIMP), trigger(FaultKind.REVERSED)
            own.slipped_rad = SLIP_RAD if trigger(FaultKind.SLIPPED) else 0.0
        if before != (own.stuck, own.limp, own.backwards) and isinstance(servo, feetech.EmulatedSts):
            servo._watched = ()  # its control runs again

    def reboot(self, servo: LineServo, now_s: float, downtime_s: float) -> None:
        """See `reboot`."""
        reboot(servo, self.of_servos[servo.id].saved, now_s, downtime_s)

    def _answer(self, answers: Iterable[ServoReply], now_s: float) -> None:
        frames, senders = [], []
        for servo, data, error in answers:
            packet = self._status(self._sent_id(servo.id, now_s), error | servo.alert, data)
            if not self.faults.trigger(FaultKind.DROP, servo.id, now_s):
                frames.append(self._transmit_from([servo], packet, now_s))
                senders.append(servo.id)
        for k in range(len(frames) - 1):
            if self.faults.trigger(FaultKind.REORDER, senders[k], now_s):
                first, second = frames[k], frames[k + 1]
                frames[k] = ServoFrame(second.data, first.due_s)
                frames[k + 1] = ServoFrame(first.data, second.due_s)
                senders[k], senders[k + 1] = senders[k + 1], senders[k]
        self._outgoing += frames

    def _answer_fast(self, answers, size: int, now_s: float) -> None:
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
            self._outgoing.append(self._transmit_from(senders, fast_status(parts, len(answers)), now_s))

    def _transmit_from(self, senders: list[LineServo], packet: bytes, now_s: float) -> ServoFrame:
        def trigger(kind: FaultKind) -> list[Fault]:
            faults = (self.faults.trigger(kind, servo.id, now_s) for servo in senders)
            return [fault for fault in faults if fault]

        if trigger(FaultKind.CORRUPT):
            packet = self.faults.flip_a_bit(packet)
        if trigger(FaultKind.LOSE):
            packet = self.faults.lose_a_byte(packet)
        if trigger(FaultKind.DUPLICATE):
            packet += packet
        frame = self._transmit(senders[0], packet, now_s)
        late_s = max((fault.delay_s for fault in trigger(FaultKind.DELAY)), default=0.0)
        return ServoFrame(frame.data, frame.due_s + late_s)

    def _sent_id(self, servo_id: int, now_s: float) -> int:
        wrong = self.faults.trigger(FaultKind.WRONG_ID, servo_id, now_s)
        return (servo_id + 100) % 253 if wrong else servo_id


class FaultyDynamixelLine(FaultyServoWire, EmulatedDynamixelLine):
    """A line of Dynamixel servos with faults."""


class FaultyFeetechLine(FaultyServoWire, feetech.EmulatedFeetechLine):
    """A line of Feetech servos with faults."""


_FAULTY = {
    CanWire: FaultyCanWire,
    PtyLine: FaultyPtyLine,
    EmulatedNetFtLine: FaultyNetFtLine,
    EmulatedDynamixelLine: FaultyDynamixelLine,
    feetech.EmulatedFeetechLine: FaultyFeetechLine,
}


def install_faults(wire: EmulatedWire, faults: Faults | None = None) -> None:
    """Let faults occur on a wire; none are planned yet without `faults`.

    Args:
        wire: wire of any kind, before the driver opens it.
        faults: faults of the wire and its devices.
    """
    wire.__class__ = _FAULTY[type(wire)]
    wire.faults = faults or Faults()
    wire.begin()


def wire_up_with_faults(
    robot_file: RobotFile,
    scenario: Scenario,
    clock: Clock,
    faults: Mapping[str, Faults],
    effects: HiddenEffects = NO_EFFECTS,
) -> WiredArm:
    """Emulate every bus of a robot, with faults by bus name; see `wire_up`."""
    start_s = clock.now_s()
    arm = wire_up(robot_file, scenario, clock, effects)
    for bus, wire in arm.wires.items():
        install_faults(wire, faults.get(bus) or Faults(start_s=start_s))
    return arm
