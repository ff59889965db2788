"""A Robstride motor as its manual describes it: frames with 29 bit ids, parameters, and faults told unasked.

Written from RobStride's "User Manual" of RS00 to RS06 (2026-04-28), section 4.1: bits 28 to 24 of an id are
what a frame is, bits 7 to 0 who it is for. A state (2) has the mode above six fault bits above the motor's
id. A motor that has a fault, or hears nothing for its canTimeout (3.3.6), goes to reset mode.
"""

import struct

import can

from sim_backend.emulators.can.mit_motor import EmulatedMitMotor, to_uint

HOST = 0xFD
_HOT_STATE, _HOT_FAULT = 1 << 2, 1 << 0
_PARAMETERS = {0x7005: "<B", 0x7019: "<f", 0x7028: "<I"}  # run_mode, mechPos, canTimeout
_RUN_MODE, _POSITION, TIMEOUT = _PARAMETERS

# Manuals, 4.1.2: position [rad], velocity [rad/s], torque [N m].
LIMITS = {
    "RS00": (12.566370614359172, 33.0, 14.0),
    "RS01": (12.566370614359172, 44.0, 17.0),
    "RS02": (12.566370614359172, 44.0, 17.0),
    "RS03": (12.566370614359172, 20.0, 60.0),
    "RS04": (12.566370614359172, 15.0, 120.0),
    "RS05": (12.566370614359172, 50.0, 5.5),
    "RS06": (12.566370614359172, 50.0, 36.0),
}


class EmulatedRobstride(EmulatedMitMotor):
    """One motor, see `EmulatedMitMotor`; `parameters` is what can be written, by index."""

    parameters: dict[int, float]
    _news: list[can.Message]  # to be told unasked

    def hear(self, message: can.Message, now_s: float) -> list[can.Message]:
        kind, middle, target = _split(message.arbitration_id)
        data = bytes(message.data)
        whole = message.is_extended_id and not message.is_remote_frame and len(data) == 8
        if not whole or target != self.number or now_s < self._silent_until_s:
            return []
        self._heard_s = now_s
        if kind == 17:
            return [self._parameter(data)]
        if kind == 18:
            self._write(data)
        elif kind in (3, 4):
            self.error = 0 if kind == 4 and data[0] == 1 else self.error
            self.enabled = kind == 3 and not self.error
            self._command = (0.0, 0.0, 0.0, 0.0, 0.0)
        elif kind == 1 and self.parameters[_RUN_MODE] == 0:
            self._command = self._understood(middle, data)
        else:
            return []
        self._drive()
        return [self._reply()]

    def _understood(self, torque: int, data: bytes) -> tuple[float, float, float, float, float]:
        position, velocity, stiffness, damping = (share / 65535 for share in struct.unpack(">4H", data))
        stiff = self._torque_limit > 20.0  # the larger models have ten and twenty times the gains
        return (
            (2.0 * position - 1.0) * self._position_limit,
            (2.0 * velocity - 1.0) * self._velocity_limit,
            stiffness * (5000.0 if stiff else 500.0),
            damping * (100.0 if stiff else 5.0),
            (2.0 * torque / 65535 - 1.0) * self._torque_limit,
        )

    def _parameter(self, data: bytes) -> can.Message:
        index = int.from_bytes(data[:2], "little")
        known = {**self.parameters, _POSITION: self.shown.position_rad}
        if index not in known:
            return self._message(17, 1 << 8 | self.number, data[:2] + bytes(6))
        packed = struct.pack(_PARAMETERS[index], known[index]).ljust(4, b"\0")
        return self._message(17, self.number, data[:2] + bytes(2) + packed)

    def _write(self, data: bytes) -> None:
        index = int.from_bytes(data[:2], "little")
        if index in self.parameters:
            (self.parameters[index],) = struct.unpack_from(_PARAMETERS[index], data, 4)
            self.timeout_s = self.parameters.get(TIMEOUT, 0) / 20000 or None

    def tell(self, now_s: float) -> list[can.Message]:
        """See `CanNode.tell`: faults, and here its timeout runs."""
        super().tell(now_s)
        news, self._news = self._news, []
        return news

    def _time_out(self) -> None:
        self.enabled = False

    def _fail(self) -> None:
        self.error, self.enabled = _HOT_STATE, False
        self.tell_faults(_HOT_FAULT)

    def _start_up(self) -> None:
        self.parameters, self.timeout_s, self._news = {_RUN_MODE: 0, TIMEOUT: 0}, None, []
        self.error, self.enabled = 0, False

    def tell_faults(self, faults: int) -> None:
        """Report fault bits unasked with the next `tell`."""
        self._news.append(self._message(21, self.number, struct.pack("<II", faults, 0)))

    def _reply(self) -> can.Message:
        shown = self.shown
        data = struct.pack(
            ">4H",
            to_uint(shown.position_rad, self._position_limit, 16),
            to_uint(shown.velocity_rad_s, self._velocity_limit, 16),
            to_uint(shown.torque_nm, self._torque_limit, 16),
            251,  # tenths of a degree Celsius
        )
        mode = 2 if self.enabled else 0
        return self._message(2, mode << 14 | self.error << 8 | self.number, data)

    def _message(self, kind: int, middle: int, data: bytes) -> can.Message:
        number = kind << 24 | middle << 8 | self._host_id
        return can.Message(arbitration_id=number, is_extended_id=True, data=data)


def _split(number: int) -> tuple[int, int, int]:
    """Bits 28 to 24, 23 to 8 and 7 to 0 of an id."""
    return number >> 24, number >> 8 & 0xFFFF, number & 0xFF
