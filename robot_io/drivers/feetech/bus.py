"""A bus of Feetech servos, whose own position control makes the torques.

These servos have no torque mode, and no watchdog: in their mode without position control they would run on
when the program has died. So a torque is commanded as a goal beside where the joint is, by the servo's own
law (`tables`): however long nobody says anything, the joint stays near that goal. Torques are those of the
motor by its duty cycle and speed; what the gears' friction takes is in none of them.
"""

from collections.abc import Mapping, Sequence
from math import ceil

import numpy as np

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.feetech import tables
from palpate.robot_io.drivers.feetech.feedback import (
    FeetechFeedback,
    Plausibility,
    feedback_problem,
    feedback_reader,
)
from palpate.robot_io.drivers.feetech.servos import FeetechLine, examine_servo
from palpate.robot_io.drivers.feetech.settings import FeetechServo, FeetechSettings
from palpate.robot_io.drivers.joint_bus import BusTorque
from palpate.robot_io.drivers.servo.bus import ServoBus, ServoEncoder
from palpate.robot_io.drivers.servo.feedback import FeedbackReader
from palpate.robot_io.errors import LifecycleError
from palpate.robot_io.examination import Finding, ok
from palpate.robot_io.guard.limits import Limits
from palpate.robot_io.types import FloatArray

_LEAST_DUTY = 0.1  # of a torque limit
_FASTEST = 2.0  # times the no-load speed: a joint that is thrown


def count_steps(servos: Sequence[FeetechServo]) -> FloatArray:
    """Convert one count of each servo: position [rad], velocity [rad/s] and torque [N m], shape (3, m).

    Args:
        servos: m servos that turn joints.
    """
    direction = np.array([servo.direction for servo in servos])
    stall_nm = np.array([servo.servo_model.stall_torque_nm for servo in servos])
    step_rad = direction * tables.POSITION_STEP_RAD
    return np.array((step_rad, step_rad, direction * stall_nm * tables.DUTY_PER_LOAD))


