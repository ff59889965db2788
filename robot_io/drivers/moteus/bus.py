"""moteus controllers on a CAN FD bus: position mode without gains, and feed-forward torque."""

from collections.abc import Mapping
from math import tau

from robot_io.clip import clip
from robot_io.driver import DriverContext
from robot_io.drivers.bus_devices import BusEncoder, BusTorque
from robot_io.drivers.can.asked import ANSWER_S, AskedMotorBus
from robot_io.drivers.can.line import CanFrame
from robot_io.drivers.moteus import protocol as moteus
from robot_io.drivers.moteus.protocol import MoteusState
from robot_io.drivers.moteus.settings import MoteusBusSettings
from robot_io.errors import DeviceError
from robot_io.examination import Finding, fail, ok, warn

_ARBITRATION_BITS, _DATA_BITS, _DATA_BITRATE = 48, 37, 5_000_000  # around the data, with a 29 bit id
_COMMAND_BYTES, _ANSWER_BYTES = 32, 24
_KNOWN_BY = {moteus.ROTOR: "the rotor alone, within one of its turns", moteus.OUTPUT: "the output"}


class MoteusBus(AskedMotorBus[MoteusState]):
    """moteus controllers. Each command carries its watchdog, which is left to expire at activation."""

    name = "moteus_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(MoteusBusSettings, settings)
        ids = [motor.motor_id for motor in own.motors]
        super().__init__(own, own.motors, context, ids, own.watchdog_s)
        self._own, self._motors = own, own.motors
        self._shown: list[MoteusState | None] = [None] * len(ids)
        self._question_frames = [moteus.encode_question(own.host_id, motor_id) for motor_id in ids]
        self._stops = [moteus.encode_stop(own.host_id, motor_id) for motor_id in ids]

    def configure(self) -> None:
        """Open the adapter and hear every controller; nothing changes its mode.

        DeviceError: the adapter cannot be opened, or a controller is silent or does not know its position.
        """
        self._hear_all()
        self._refuse_lost()

    def _refuse_lost(self) -> None:
        """DeviceError: a controller does not know its position, or only from where it started."""
        for joint, state in enumerate(self._shown):
            if self._motion_is_wrong[joint]:
                raise self._about(
                    joint, f"does not know its position: {self._error_names(self._errors[joint])}"
                )
            if state is not None and state.home == moteus.RELATIVE:
                raise self._about(joint, "has no reference for its position (home state 0)")

    def _report(self) -> list[Finding]:
        self._shown = [None] * self.joint_count
        self._ask()
        self._wait_for(lambda: None not in self._shown, ANSWER_S)
        return [self._observe(joint, state) for joint, state in enumerate(self._shown)]

    def _observe(self, joint: int, state: MoteusState | None) -> Finding:
        label = self.motor_label(joint)
        if state is None:
            return fail(label, "does not answer", "check its power, cable, id and bit rates")
        value = f"mode {state.mode}, {state.supply_v:.1f} V, {state.temperature_c:.0f} °C, position known by "
        value += _KNOWN_BY.get(state.home, "nothing")
        if state.error:
            names = self._error_names(state.error)
            return warn(label, f"{names}; {value}", "it is cleared at activation; see what caused it")
        return ok(label, value)

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: a command to each controller, and its answer."""
        data_bits = 2 * _DATA_BITS + 8 * (_COMMAND_BYTES + _ANSWER_BYTES)
        arbitration_s = 2 * _ARBITRATION_BITS / (self.line.bitrate or 1_000_000)
        return self.joint_count * (arbitration_s + data_bits / _DATA_BITRATE)

    def power_on(self) -> None:
        self._unasked = [0] * self.joint_count
        self._arm()
        self._refuse_twins()
        self._refuse_lost()  # it may have restarted since it was configured
        self._outlast_watchdogs()
        self._answered(self._question_frames)
        self._refuse_going_on([bool(enabled) for enabled in self._enabled], "is still in position mode")
        self._arm()
        self._powered = True
        self._command, self._commanded_s = self._zero_torque(), self._clock.now_s()

    def _switch_off(self) -> None:
        self._bring_to(self._stops, "torque off is not confirmed by", enabled=False)

    def _arm(self) -> None:
        """Forget faults, and go to position mode at zero torque. DeviceError: a controller did not."""
        self._bring_to(self._stops, "does not stop:", enabled=False)
        self._bring_to(self._zero_torque(), "no position mode:", enabled=True)

    def _bring_to(self, frames: list[CanFrame], problem: str, *, enabled: bool) -> None:
        """Send frames until the answer to an earlier one says that all are in position mode, or stopped."""
        self._answers = [0] * self.joint_count

        def others() -> list[str]:
            return [
                f"{self.motor_label(joint)} ({self._error_names(error) if error else 'no such answer'})"
                for joint, error in enumerate(self._errors)
                if self._answers[joint] < 2 or error or self._enabled[joint] is not enabled
            ]

        def done() -> bool:
            missing = others()
            if missing:
                self._send_all(frames)
            return not missing

        if not self._wait_for(done, ANSWER_S):
            twins = f"; {self._twins()}" if any(self._unasked) else ""
            raise DeviceError(f"{self.line.label}: {problem} {', '.join(others())}{twins}")

    def _questions(self, joint: int) -> list[CanFrame]:
        return [self._question_frames[joint]]

    def _joint_of(self, frame: CanFrame) -> int | None:
        is_answer = frame.fd and not frame.remote and frame.can_id & 0xFF == self._own.host_id
        return self._joint_by_id.get(frame.can_id >> 8) if is_answer else None

    def _take(self, frame: CanFrame, at_s: float) -> bool:
        joint = self._joint_of(frame)
        if joint is None:
            return False
        self._states[joint].append((moteus.decode_state(frame), at_s))
        return True

    def _motor_asked(self, frame: CanFrame) -> int | None:
        return frame.can_id & 0x7F

    def _condition(self, state: MoteusState) -> tuple[int, bool | None]:
        return state.error, state.mode == moteus.POSITION

    def _keep(self, joint: int, state: MoteusState, asked_s: float) -> None:
        motor = self._motors[joint]
        self._shown[joint] = state
        self._motion_is_wrong[joint] = not state.is_known or state.error in moteus.ENCODER_FAULTS
        if state.is_known:
            self._position_rad[joint] = motor.joint_angle_rad(tau * state.position_rev)
            self._velocity_rad_s[joint] = tau * state.velocity_rev_s / motor.signed_ratio
            self._torque_nm[joint] = state.torque_nm * motor.signed_ratio
            self._torque_at_s[joint] = asked_s
        self._motion_at_s[joint] = asked_s

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        motor = self._motors[joint]
        ratio = motor.signed_ratio
        output_nm = clip(torque_nm / ratio, -motor.max_torque_nm, motor.max_torque_nm)
        frame = moteus.encode_torque(self._own.host_id, motor.motor_id, output_nm, self._own.watchdog_s)
        return frame, moteus.as_sent(output_nm) * ratio

    def _error_names(self, error: int) -> str:
        return moteus.FAULTS.get(error, f"unknown fault {error}")

    def _doubt(self, joint: int) -> str:
        """See `MotorBus._doubt`: a controller says what cuts its torque."""
        state = self._shown[joint]
        if state is None or state.error or state.fault < moteus.FIRST_LIMIT:
            return ""
        return f"its torque is limited by {moteus.LIMITS.get(state.fault, f'code {state.fault}')}"


class MoteusEncoder(BusEncoder):
    """Positions and velocities that moteus controllers report; the settings are the bus's."""

    name = "moteus_encoder"
    bus_type = MoteusBus


class MoteusTorque(BusTorque):
    """Torques to and from moteus controllers; the settings are the bus's."""

    name = "moteus_torque"
    bus_type = MoteusBus
