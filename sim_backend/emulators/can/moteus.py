"""A moteus controller as its documentation describes it: registers, written and read in CAN FD frames.

Written from mjbots' docs/protocol/can.md and registers.md: subframes of four number types, numbers that are
scaled where they are integers and no value where they are the most negative one; position mode, faults that
stay until a stop, and a watchdog that comes with each command and ends in mode 11. As the robot file wants
it, `servo.timeout_mode` is 0: it lets go then.
"""

import math
import struct
from typing import Any

import can

from robot_io.files.file_model import FileModel, Number, Positive, validate
from sim_backend.emulators.bench import EmulatedWire
from sim_backend.emulators.can.wire import CanNode, CanWire, open_virtual_bus
from sim_backend.emulators.faults import Fault, FaultKind
from sim_backend.emulators.plant import JointState, Plant
from sim_backend.emulators.wiring import WireMaker, WireRequest

STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11
HOT = 38
_FORMATS = ("b", "<h", "<i", "<f")
_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)  # that a CAN FD frame can have, from 8 on
_KP_NM_REV, _KD_NMS_REV = 4.0, 0.05  # as delivered

# What one step of a register is as int8, int16 and int32; 1 for those that are not here.
_STEPS = {
    **dict.fromkeys((0x01, 0x20), (0.01, 1e-4, 1e-5)),
    **dict.fromkeys((0x02, 0x21), (0.1, 2.5e-4, 1e-5)),
    **dict.fromkeys((0x03, 0x22), (0.5, 0.01, 1e-3)),
    **dict.fromkeys((0x23, 0x24, 0x2B), (1 / 127, 1 / 32767, 1 / 2147483647)),
    0x0D: (0.5, 0.1, 1e-3),
    0x27: (0.01, 1e-3, 1e-6),
}
_DEFAULTS = {0x20: 0.0, 0x21: 0.0, 0x22: 0.0, 0x23: 1.0, 0x24: 1.0, 0x27: 0.0, 0x2B: 1.0}