class FeetechBus(ServoBus):
    """Servos of the STS series; those that just hold are read and watched as the joints are."""

    name = "feetech_bus"
    _settings: FeetechSettings
    _line: FeetechLine

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        own = context.settings_as(FeetechSettings, settings)
        super().__init__(own, count_steps(own.turning), context)
        models = [servo.servo_model for servo in own.turning]
        self._stall_nm = [model.stall_torque_nm for model in models]
        self._drag_nms_rad = [model.stall_torque_nm / model.no_load_rad_s for model in models]
        self._drags_nms_rad = np.array(self._drag_nms_rad)
        self._steps_rad: list[float] = self._joints.steps[0].tolist()
        self._stiffness_nm_rad = [stall_nm * own.duty_per_rad for stall_nm in self._stall_nm]
        self._half_tick_s = 0.5 / context.robot_file.control_rate_hz
        torque_limits = self._torque_limits(context.robot_file.limits)
        self._line = FeetechLine(own, torque_limits, self._port, context.clock)
        self._fastest_counts_s = (
            _FASTEST * max(model.no_load_rad_s for model in models) / tables.POSITION_STEP_RAD
        )
        told = {servo_id: (0, 0, 0, limit, 1) for servo_id, limit in torque_limits.items()}
        self._plausibility = Plausibility(context.clock, told, self._fastest_counts_s)
        self._servos = {servo.id: servo for servo in own.turning}

    def _torque_limits(self, limits: Limits) -> dict[int, int]:
        """Largest duty cycle of each servo, in its unit, by id: for its torque at its speed.

        Those that hold stand still, and may bear what the strongest servo of a joint may.
        """
        own, pairs = self._settings, self._pairs
        servo_nm, speed_rad_s = pairs.shares(limits.torque_nm), pairs.of_servos(limits.velocity_rad_s)
        servos = zip(servo_nm, speed_rad_s, self._drag_nms_rad, self._stall_nm, strict=True)
        turning = [(torque + drag * speed) / stall for torque, speed, drag, stall in servos]
        held = max(torque / stall for torque, stall in zip(servo_nm, self._stall_nm, strict=True))
        duties = [max(duty, _LEAST_DUTY) for duty in (*turning, *len(own.hold) * [held])]
        counts = [min(ceil(duty / tables.DUTY_PER_LOAD), tables.LARGEST_LIMIT) for duty in duties]
        return dict(zip(own.ids, counts, strict=True))

    def _examine_servo(self, servo_id: int, label: str) -> list[Finding]:
        if servo_id in self._servos:
            return [examine_servo(self._line, self._servos[servo_id], label)]
        return [ok(label, "answers, and holds where it stands while the torque is on")]

    def _prepare_feedback(self) -> FeedbackReader[FeetechFeedback]:
        self._line.identify()
        self._line.prepare()
        self._plausibility.restart()
        return feedback_reader(self._port, self._clock, self._line.ids, self._plausibility.decode)

    def _counts(self, feedback: Sequence[FeetechFeedback]) -> Sequence[Sequence[int]]:
        _, _, _, _, position, speed, load, _, _ = zip(*feedback, strict=True)
        return position, speed, load

    def _motion(self, feedback: Sequence[FeetechFeedback]) -> FloatArray:
        feedback = feedback[: len(self._ids)]  # those that hold come last
        motion = super()._motion(feedback)
        _, velocity_rad_s, torque_nm = motion
        torque_nm -= velocity_rad_s * self._drags_nms_rad
        torque_on = [servo.torque_on for servo in feedback]
        if torque_on.count(1) < len(torque_on):
            torque_nm *= torque_on
        return motion

    def _is_well(self, feedback: Sequence[FeetechFeedback]) -> bool:
        told, fastest = (int(self._powered), 0), self._fastest_counts_s
        return all(servo[:2] == told and -fastest <= servo.speed <= fastest for servo in feedback)

    def _problem(self, feedback: Sequence[FeetechFeedback]) -> str | None:
        return feedback_problem(feedback, self._labels, self._fastest_counts_s, powered=self._powered)

    def _goals(self, torque_nm: list[float]) -> tuple[list[int], FloatArray]:
        """See `ServoBus._goals`: by the servos' law, from where each is during the next tick."""
        if self.sample is None:
            raise LifecycleError("read the servos first: a torque command starts from their positions")
        ahead_s = self._clock.now_s() - self.sample.sampled_at_s + self._half_tick_s
        position_rad, velocity_rad_s, _ = self.sample.of_servos.tolist()
        counts, sent_nm = [], []
        for (
            wanted_nm,
            angle_rad,
            speed_rad_s,
            drag_nms_rad,
            stall_nm,
            stiffness_nm_rad,
            step_rad,
            zero_rad,
        ) in zip(
            self._pairs.shares(torque_nm),
            position_rad,
            velocity_rad_s,
            self._drag_nms_rad,
            self._stall_nm,
            self._stiffness_nm_rad,
            self._steps_rad,
            self._joints.offset_rad.tolist(),
            strict=True,
        ):
            expected_rad, drag_nm = angle_rad + ahead_s * speed_rad_s, drag_nms_rad * speed_rad_s
            motor_nm = min(max(wanted_nm + drag_nm, -stall_nm), stall_nm)
            goal = round((expected_rad + motor_nm / stiffness_nm_rad - zero_rad) / step_rad)
            goal = min(max(goal, 0), tables.COUNTS_PER_REVOLUTION - 1)
            counts.append(goal)
            sent_nm.append((goal * step_rad + zero_rad - expected_rad) * stiffness_nm_rad - drag_nm)
        self._plausibility.sent(dict(zip(self._ids, counts, strict=True)))
        return counts, np.array(self._pairs.summed(sent_nm))

    def _switch_on(self) -> None:
        self._plausibility.restart()
        self._plausibility.sent(self._line.switch_on())


class FeetechEncoder(ServoEncoder):
    """Positions and velocities from a `feetech_bus`."""

    name = "feetech_encoder"
    bus_type = FeetechBus


class FeetechTorque(BusTorque):
    """Torques of a `feetech_bus`, commanded and measured as duty cycles of the motors; see there."""

    name = "feetech_torque"
    bus_type = FeetechBus
