"""Motors in MIT mode as their makers' manuals describe them: CubeMars, Damiao and Robstride.

CubeMars answers the frames to its id. Written from the "AK Series Actuator Driver Manual" V1.0.8, section
5.3, and its float and integer conversions, which truncate instead of rounding. The CAN timeout switches the
torque off when no frame arrives.

Outside motor mode, the protocol's original firmware (bgkatz/motorcontrol) still answers commands, but exerts
no torque. By the manual, the mode comes first, and the frame that enters it requests the state. A motor may
therefore ignore commands until then.

Damiao: MIT frames, a status in its answers, and registers. Written from Damiao's "DM-J4310-2EC user manual":
the status is above the id's four bits (0 off, 1 on, 8 and more errors), the last two bytes are temperatures,
registers are read and written through id 7FF, and a CAN timeout that fires switches the motor off with error
13.

Robstride: frames with 29 bit ids, parameters, and unrequested fault frames. Written from RobStride's "User
Manual" of RS00 to RS06 (2026-04-28), section 4.1: bits 28 to 24 of an id are the frame's type, bits 7 to 0
its receiver. A state (type 2) has, from high to low bits, the mode, six fault bits and the motor's id. Beyond
four turns its position continues at the other end (4.2.3), mechPos does not. A motor that has a fault, or
receives nothing for its canTimeout (3.3.6), goes to reset mode.
"""

import struct
from typing import Any

import can

from palpate.robot_io.drivers.mit.settings import Maker, MitBusSettings, MitMotor
from palpate.sim_backend.emulators.can_line import EmulatedMotor, make_can_wire
from palpate.sim_backend.emulators.hardware import EmulatedWire, Plant
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest

_ALERT = 6  # MOSFET over temperature
_TEMPERATURE = 25
_NO_COMMAND = (0.0, 0.0, 0.0, 0.0, 0.0)  # position, velocity, stiffness, damping, torque


def _to_uint(value: float, limit: float, bits: int) -> int:
    """Encode a clipped number by the manual: (x + limit) (2^bits - 1) / (2 limit), truncated."""
    value = min(max(value, -limit), limit)
    return int((value + limit) * ((1 << bits) - 1) / (2 * limit))


def _to_float(number: int, limit: float, bits: int, low: float | None = None) -> float:
    """Convert an integer of some bits to a value between `low` (None: -limit) and limit."""
    low = -limit if low is None else low
    return number * (limit - low) / ((1 << bits) - 1) + low


