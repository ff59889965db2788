"""An ODrive axis as its manual describes it: cyclic messages, state machine, watchdog, errors.

Written from ODrive's documentation "CAN Protocol" (0.5.6 and 0.6.10) and the behavior of fw-v0.5.6: any
frame to the axis feeds its watchdog; an expired watchdog disarms the axis; an axis with errors does not arm.
"""

import math
import struct
from typing import Any

import can

from palpate.robot_io.drivers.odrive import OdriveAxis, OdriveBusSettings
from palpate.sim_backend.emulators.can_line import EmulatedMotor, make_can_wire
from palpate.sim_backend.emulators.hardware import EmulatedWire, Plant
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest

IDLE, CLOSED_LOOP = 1, 8
WATCHDOG_BIT = {"0.5": 1 << 11, "0.6": 1 << 24}
ALERT_BIT = {"0.5": 1 << 6, "0.6": 1 << 14}  # MOTOR_FAILED; INVERTER_OVER_TEMP
OVERSPEED_BIT = {"0.5": 1 << 9, "0.6": 1 << 15}  # CONTROLLER_FAILED; VELOCITY_LIMIT_VIOLATION
_CYCLIC_S = 1e-3  # period of estimates and torques
_VELOCITY_GAIN = 1 / 6  # as delivered [N m s/rev]
_TOLERANCE = 1.2  # times its velocity limit, as delivered
ESTOP_BIT = {"0.5": 1 << 14, "0.6": 1 << 25}


