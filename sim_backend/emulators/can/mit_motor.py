"""A motor in MIT mode as the CubeMars AK manual describes it: it answers the frames to its id.

Written from the "AK Series Actuator Driver Manual" V1.0.8, section 5.3, and its float and integer conversions
(which cut off where another would round). The CAN timeout lets the motor go when no frame comes.

Out of motor mode, the firmware that the protocol comes from (bgkatz/motorcontrol) answers commands as ever,
and does not say that it exerts nothing. The manual says that the mode comes first and that the state is asked
for by the frame that enters it: so a motor may as well be deaf to commands until then.
"""

import can

from sim_backend.emulators.can.motor import EmulatedMotor
from sim_backend.emulators.plant import Plant

_ALERT = 6  # MOSFET over temperature
_TEMPERATURE = 25
Limits = tuple[float, float, float]  # of position [rad], velocity [rad/s] and torque [N m]


def to_uint(value: float, limit: float, bits: int) -> int:
    """Manual: (x - x_min) (2^bits - 1) / (x_max - x_min), cut off to an integer."""
    value = min(max(value, -limit), limit)
    return int((value + limit) * ((1 << bits) - 1) / (2 * limit))


def _to_float(number: int, low: float, high: float, bits: int) -> float:
    return number * (high - low) / ((1 << bits) - 1) + low


class EmulatedMitMotor(EmulatedMotor):
    """One motor, see `EmulatedMotor`.

    Its limits are the ends of the ranges of position [rad], velocity [rad/s] and torque [N m], `host_id` the
    arbitration id of its answers, and a `timeout_s` of None no CAN timeout [s]. Out of motor mode one that is
    `deaf_when_off` answers nothing but the special codes.
    """

    def __init__(
        self,
        number: int,
        joint: int,
        plant: Plant,
        *,
        limits: Limits,
        host_id: int = 0,
        timeout_s: float | None = None,
        deaf_when_off: bool = False,
        **mounting: float,
    ) -> None:
        super().__init__(number, joint, plant, **mounting)
        self._position_limit, self._velocity_limit, self._torque_limit = limits
        self._host_id, self.timeout_s, self._deaf_when_off = host_id, timeout_s, deaf_when_off
        self.enabled = False
        self.error = 0
        self._command = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._start_up()

    def hear(self, message: can.Message, now_s: float) -> list[can.Message]:
        for_me = message.arbitration_id == self.number and not message.is_extended_id
        if not for_me or message.is_remote_frame or len(message.data) != 8 or now_s < self._silent_until_s:
            return []
        data = bytes(message.data)
        is_special = data[:7] == b"\xff" * 7 and data[7] in (0xFC, 0xFD, 0xFE)
        if self._deaf_when_off and not (self.enabled or is_special):
            return []
        self._heard_s = now_s
        if is_special:
            if data[7] != 0xFE:
                self.enabled = data[7] == 0xFC
            self._command = (0.0, 0.0, 0.0, 0.0, 0.0)
        else:
            self._command = self._unpack(data)
        self._drive()
        return [self._reply()]

    def _unpack(self, data: bytes) -> tuple[float, float, float, float, float]:
        bits = int.from_bytes(data, "big")
        position, velocity, stiffness = bits >> 48, bits >> 36 & 0xFFF, bits >> 24 & 0xFFF
        damping, torque = bits >> 12 & 0xFFF, bits & 0xFFF
        return (
            _to_float(position, -self._position_limit, self._position_limit, 16),
            _to_float(velocity, -self._velocity_limit, self._velocity_limit, 12),
            _to_float(stiffness, 0.0, 500.0, 12),
            _to_float(damping, 0.0, 5.0, 12),
            _to_float(torque, -self._torque_limit, self._torque_limit, 12),
        )

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

    def tell(self, now_s: float) -> list[can.Message]:
        """See `CanNode.tell`: nothing unasked, but here its timeout runs."""
        if self.enabled and self.timeout_s is not None and now_s - self._heard_s > self.timeout_s:
            self._time_out()
            self._drive()
        return []

    def _time_out(self) -> None:
        """Let go after its CAN timeout."""
        self._command = (0.0, 0.0, 0.0, 0.0, 0.0)

    def _fail(self) -> None:
        self.error = _ALERT

    def _start_up(self) -> None:
        self.enabled = False

    def _reply(self) -> can.Message:
        shown = self.shown
        position = to_uint(shown.position_rad, self._position_limit, 16)
        velocity = to_uint(shown.velocity_rad_s, self._velocity_limit, 12)
        torque = to_uint(shown.torque_nm, self._torque_limit, 12)
        bits = self.number << 56 | position << 40 | velocity << 28 | torque << 16
        data = (bits | _TEMPERATURE << 8 | self.error).to_bytes(8, "big")
        return can.Message(arbitration_id=self._host_id, is_extended_id=False, data=data)


# CubeMars "AK Series Actuator Driver Manual" V1.0.8, 5.3: position [rad], speed [rad/s], torque [N m].
LIMITS = {
    "AK10-9": (12.5, 50.0, 65.0),
    "AK60-6": (12.5, 45.0, 15.0),
    "AK70-10": (12.5, 50.0, 25.0),
    "AK80-6": (12.5, 76.0, 12.0),
    "AK80-9": (12.5, 50.0, 18.0),
    "AK80-64": (12.5, 8.0, 144.0),
    "AK80-80": (12.5, 8.0, 144.0),
}