class EmulatedMitMotor(EmulatedMotor):
    """One motor, see `EmulatedMotor`.

    Its limits are the ends of the ranges of position [rad], velocity [rad/s] and torque [N m]. `timeout_s` is
    its CAN timeout [s], None for none. If the host requests its state by "enter", it answers only the special
    codes outside motor mode.

    Attributes:
        answer_bytes: length of its answers; bgkatz/motorcontrol sends 7, of which the last is a voltage.
    """

    answer_bytes = 8

    def __init__(self, motor: MitMotor, joint: int, plant: Plant, settings: MitBusSettings) -> None:
        super().__init__(motor.motor_id, joint, plant, motor)
        own = motor.ranges
        limits = (own.position_rad, own.velocity_rad_s, own.torque_nm) if own else _LIMITS[motor.model]
        self._position_limit, self._velocity_limit, self._torque_limit = limits
        self._host_id = self._answer_id(motor, settings.host_id)
        self.timeout_s: float | None = settings.watchdog_s
        self._deaf_when_off = settings.ask_with == "enter"
        self.enabled = False
        self.error = 0
        self._command = _NO_COMMAND
        self._start_up()

    @staticmethod
    def _answer_id(motor: MitMotor, host_id: int | None) -> int:
        """Return the arbitration id of its answers."""
        return host_id or 0

    def _process(self, message: can.Message, now_s: float) -> list[can.Message]:
        for_me = message.arbitration_id == self.number and not message.is_extended_id
        if not for_me or message.is_remote_frame or len(message.data) != 8:
            return []
        data = bytes(message.data)
        is_special = data[:7] == b"\xff" * 7 and data[7] in (0xFC, 0xFD, 0xFE)
        if self._deaf_when_off and not (self.enabled or is_special):
            return []
        self._heard_s = now_s
        if is_special:
            if data[7] != 0xFE:
                self.enabled = data[7] == 0xFC
            self._command = _NO_COMMAND
        else:
            bits = int.from_bytes(data, "big")
            position, velocity, stiffness = bits >> 48, bits >> 36 & 0xFFF, bits >> 24 & 0xFFF
            damping, torque = bits >> 12 & 0xFFF, bits & 0xFFF
            self._command = (
                _to_float(position, self._position_limit, 16),
                _to_float(velocity, self._velocity_limit, 12),
                _to_float(stiffness, 500.0, 12, low=0.0),
                _to_float(damping, 5.0, 12, low=0.0),
                _to_float(torque, self._torque_limit, 12),
            )
        self._drive()
        return [self._reply()]

    def _drive(self) -> None:
        torque_nm = 0.0
        if self.enabled and not self.error:
            position, velocity, stiffness, damping, feed_forward = self._command
            shaft, torque_nm = self.shaft, feed_forward
            if stiffness or damping:
                torque_nm += stiffness * (position - shaft.position_rad)
                torque_nm += damping * (velocity - shaft.velocity_rad_s)
            torque_nm = min(max(torque_nm, -self._torque_limit), self._torque_limit)
        self._exert(torque_nm)

    def send_unrequested(self, now_s: float) -> list[can.Message]:
        """Apply the CAN timeout of the motor; return no frames (see `EmulatedMotor.send_unrequested`)."""
        if self.enabled and self.timeout_s is not None and now_s - self._heard_s > self.timeout_s:
            self._time_out()
            self._drive()
        return []

    def _time_out(self) -> None:
        """Drop the command after its CAN timeout."""
        self._command = _NO_COMMAND

    def _fail(self) -> None:
        self.error = _ALERT

    def _start_up(self) -> None:
        self.enabled = False

    def _reply(self) -> can.Message:
        measured = self.measured
        position = _to_uint(measured.position_rad, self._position_limit, 16)
        velocity = _to_uint(measured.velocity_rad_s, self._velocity_limit, 12)
        torque = _to_uint(measured.torque_nm, self._torque_limit, 12)
        bits = self.number << 56 | position << 40 | velocity << 28 | torque << 16
        data = (bits | _TEMPERATURE << 8 | self.error).to_bytes(8, "big")[: self.answer_bytes]
        return can.Message(arbitration_id=self._host_id, is_extended_id=False, data=data)


# CubeMars "AK Series Actuator Driver Manual" V1.0.8, 5.3: position [rad], speed [rad/s], torque [N m].
CUBEMARS_LIMITS = {
    "AK10-9": (12.5, 50.0, 65.0),
    "AK60-6": (12.5, 45.0, 15.0),
    "AK70-10": (12.5, 50.0, 25.0),
    "AK80-6": (12.5, 76.0, 12.0),
    "AK80-9": (12.5, 50.0, 18.0),
    "AK80-64": (12.5, 8.0, 144.0),
    "AK80-80": (12.5, 8.0, 144.0),
}


_LOST, _HOT = 13, 11  # errors: lost communication, MOSFET over temperature
_TIMEOUT, _MODE, _PMAX, _VMAX, _TMAX = 9, 10, 21, 22, 23
_FLOATS = (_PMAX, _VMAX, _TMAX)
DAMIAO_MIT, _STEP_S = 1, 50e-6

# Damiao's table of defaults: PMAX [rad], VMAX [rad/s], TMAX [N m].
DAMIAO_LIMITS = {
    "DM-J3507": (12.566, 50.0, 5.0),
    "DM-J4310": (12.5, 30.0, 10.0),
    "DM-J4340": (12.5, 8.0, 28.0),
    "DM-J6006": (12.5, 45.0, 20.0),
    "DM-J8006": (12.5, 45.0, 40.0),
    "DM-J8009": (12.5, 45.0, 54.0),
    "DM-J10010": (12.5, 20.0, 200.0),
    "DM-J10010L": (12.5, 25.0, 200.0),
}