class EmulatedOdrive(EmulatedMotor):
    """One axis, see `EmulatedMotor`; its current limit allows `max_torque_nm`.

    Attributes:
        watchdog_s: time without a frame after which it disarms; None is not enabled [s].
        velocity_limit_rev_s: beyond 1.2 times this an axis fails [rev/s]; as delivered 2.
        current_limit_a: current limit that was last set over CAN [A].
        velocity_limiter: limit [rev/s] and gain [N m s/rev] of the torque limiter, as delivered 2 and
            1/6; None: switched off.
    """

    def __init__(self, axis: OdriveAxis, joint: int, plant: Plant, settings: OdriveBusSettings) -> None:
        super().__init__(axis.node_id, joint, plant, axis)
        self._firmware, self._max_torque_nm = settings.firmware, axis.max_torque_nm
        self._torque_constant = axis.torque_constant_nm_a or 1.0
        self.watchdog_s: float | None = settings.watchdog_s
        self._heartbeat_s = self._next_heartbeat_s = settings.heartbeat_s
        self._cyclic_s = self._next_cyclic_s = _CYCLIC_S
        self.velocity_limit_rev_s, self.current_limit_a = math.inf, math.nan
        self.velocity_limiter: tuple[float, float] | None = None
        self.supply_v = 24.0
        self._start_up()

    def _start_up(self) -> None:
        self.state, self.error = IDLE, 0
        self._control_mode, self._input_mode = 3, 1  # position control, inputs passed through, as shipped
        self._input_torque_nm = self._input_rev_s = 0.0

    def _process(self, message: can.Message, now_s: float) -> list[can.Message]:
        if message.is_extended_id or message.arbitration_id >> 5 != self.number:
            return []
        self._heard_s = now_s
        command = message.arbitration_id & 0x1F
        if message.is_remote_frame:
            return self._answer(command)
        data = bytes(message.data)
        if command == 0x02:
            self._disarm(ESTOP_BIT[self._firmware])
        elif command == 0x07 and len(data) >= 4:
            state = struct.unpack_from("<I", data)[0]
            if state == IDLE:
                self.state = IDLE
            elif state == CLOSED_LOOP and not self.error:
                self.state = CLOSED_LOOP
        elif command == 0x0B and len(data) == 8:
            self._control_mode, self._input_mode = struct.unpack("<II", data)
        elif command == 0x0D and len(data) == 8:
            self._input_rev_s, self._input_torque_nm = struct.unpack("<ff", data)
        elif command == 0x0E and len(data) >= 4:
            self._input_torque_nm = struct.unpack_from("<f", data)[0]
        elif command == 0x0F and len(data) == 8:
            self.velocity_limit_rev_s, self.current_limit_a = struct.unpack("<ff", data)
        elif command == 0x18:
            self.error = 0
        self._drive()
        return []

    def _disarm(self, error: int) -> None:
        self.error |= error
        self.state = IDLE
        self._drive()

    def _drive(self) -> None:
        limit_nm = self._max_torque_nm if self.state == CLOSED_LOOP else 0.0
        torque_nm = min(max(self._setpoint_nm, -limit_nm), limit_nm)
        if self.velocity_limiter is not None:
            limit_rev_s, gain = self.velocity_limiter
            rev_s = self.shaft.velocity_rad_s / math.tau
            torque_nm = min(max(torque_nm, (-limit_rev_s - rev_s) * gain), (limit_rev_s - rev_s) * gain)
        self._exert(torque_nm)

    @property
    def _setpoint_nm(self) -> float:
        """Torque of the control loops; that of positions is left out."""
        if self._input_mode != 1:
            return 0.0
        error_rev_s = self._input_rev_s - self.shaft.velocity_rad_s / math.tau
        return self._input_torque_nm + _VELOCITY_GAIN * error_rev_s * (self._control_mode >= 2)

    def _answer(self, command: int) -> list[can.Message]:
        match command:
            case 0x00 if self._firmware == "0.6":
                version = bytes((2, 4, 4, 58, 0, 6, 10, 0))  # protocol 2, Pro v4.4, firmware 0.6.10
                return [self._message(0x00, version)]
            case 0x01 if self._firmware == "0.6":
                return [self._heartbeat()]
            case 0x09:
                return [self._encoder_estimates()]
            case 0x17:
                return [self._message(0x17, struct.pack("<ff", self.supply_v, 0.5))]
        return []

    def send_unrequested(self, now_s: float) -> list[can.Message]:
        """See `EmulatedMotor.send_unrequested`; estimates, torques and heartbeats, each at its rate."""
        if now_s < self._silent_until_s:
            return []
        watchdog_s = math.inf if self.watchdog_s is None else self.watchdog_s
        if self.state == CLOSED_LOOP and now_s - self._heard_s > watchdog_s:
            self._disarm(WATCHDOG_BIT[self._firmware])
        fastest_rev_s = _TOLERANCE * self.velocity_limit_rev_s
        if self.state == CLOSED_LOOP and abs(self.shaft.velocity_rad_s) / math.tau > fastest_rev_s:
            self._disarm(OVERSPEED_BIT[self._firmware])
        messages = []
        if now_s >= self._next_cyclic_s - 1e-9:
            self._next_cyclic_s = max(self._next_cyclic_s, now_s) + self._cyclic_s
            messages += [self._encoder_estimates(), self._torque()]
        if now_s >= self._next_heartbeat_s - 1e-9:
            self._next_heartbeat_s = max(self._next_heartbeat_s, now_s) + self._heartbeat_s
            messages.append(self._heartbeat())
        return [message for message in messages if message is not None]

    def _fail(self) -> None:
        self._disarm(ALERT_BIT[self._firmware])

    def _encoder_estimates(self) -> can.Message:
        measured = self.measured
        data = struct.pack("<ff", measured.position_rad / math.tau, measured.velocity_rad_s / math.tau)
        return self._message(0x09, data)

    def _torque(self) -> can.Message:
        motor_torque_nm = self.shaft.torque_nm
        if self._firmware == "0.6":
            return self._message(0x1C, struct.pack("<ff", self._setpoint_nm, motor_torque_nm))
        constant = self._torque_constant
        return self._message(
            0x14, struct.pack("<ff", self._setpoint_nm / constant, motor_torque_nm / constant)
        )

    def _heartbeat(self) -> can.Message:
        # Flag of the motor's errors, or procedure result 3: disarmed.
        code = bool(self.error & ALERT_BIT["0.5"]) if self._firmware == "0.5" else 3 * bool(self.error)
        return self._message(0x01, struct.pack("<IBB2x", self.error, self.state, code))

    def _message(self, command: int, data: bytes) -> can.Message:
        return can.Message(arbitration_id=self.number << 5 | command, is_extended_id=False, data=data)


class OdriveWires(WireMaker):
    """ODrive axes configured as in the robot file."""

    name = "odrive_bus"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        settings, plant = request.settings_as(OdriveBusSettings), request.plant
        nodes = [EmulatedOdrive(axis, joint, plant, settings) for joint, axis in enumerate(settings.axes)]
        return make_can_wire(request, nodes)
