"""A bus of Feetech servos, whose own position control makes the torques.

These servos have no torque mode, and no watchdog: in their mode without position control they would run on
when the program has died. So a torque is commanded as a goal beside where the joint is, by the servo's own
law (`tables`): however long nobody says anything, the joint stays near that goal. Torques are those of the
motor by its duty cycle and speed; what the gears' friction takes is in none of them.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from robot_io.driver import DriverContext
from robot_io.drivers.bus_devices import BusTorque
from robot_io.drivers.feetech import protocol, tables
from robot_io.drivers.feetech.examination import examine_servos
from robot_io.drivers.feetech.feedback import (
    Feedback,
    Plausibility,
    feedback_problem,
    feedback_reader,
)
from robot_io.drivers.feetech.servos import FeetechLine
from robot_io.drivers.feetech.settings import FeetechServo, FeetechSettings
from robot_io.drivers.servo.bus import ServoBus
from robot_io.drivers.servo.devices import ServoEncoder
from robot_io.drivers.servo.feedback import FeedbackReader
from robot_io.drivers.servo.joints import ServoSample
from robot_io.errors import LifecycleError
from robot_io.examination import Finding
from robot_io.guard.limits import Limits
from robot_io.types import FloatArray

_LEAST_DUTY = 0.1  # of a torque limit
_FASTEST = 2.0  # times the no-load speed: a joint that is thrown


def count_steps(servos: Sequence[FeetechServo]) -> FloatArray:
    """What one count of position [rad], speed [rad/s] and load [N m] is at the joints, shape (3, m)."""
    direction = np.array([servo.direction for servo in servos])
    stall_nm = np.array([servo.servo_model.stall_torque_nm for servo in servos])
    step_rad = direction * tables.POSITION_STEP_RAD
    return np.array((step_rad, step_rad, direction * stall_nm * tables.DUTY_PER_LOAD))


class FeetechBus(ServoBus):
    """Servos of the STS series; those that just hold are read and watched as the joints are."""

    name = "feetech_bus"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._settings = own = context.settings_as(FeetechSettings, settings)
        super().__init__(own, count_steps(own.turning), context)
        models = [servo.servo_model for servo in own.turning]
        self._stall_nm = np.array([model.stall_torque_nm for model in models])
        self._drag_nms_rad = self._stall_nm / [model.no_load_rad_s for model in models]
        self._stiffness_nm_rad = self._stall_nm * own.duty_per_rad
        self._half_tick_s = 0.5 / context.robot_file.control_rate_hz
        torque_limits = self._torque_limits(context.robot_file.limits)
        self._line: FeetechLine = FeetechLine(own, torque_limits, self._port, context.clock)
        fastest_counts_s = _FASTEST * max(model.no_load_rad_s for model in models) / tables.POSITION_STEP_RAD
        told = {servo_id: (0, 0, 0, limit, 1) for servo_id, limit in torque_limits.items()}
        self._plausibility = Plausibility(context.clock, told, fastest_counts_s)

    def _torque_limits(self, limits: Limits) -> dict[int, int]:
        """Largest duty cycle of each servo, in its unit, by id: for its torque at its speed.

        Those that hold stand still, and may bear what the strongest servo of a joint may.
        """
        own, pairs = self._settings, self._pairs
        servo_nm = pairs.shares(np.resize(limits.torque_nm, len(own.servos)))
        speed_rad_s = pairs.of_servos(np.resize(limits.velocity_rad_s, len(own.servos)))
        turning_nm = servo_nm + self._drag_nms_rad * speed_rad_s
        held = [(servo_nm / self._stall_nm).max()] * len(own.hold)
        duty = np.maximum([*(turning_nm / self._stall_nm), *held], _LEAST_DUTY)
        counts = np.minimum(np.ceil(duty / tables.DUTY_PER_LOAD), tables.LARGEST_LIMIT)
        return dict(zip(own.ids, map(int, counts.tolist()), strict=True))

    def _examine_servos(self) -> list[Finding]:
        return examine_servos(self._settings, self._line)

    def _prepare_feedback(self) -> FeedbackReader[Feedback]:
        self._line.identify()
        self._line.prepare()
        self._plausibility.restart()
        return feedback_reader(self._port, self._clock, self._settings.ids, self._plausibility.decode)

    def _counts(self, feedback: Sequence[Feedback]) -> Sequence[Sequence[int]]:
        _, _, _, position, speed, load, _, _, _ = zip(*feedback, strict=True)
        return position, speed, load

    def _motion(self, feedback: Sequence[Feedback]) -> FloatArray:
        feedback = feedback[: len(self._ids)]  # those that hold come last
        motion = super()._motion(feedback)
        motion[2] -= self._drag_nms_rad * motion[1]
        motion[2] *= [servo.torque_on for servo in feedback]
        return motion

    def _problem(self, feedback: Sequence[Feedback]) -> str | None:
        return feedback_problem(feedback, self._labels, powered=self._powered)

    def _goals(self, torque_nm: FloatArray) -> tuple[bytes, FloatArray]:
        """See `ServoBus._goals`: by the servos' law, from where each is during the next tick."""
        sample, step_rad = self._newest(), self._joints.steps[0]
        ahead_s = self._clock.now_s() - sample.sampled_at_s + self._half_tick_s
        position_rad, velocity_rad_s, _ = sample.of_servos
        expected_rad = position_rad + ahead_s * velocity_rad_s
        drag_nm = self._drag_nms_rad * velocity_rad_s
        wanted_nm = self._pairs.shares(torque_nm) + drag_nm
        motor_nm = np.minimum(np.maximum(wanted_nm, -self._stall_nm), self._stall_nm)
        goal_rad = expected_rad + motor_nm / self._stiffness_nm_rad
        wanted = np.rint((goal_rad - self._joints.offset_rad) / step_rad)
        counts = np.minimum(np.maximum(wanted, 0), tables.COUNTS_PER_REVOLUTION - 1)
        goals = dict(zip(self._ids, map(int, counts.tolist()), strict=True))
        self._plausibility.sent(goals)
        data = {servo_id: tables.GOAL_POSITION.encode(goal) for servo_id, goal in goals.items()}
        off_rad = counts * step_rad + self._joints.offset_rad - expected_rad
        sent_nm = self._pairs.summed(off_rad * self._stiffness_nm_rad - drag_nm)
        return protocol.sync_write(tables.GOAL_POSITION.address, data), sent_nm

    def _newest(self) -> ServoSample:
        if self.sample is None:
            raise LifecycleError(
                "the servos have not been read yet: a torque is commanded from where they are"
            )
        return self.sample

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