class EmulatedMoteus(CanNode):
    """One controller.

    Args:
        number: its id.
        joint: which joint of the plant it moves, from 0.
        plant: the arm.
        gear_ratio: turns of its output for one turn of the joint, negative if it is reversed.
        zero_rad: joint angle where its output is at zero [rad].
        max_torque_nm: what its current limit allows at the output [N m].

    Attributes:
        known: whether it knows its position.
    """

    known = True

    def __init__(
        self,
        number: int,
        joint: int,
        plant: Plant,
        *,
        gear_ratio: float = 1.0,
        zero_rad: float = 0.0,
        max_torque_nm: float = math.inf,
    ) -> None:
        self.number, self._max_torque_nm = number, max_torque_nm
        self._joint, self._plant, self._gear_ratio, self._zero_rad = joint, plant, gear_ratio, zero_rad
        self._silent_until_s = self._heard_s = -math.inf
        self._stuck: JointState | None = None
        self.mode, self.fault, self.home = STOPPED, 0, 2
        self._command = dict(_DEFAULTS)

    def hear(self, message: can.Message, now_s: float) -> list[can.Message]:
        number = message.arbitration_id
        if not message.is_fd or number & 0x7F != self.number or now_s < self._silent_until_s:
            return []
        written: dict[int, float] = {}
        answer = self._read_subframes(bytes(message.data), written)
        if 0x00 in written:
            self._obey(round(written[0x00]), written, now_s)
        if not number & 0x8000:
            return []
        size = next((length for length in _LENGTHS if length >= len(answer)), 64)
        reply_id = self.number << 8 | number >> 8 & 0x7F
        return [
            can.Message(
                arbitration_id=reply_id,
                is_extended_id=reply_id > 0x7FF,
                is_fd=True,
                bitrate_switch=message.bitrate_switch,
                data=answer.ljust(size, b"\x50"),
            )
        ]

    def _read_subframes(self, data: bytes, written: dict[int, float]) -> bytes:
        """Keep what is written, and return what is answered."""
        place, answer = 0, b""
        while place < len(data):
            what = data[place]
            place += 1
            if what == 0x50:
                continue
            kind, form, count = what & 0xF0, what >> 2 & 3, what & 3
            if not count:
                count, place = data[place], place + 1
            start, place = data[place], place + 1
            if kind == 0x10:
                reply = 0x20 | form << 2
                answer += bytes((reply | count, start) if count < 4 else (reply, count, start))
                answer += b"".join(self._packed(start + one, form) for one in range(count))
                continue
            for register in range(start, start + count):
                (raw,) = struct.unpack_from(_FORMATS[form], data, place)
                place += struct.calcsize(_FORMATS[form])
                no_value = form < 3 and raw == -(1 << 8 * (1 << form) - 1)
                step = 1.0 if form == 3 else _STEPS.get(register, (1.0, 1.0, 1.0))[form]
                written[register] = math.nan if no_value else raw * step
        return answer

    def _packed(self, register: int, form: int) -> bytes:
        value = self._value(register)
        if form == 3:
            return struct.pack("<f", value)
        largest = (1 << 8 * (1 << form) - 1) - 1
        steps = round(value / _STEPS.get(register, (1.0, 1.0, 1.0))[form])
        return struct.pack(_FORMATS[form], min(max(steps, -largest), largest))

    def _value(self, register: int) -> float:
        motion = self._stuck or self._plant.joint(self._joint)
        torque_nm = self._plant.joint(self._joint).torque_nm / self._gear_ratio
        return {
            0x00: self.mode,
            0x01: self._output_rev(motion) if self.known else math.nan,
            0x02: motion.velocity_rad_s * self._gear_ratio / math.tau,
            0x03: torque_nm,
            0x0C: self.home,
            0x0D: 24.0,
            0x0E: 31.0,
            0x0F: self.fault,
        }.get(register, 0.0)

    def _output_rev(self, joint: JointState) -> float:
        return (joint.position_rad - self._zero_rad) * self._gear_ratio / math.tau

    def _obey(self, mode: int, written: dict[int, float], now_s: float) -> None:
        if mode == STOPPED:
            self.mode, self.fault = STOPPED, 0
        elif mode == POSITION and self.mode in (STOPPED, POSITION):
            self.mode, self._heard_s = POSITION, now_s
            self._command = _DEFAULTS | written
        self._drive()

    def _drive(self) -> None:
        torque_nm = 0.0
        if self.mode == POSITION:
            joint, command = self._plant.joint(self._joint), self._command
            error_rev = command[0x20] - self._output_rev(joint)
            error_rev_s = command[0x21] - joint.velocity_rad_s * self._gear_ratio / math.tau
            torque_nm = command[0x22] + command[0x24] * _KD_NMS_REV * error_rev_s
            torque_nm += 0.0 if math.isnan(error_rev) else command[0x23] * _KP_NM_REV * error_rev
        limit_nm = self._max_torque_nm
        is_cut = self.mode == POSITION and abs(torque_nm) > limit_nm
        self.fault = self.fault if self.mode == FAULT else 99 * is_cut
        self._plant.set_torque(self._joint, min(max(torque_nm, -limit_nm), limit_nm) * self._gear_ratio)

    def tell(self, now_s: float) -> list[can.Message]:
        """See `CanNode.tell`: nothing unasked, but here its watchdog runs."""
        watchdog_s = self._command[0x27] or 0.1
        if self.mode == POSITION and now_s - self._heard_s > watchdog_s:
            self.mode = TIMEOUT
            self._drive()
        return []

    def strike(self, fault: Fault, now_s: float) -> None:
        if fault.kind is FaultKind.ALERT:
            self.mode, self.fault = FAULT, HOT
        elif fault.kind is FaultKind.STUCK:
            self._stuck = self._stuck or self._plant.joint(self._joint)
        elif fault.kind is FaultKind.REBOOT:
            self.mode, self.fault, self._silent_until_s = STOPPED, 0, now_s + fault.delay_s
        self._drive()


class _Motor(FileModel, extra="ignore"):
    motor_id: int
    gear_ratio: Positive = 1.0
    reversed: bool = False
    zero_rad: Number = 0.0
    max_torque_nm: Positive


class _Settings(FileModel, extra="ignore"):
    motors: tuple[_Motor, ...]


class MoteusWires(WireMaker):
    """Controllers that are set up as the robot file says."""

    name = "moteus_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        own = validate(_Settings, request.section.settings)
        nodes = [
            EmulatedMoteus(
                motor.motor_id,
                joint,
                request.plant,
                gear_ratio=-motor.gear_ratio if motor.reversed else motor.gear_ratio,
                zero_rad=motor.zero_rad,
                max_torque_nm=motor.max_torque_nm,
            )
            for joint, motor in enumerate(own.motors)
        ]
        bus, reach = open_virtual_bus(in_lock_step=request.in_lock_step)
        return CanWire(bus, nodes, request.faults), reach