class EmulatedDamiao(EmulatedMitMotor):
    """One motor, see `EmulatedMitMotor`; `registers` are its registers by number."""

    registers: dict[int, float]

    @staticmethod
    def _answer_id(motor: MitMotor, host_id: int | None) -> int:
        return motor.answer_id or motor.motor_id + 16

    def _process(self, message: can.Message, now_s: float) -> list[can.Message]:
        data = bytes(message.data)
        if message.is_extended_id:
            return []
        if message.arbitration_id == 0x7FF:
            return self._answer_about_register(data)
        if message.arbitration_id == self.number and data == b"\xff" * 7 + b"\xfb":
            self.error = 0
            return [self._reply()]
        return super()._process(message, now_s) if self.registers[_MODE] == DAMIAO_MIT else []

    def _answer_about_register(self, data: bytes) -> list[can.Message]:
        if len(data) != 8 or data[0] + 256 * data[1] != self.number or data[3] not in self.registers:
            return []
        layout = "<f" if data[3] in _FLOATS else "<I"
        if data[2] == 0x55:
            (self.registers[data[3]],) = struct.unpack(layout, data[4:])
            timeout_s = self.registers[_TIMEOUT] * _STEP_S
            self.timeout_s = timeout_s or None
        elif data[2] != 0x33:
            return []
        value = self.registers[data[3]]
        stored = struct.pack(layout, value if data[3] in _FLOATS else int(value))
        return [can.Message(arbitration_id=self._host_id, is_extended_id=False, data=data[:4] + stored)]

    def _time_out(self) -> None:
        self._fail(_LOST)

    def _fail(self, error: int = _HOT) -> None:
        self.error, self.enabled = error, False

    def _start_up(self) -> None:
        limits = (self._position_limit, self._velocity_limit, self._torque_limit)
        self.registers = {_TIMEOUT: 0, _MODE: DAMIAO_MIT, **dict(zip(_FLOATS, limits, strict=True))}
        self.timeout_s, self.error, self.enabled = None, 0, False

    def _reply(self) -> can.Message:
        message = super()._reply()
        status = self.error or int(self.enabled)
        message.data[0] = self.number & 0xF | status << 4
        message.data[6:8] = bytes((30, 28))
        return message


ROBSTRIDE_HOST = 0xFD
_HOT_STATE, _HOT_FAULT = 1 << 2, 1 << 0
_PARAMETERS = {0x7005: "<B", 0x7019: "<f", 0x7028: "<I"}  # run_mode, mechPos, canTimeout
_RUN_MODE, _POSITION, ROBSTRIDE_TIMEOUT = _PARAMETERS

# Manuals, 4.1.2: position [rad], velocity [rad/s], torque [N m].
ROBSTRIDE_LIMITS = {
    "RS00": (12.566370614359172, 33.0, 14.0),
    "RS01": (12.566370614359172, 44.0, 17.0),
    "RS02": (12.566370614359172, 44.0, 17.0),
    "RS03": (12.566370614359172, 20.0, 60.0),
    "RS04": (12.566370614359172, 15.0, 120.0),
    "RS05": (12.566370614359172, 50.0, 5.5),
    "RS06": (12.566370614359172, 50.0, 36.0),
}


