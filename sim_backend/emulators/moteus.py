"""A moteus controller as its documentation describes it: registers, written and read in CAN FD frames.

Written from mjbots' docs/protocol/can.md and registers.md: subframes of four number types, integers are
scaled, and the most negative one means no value; position mode; faults that persist until a stop; and a
watchdog that each command sets and that ends in mode 11. As the robot file requires, `servo.timeout_mode` is
0: the torque is then off.
"""

import math
import struct
from typing import Any

import can

from palpate.robot_io.drivers.moteus import MoteusBusSettings, MoteusMotor
from palpate.sim_backend.emulators.can_line import EmulatedMotor, make_can_wire
from palpate.sim_backend.emulators.hardware import EmulatedWire, Plant
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest

STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11
HOT, _CUT = 38, 99  # over temperature; cut by servo.max_current_A
_FORMATS = ("b", "<h", "<i", "<f")
_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)  # that a CAN FD frame can have, from 8 on
_KP_NM_REV, _KD_NMS_REV = 4.0, 0.05  # as delivered

# Size of one step of a register as int8, int16 and int32; 1 for other registers.
_STEPS = {
    **dict.fromkeys((0x01, 0x20), (0.01, 1e-4, 1e-5)),
    **dict.fromkeys((0x02, 0x21), (0.1, 2.5e-4, 1e-5)),
    **dict.fromkeys((0x03, 0x22), (0.5, 0.01, 1e-3)),
    **dict.fromkeys((0x23, 0x24, 0x2B), (1 / 127, 1 / 32767, 1 / 2147483647)),
    0x0D: (0.5, 0.1, 1e-3),
    0x27: (0.01, 1e-3, 1e-6),
}
_DEFAULTS = {0x20: 0.0, 0x21: 0.0, 0x22: 0.0, 0x23: 1.0, 0x24: 1.0, 0x27: 0.0, 0x2B: 1.0}


class EmulatedMoteus(EmulatedMotor):
    """One controller, see `EmulatedMotor`; its current limit allows `max_torque_nm` at the output.

    `known` is whether it knows its position.
    """

    known = True

    def __init__(self, motor: MoteusMotor, joint: int, plant: Plant) -> None:
        super().__init__(motor.motor_id, joint, plant, motor)
        self._max_torque_nm = motor.max_torque_nm
        self.mode, self.fault, self.home = STOPPED, 0, 2
        self._command = dict(_DEFAULTS)

    def _process(self, message: can.Message, now_s: float) -> list[can.Message]:
        number = message.arbitration_id
        if not message.is_fd or number & 0x7F != self.number:
            return []
        written: dict[int, float] = {}  # values by register
        data, place, answer = bytes(message.data), 0, b""
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
                head = 0x20 | form << 2
                answer += bytes((head | count, start) if count < 4 else (head, count, start))
                answer += b"".join(self._packed(start + offset, form) for offset in range(count))
                continue
            for register in range(start, start + count):
                (raw,) = struct.unpack_from(_FORMATS[form], data, place)
                place += struct.calcsize(_FORMATS[form])
                no_value = form < 3 and raw == -(1 << 8 * (1 << form) - 1)
                step = 1.0 if form == 3 else _STEPS.get(register, (1.0, 1.0, 1.0))[form]
                written[register] = math.nan if no_value else raw * step
        if 0x00 in written:
            mode = round(written[0x00])
            if mode == STOPPED:
                self.mode, self.fault = STOPPED, 0
            elif mode == POSITION and self.mode in (STOPPED, POSITION):
                self.mode, self._heard_s = POSITION, now_s
                self._command = _DEFAULTS | written
            self._drive()
        if not number & 0x8000:
            return []
        size = next((length for length in _LENGTHS if length >= len(answer)), 64)
        reply_id = self.number << 8 | number >> 8 & 0x7F
        reply = can.Message(
            arbitration_id=reply_id,
            is_extended_id=reply_id > 0x7FF,
            is_fd=True,
            bitrate_switch=message.bitrate_switch,
            data=answer.ljust(size, b"\x50"),
        )
        return [reply]

    def _packed(self, register: int, form: int) -> bytes:
        measured = self.measured
        value = {
            0x00: self.mode,
            0x01: measured.position_rad / math.tau if self.known else math.nan,
            0x02: measured.velocity_rad_s / math.tau,
            0x03: measured.torque_nm,
            0x0C: self.home,
            0x0D: 24.0,
            0x0E: 31.0,
            0x0F: self.fault,
        }.get(register, 0.0)
        if form == 3:
            return struct.pack("<f", value)
        largest = (1 << 8 * (1 << form) - 1) - 1
        steps = round(value / _STEPS.get(register, (1.0, 1.0, 1.0))[form])
        return struct.pack(_FORMATS[form], min(max(steps, -largest), largest))

    def _drive(self) -> None:
        torque_nm, limit_nm, command = 0.0, self._max_torque_nm, self._command
        if self.mode == POSITION:
            shaft = self.shaft
            error_rev = command[0x20] - shaft.position_rad / math.tau
            error_rev_s = command[0x21] - shaft.velocity_rad_s / math.tau
            torque_nm = command[0x22] + command[0x24] * _KD_NMS_REV * error_rev_s
            torque_nm += 0.0 if math.isnan(error_rev) else command[0x23] * _KP_NM_REV * error_rev
        self.fault = self.fault if self.mode == FAULT else _CUT * (abs(torque_nm) > limit_nm)
        self._exert(min(max(torque_nm, -limit_nm), limit_nm))

    def send_unrequested(self, now_s: float) -> list[can.Message]:
        """See `EmulatedMotor.send_unrequested`; the watchdog came with the last command."""
        watchdog_s = self._command[0x27] or 0.1
        if self.mode == POSITION and now_s - self._heard_s > watchdog_s:
            self.mode = TIMEOUT
            self._drive()
        return []

    def _fail(self) -> None:
        self.mode, self.fault = FAULT, HOT

    def _start_up(self) -> None:
        self.mode, self.fault = STOPPED, 0


class MoteusWires(WireMaker):
    """Controllers configured as in the robot file."""

    name = "moteus_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        motors = request.settings_as(MoteusBusSettings).motors
        nodes = [EmulatedMoteus(motor, joint, request.plant) for joint, motor in enumerate(motors)]
        return make_can_wire(request, nodes)
