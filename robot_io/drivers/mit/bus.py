"""Motors in MIT mode (CubeMars AK and kin) on a CAN bus: zero gains and feed-forward torque.

A motor speaks only when it is spoken to: each command is answered with the motor's state, which the next poll
takes in. While the torque is off, each poll asks again.
"""

from collections.abc import Mapping
from math import inf
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from robot_io.driver import DriverContext
from robot_io.drivers.can.line import CanFrame, CanLineSettings
from robot_io.drivers.can.motors import MotorBus, MotorEncoder, MotorMounting, MotorTorque
from robot_io.drivers.mit import protocol as mit
from robot_io.drivers.mit.protocol import MIT_MODELS, MitRanges, mit_error_name
from robot_io.errors import DeviceError
from robot_io.examination import Finding, fail, ok
from robot_io.files.file_model import FileModel, Positive


class MitRangeSettings(FileModel):
    """Ranges of a motor whose parameters were changed."""

    position_rad: Positive  # position range, plus and minus [rad]
    velocity_rad_s: Positive  # velocity range, plus and minus [rad/s]
    torque_nm: Positive  # torque range, plus and minus [N m]


class MitMotor(MotorMounting):
    """One motor. It reports at its output shaft, so that `gear_ratio` is only what comes after it."""

    motor_id: Annotated[int, Field(ge=1, le=255, strict=True)]  # its CAN id
    model: str  # which ranges it has, see `MIT_MODELS`
    ranges: MitRangeSettings | None = None  # its ranges, if they are not those of the model

    @model_validator(mode="after")
    def _know_the_model(self) -> "MitMotor":
        if self.ranges is None and self.model not in MIT_MODELS:
            raise ValueError(
                f"no ranges are known for '{self.model}'. Valid: {', '.join(MIT_MODELS)}, or state 'ranges'"
            )
        return self

    @property
    def wire_ranges(self) -> MitRanges:
        """What the numbers on the wire mean."""
        if self.ranges is None:
            return MIT_MODELS[self.model]
        return MitRanges(self.ranges.position_rad, self.ranges.velocity_rad_s, self.ranges.torque_nm)


class MitBusSettings(CanLineSettings):
    """What the robot file says."""

    motors: Annotated[tuple[MitMotor, ...], Field(min_length=1)]  # one per joint, from base to tip
    # Arbitration id of the motors' answers; an answer under the motor's own id is taken too.
    host_id: Annotated[int, Field(ge=0, le=0x7FF, strict=True)] = 0
    # After how long without a command a motor lets go [s], as set in it (CAN timeout). The protocol can
    # neither set nor read it, so it is proven at each activation: every motor gets 1 % of its torque, and
    # must have let go after a silence. Without commands for so long the host sends zero torque as well, for
    # a motor can only be read by commanding it.
    watchdog_s: Annotated[Positive, Field(le=1)] = 0.1
    # What makes a motor without torque say its state: "exit" keeps it off, as in the firmware that the
    # protocol comes from, which answers every frame; "enter" is what the AK manual names for motors that are
    # deaf to commands outside of motor mode, and zero torque and "exit" follow it.
    ask_with: Literal["exit", "enter"] = "exit"

    @model_validator(mode="after")
    def _agree(self) -> "MitBusSettings":
        ids = [motor.motor_id for motor in self.motors]
        if len(set(ids)) != len(ids):
            raise ValueError(f"motors: ids {ids} are not all different")
        return self


_ANSWER_S = 0.05  # more than any motor takes
_ENCODER_FAULT = 5
_TRIAL_SHARE = 0.01  # of a motor's torque range
_TRIAL_S = 0.01  # until it is exerted
_LATEST_WATCHDOG = 1.5  # times its time: it has fired by then


