"""A Damiao motor as its manual describes it: MIT frames, a status in its answers, and registers.

Written from Damiao's "DM-J4310-2EC user manual": the status stands above the id's four bits (0 off, 1 on,
8 and more errors), the last two bytes are temperatures, registers are read and written through id 7FF, and a
CAN timeout that fires switches the motor off with error 13.
"""

import struct

import can

from sim_backend.emulators.can.mit_motor import EmulatedMitMotor

_LOST, _HOT = 13, 11
_TIMEOUT, _MODE, _PMAX, _VMAX, _TMAX = 9, 10, 21, 22, 23
_FLOATS = (_PMAX, _VMAX, _TMAX)
MIT, _STEP_S = 1, 50e-6

# Damiao's table of defaults: PMAX [rad], VMAX [rad/s], TMAX [N m].
LIMITS = {
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
    """One motor, see `EmulatedMitMotor`; `registers` is what it keeps, by number."""

    registers: dict[int, float]

    def hear(self, message: can.Message, now_s: float) -> list[can.Message]:
        data = bytes(message.data)
        if now_s < self._silent_until_s or message.is_extended_id:
            return []
        if message.arbitration_id == 0x7FF:
            return self._keep(data)
        if message.arbitration_id == self.number and data == b"\xff" * 7 + b"\xfb":
            self.error = 0
            return [self._reply()]
        return super().hear(message, now_s) if self.registers[_MODE] == MIT else []

    def _keep(self, data: bytes) -> list[can.Message]:
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
        kept = struct.pack(layout, value if data[3] in _FLOATS else int(value))
        return [can.Message(arbitration_id=self._host_id, is_extended_id=False, data=data[:4] + kept)]

    def _time_out(self) -> None:
        self._fail(_LOST)

    def _fail(self, error: int = _HOT) -> None:
        self.error, self.enabled = error, False

    def _start_up(self) -> None:
        limits = (self._position_limit, self._velocity_limit, self._torque_limit)
        self.registers = {_TIMEOUT: 0, _MODE: MIT, **dict(zip(_FLOATS, limits, strict=True))}
        self.timeout_s, self.error, self.enabled = None, 0, False

    def _reply(self) -> can.Message:
        message = super()._reply()
        status = self.error or int(self.enabled)
        message.data[0] = self.number & 0xF | status << 4
        message.data[6:8] = bytes((30, 28))
        return message