class EmulatedRobstride(EmulatedMitMotor):
    """One motor, see `EmulatedMitMotor`; `parameters` are the writable ones, by index."""

    parameters: dict[int, float]
    _fault_reports: list[can.Message]  # sent without a request

    @staticmethod
    def _answer_id(motor: MitMotor, host_id: int | None) -> int:
        return ROBSTRIDE_HOST if host_id is None else host_id

    def _process(self, message: can.Message, now_s: float) -> list[can.Message]:
        number, data = message.arbitration_id, bytes(message.data)
        kind, middle, target = number >> 24, number >> 8 & 0xFFFF, number & 0xFF
        whole = message.is_extended_id and not message.is_remote_frame and len(data) == 8
        if not whole or target != self.number:
            return []
        self._heard_s = now_s
        index = int.from_bytes(data[:2], "little")
        if kind == 17:
            known = {**self.parameters, _POSITION: self.measured.position_rad}
            if index not in known:
                return [self._message(17, 1 << 8 | self.number, data[:2] + bytes(6))]
            packed = struct.pack(_PARAMETERS[index], known[index]).ljust(4, b"\0")
            return [self._message(17, self.number, data[:2] + bytes(2) + packed)]
        if kind == 18:
            if index in self.parameters:
                (self.parameters[index],) = struct.unpack_from(_PARAMETERS[index], data, 4)
                self.timeout_s = self.parameters.get(ROBSTRIDE_TIMEOUT, 0) / 20000 or None
        elif kind in (3, 4):
            self.error = 0 if kind == 4 and data[0] == 1 else self.error
            self.enabled = kind == 3 and not self.error
            self._command = _NO_COMMAND
        elif kind == 1 and self.parameters[_RUN_MODE] == 0:
            position, velocity, stiffness, damping = (share / 65535 for share in struct.unpack(">4H", data))
            stiff = self._torque_limit > 20.0  # the larger models have ten and twenty times the gains
            self._command = (
                (2.0 * position - 1.0) * self._position_limit,
                (2.0 * velocity - 1.0) * self._velocity_limit,
                stiffness * (5000.0 if stiff else 500.0),
                damping * (100.0 if stiff else 5.0),
                (2.0 * middle / 65535 - 1.0) * self._torque_limit,
            )
        else:
            return []
        self._drive()
        return [self._reply()]

    def send_unrequested(self, now_s: float) -> list[can.Message]:
        """Check the watchdog, and return the pending fault reports (see `EmulatedMotor.send_unrequested`)."""
        super().send_unrequested(now_s)
        reports, self._fault_reports = self._fault_reports, []
        return reports

    def _time_out(self) -> None:
        self.enabled = False

    def _fail(self) -> None:
        self.error, self.enabled = _HOT_STATE, False
        self.report_faults(_HOT_FAULT)

    def _start_up(self) -> None:
        self.parameters, self.timeout_s, self._fault_reports = {_RUN_MODE: 0, ROBSTRIDE_TIMEOUT: 0}, None, []
        self.error, self.enabled = 0, False

    def report_faults(self, faults: int, warnings: int = 0) -> None:
        """Report fault and warning bits without a request, with the next `send_unrequested`.

        Args:
            faults: bits.
            warnings: bits.
        """
        self._fault_reports.append(self._message(21, self.number, struct.pack("<II", faults, warnings)))

    def _reply(self) -> can.Message:
        measured, limit_rad = self.measured, self._position_limit
        data = struct.pack(
            ">4H",
            _to_uint((measured.position_rad + limit_rad) % (2.0 * limit_rad) - limit_rad, limit_rad, 16),
            _to_uint(measured.velocity_rad_s, self._velocity_limit, 16),
            _to_uint(measured.torque_nm, self._torque_limit, 16),
            251,  # tenths of a degree Celsius
        )
        return self._message(2, 2 * self.enabled << 14 | self.error << 8 | self.number, data)

    def _message(self, kind: int, middle: int, data: bytes) -> can.Message:
        number = kind << 24 | middle << 8 | self._host_id
        return can.Message(arbitration_id=number, is_extended_id=True, data=data)


_KINDS = {
    Maker.CUBEMARS: EmulatedMitMotor,
    Maker.DAMIAO: EmulatedDamiao,
    Maker.ROBSTRIDE: EmulatedRobstride,
}
_LIMITS = CUBEMARS_LIMITS | DAMIAO_LIMITS | ROBSTRIDE_LIMITS


class MitWires(WireMaker):
    """Motors configured as in the robot file."""

    name = "mit_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        settings = request.settings_as(MitBusSettings)
        kind = _KINDS[settings.maker]
        nodes = [kind(motor, joint, request.plant, settings) for joint, motor in enumerate(settings.motors)]
        return make_can_wire(request, nodes)