class MitBus(MotorBus):
    """MIT-mode motors on a CAN bus."""

    name: ClassVar[str] = "mit_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(MitBusSettings, settings)
        super().__init__(own, own.motors, context)
        self._own = own
        self._motors = own.motors
        self._ranges = [motor.wire_ranges for motor in own.motors]
        self._joint_by_id = {motor.motor_id: joint for joint, motor in enumerate(own.motors)}
        self._errors = [0] * len(own.motors)
        self._answers = [0] * len(own.motors)
        self._commanded_s = -inf
        self._command: list[CanFrame] = []
        self._flushed = False

    def motor_label(self, joint: int) -> str:
        return f"joint {joint + 1} (motor {self._motors[joint].motor_id})"

    def configure(self) -> None:
        """Open the adapter and hear every motor, with the torque off.

        DeviceError: the adapter cannot be opened, or a motor is silent.
        """
        self.line.open()
        self._ask()
        if not self._wait_for(lambda: -inf not in self._motion_at_s, _ANSWER_S):
            silent = [joint for joint, at_s in enumerate(self._motion_at_s) if at_s == -inf]
            labels = ", ".join(map(self.motor_label, silent))
            raise DeviceError(f"{self.line.label}: no answer in {_ANSWER_S} s from {labels}")
        if self._own.ask_with == "exit":  # one answer to each frame
            self._measure_latency(self._ask, self._motion_at_s)

    def _report(self) -> list[Finding]:
        """See `MotorBus._report`; the protocol tells neither voltage nor firmware."""
        self._motion_at_s = [-inf] * self.joint_count
        self._ask()
        self._wait_for(lambda: -inf not in self._motion_at_s, _ANSWER_S)
        observations = []
        for joint, motor in enumerate(self._motors):
            label, error = self.motor_label(joint), self._errors[joint]
            if self._motion_at_s[joint] == -inf:
                remedy = "check its power, cable and id, and that it is in MIT mode"
                observations.append(fail(label, "does not answer", remedy))
            elif error:
                observations.append(fail(label, mit_error_name(error), "remove the cause, then restart it"))
            else:
                value = (
                    f"answers, at {self._position_rad[joint]:+.3f} rad; does not report its model, the robot "
                    f"file says {motor.model}; CAN timeout {self._own.watchdog_s:g} s, proven at activation"
                )
                observations.append(ok(label, value))
        return observations

    def tick_wire_s(self) -> float | None:
        """See `Examinable.tick_wire_s`: a command to each motor, and its answer."""
        return 2 * self.joint_count * self._frame_s(8)

    def power_on(self) -> None:
        frames = [*self._to_every_motor(mit.ENTER_MOTOR_MODE), *self._zero_torque()]
        self._send_confirmed(frames, "motor mode is not confirmed by")
        wrong = [joint for joint, error in enumerate(self._errors) if error]
        if wrong:
            problems = (
                f"{self.motor_label(joint)}: {mit_error_name(self._errors[joint])}" for joint in wrong
            )
            raise DeviceError(f"{self.line.label}: {'; '.join(problems)}")
        self._check_watchdogs()
        self._send_confirmed(frames, "motor mode is not confirmed by")
        self._powered = True
        self._command, self._commanded_s = self._zero_torque(), self._clock.now_s()

    def _check_watchdogs(self) -> None:
        """Let every motor exert a little, and say nothing for longer than it may go on with that.

        Asked by the frame that enters motor mode, for a motor may have left it.

        DeviceError: a motor goes on, or shows no torque at all.
        """
        trial_nm = [
            _TRIAL_SHARE * ranges.torque_nm * abs(motor.signed_ratio)
            for ranges, motor in zip(self._ranges, self._motors, strict=True)
        ]
        trial = [self._encode_torque(joint, torque_nm)[0] for joint, torque_nm in enumerate(trial_nm)]
        silence_s = _LATEST_WATCHDOG * self._own.watchdog_s
        self._exerting(trial, trial_nm)
        self._clock.sleep_until(self._clock.now_s() + _TRIAL_S)
        exerting = self._exerting(trial, trial_nm)
        self._clock.sleep_until(self._clock.now_s() + silence_s)
        going_on = self._exerting(self._to_every_motor(mit.ENTER_MOTOR_MODE), trial_nm)
        if not all(exerting):
            idle = self.motor_label(exerting.index(False))
            raise DeviceError(f"{self.line.label}: {idle} shows no torque when told to exert some")
        if any(going_on):
            alive = ", ".join(self.motor_label(joint) for joint, on in enumerate(going_on) if on)
            raise DeviceError(
                f"{self.line.label}: {alive} still exerts torque after {silence_s:.2g} s without commands; "
                f"set the CAN timeout to {self._own.watchdog_s:g} s in the motor"
            )

    def _exerting(self, frames: list[CanFrame], trial_nm: list[float]) -> list[bool]:
        """Whether the answers to `frames`, one to each motor, show at least half of torques (n) [N m]."""
        self._answers = [0] * self.joint_count
        self._send_all(frames)
        if not self._wait_for(lambda: all(self._answers), _ANSWER_S):
            silent = self.motor_label(self._answers.index(0))
            raise DeviceError(f"{self.line.label}: no answer in {_ANSWER_S} s from {silent}")
        return [torque >= 0.5 * trial for torque, trial in zip(self._torque_nm, trial_nm, strict=True)]

    def power_off(self) -> None:
        """See `MotorBus.power_off`; each motor must answer, be it on or off already and deaf to commands."""
        self._powered = False
        self._staged = []
        if not self.line.is_open:
            return
        leave = self._to_every_motor(mit.EXIT_MOTOR_MODE)
        frames = [*self._zero_torque(), *leave, *leave]
        self._send_confirmed(frames, "torque off is not confirmed by")

    def poll(self, deadline_s: float) -> None:
        """See `MotorBus.poll`; where no command has been sent since the last poll, asks for the next one."""
        try:
            super().poll(deadline_s)
        finally:
            if not self.line.bus_off:
                self._request_states()
            self._flushed = False

    def flush(self, deadline_s: float) -> None:
        if self._staged:
            self._commanded_s, self._command, self._flushed = self._clock.now_s(), self._staged, True
        super().flush(deadline_s)

    def _request_states(self) -> None:
        """Make the motors answer: say the last command again, but not for longer than the watchdog's time."""
        if not self._powered:
            self._ask()
        elif not self._flushed:
            forgotten = self._clock.now_s() - self._commanded_s > self._own.watchdog_s
            self._send_all(self._zero_torque() if forgotten else self._command)

    def _ask(self) -> None:
        if self._own.ask_with == "exit":
            self._send_all(self._to_every_motor(mit.EXIT_MOTOR_MODE))
        else:
            # Asked this way a motor has power, at zero torque, until the frame after the next is there.
            enter, leave = mit.ENTER_MOTOR_MODE, mit.EXIT_MOTOR_MODE
            self._send_all([*self._to_every_motor(enter), *self._zero_torque(), *self._to_every_motor(leave)])

    def _to_every_motor(self, special: bytes) -> list[CanFrame]:
        return [CanFrame(motor.motor_id, special) for motor in self._motors]

    def _zero_torque(self) -> list[CanFrame]:
        return [self._encode_torque(joint, 0.0)[0] for joint in range(self.joint_count)]

    def _send_confirmed(self, frames: list[CanFrame], problem: str) -> None:
        """Send frames, two or more to each motor, and wait until each has answered twice."""
        self._answers = [0] * self.joint_count
        self._send_all(frames)

        def missing() -> list[str]:
            return [self.motor_label(joint) for joint, answers in enumerate(self._answers) if answers < 2]

        if not self._wait_for(lambda: not missing(), _ANSWER_S):
            raise DeviceError(f"{self.line.label}: {problem} {', '.join(missing())}")

    def _joint_of(self, frame: CanFrame) -> int | None:
        if frame.extended or frame.remote or not frame.data:
            return None
        joint = self._joint_by_id.get(frame.data[0])
        if joint is None or frame.can_id not in (self._own.host_id, self._motors[joint].motor_id):
            return None
        return joint

    def _take(self, frame: CanFrame, at_s: float) -> bool:
        joint = self._joint_of(frame)
        if joint is None:
            return False
        motor = self._motors[joint]
        state = mit.decode_state(frame, self._ranges[joint])
        self._position_rad[joint] = motor.joint_angle_rad(state.position_rad)
        self._velocity_rad_s[joint] = state.velocity_rad_s / motor.signed_ratio
        self._torque_nm[joint] = state.torque_nm * motor.signed_ratio
        self._motion_at_s[joint] = self._torque_at_s[joint] = at_s - self._latency_s[joint]
        self._at_range_end[joint] = state.at_range_end
        self._errors[joint] = state.error
        self._answers[joint] += 1
        self._motion_is_wrong[joint] = state.error == _ENCODER_FAULT
        return True

    def _encode_torque(self, joint: int, torque_nm: float) -> tuple[CanFrame, float]:
        motor, ranges = self._motors[joint], self._ranges[joint]
        shaft_nm = torque_nm / motor.signed_ratio
        frame = mit.encode_torque(motor.motor_id, shaft_nm, ranges)
        return frame, mit.as_sent(shaft_nm, ranges) * motor.signed_ratio

    def _fault(self, joint: int, now_s: float) -> str:
        error = self._errors[joint]
        return mit_error_name(error) if error else ""


class MitEncoder(MotorEncoder):
    """Positions and velocities that MIT-mode motors report; the settings are the bus's."""

    name: ClassVar[str] = "mit_encoder"
    bus_type: ClassVar[type[MotorBus]] = MitBus


class MitTorque(MotorTorque):
    """Torques to and from MIT-mode motors; the settings are the bus's."""

    name: ClassVar[str] = "mit_torque"
    bus_type: ClassVar[type[MotorBus]] = MitBus
