"""A bus of Feetech servos, whose own position control generates the torques.

These servos have no torque mode and no watchdog: in their mode without position control they would continue
to run after the program has died. So a torque is commanded as a goal near the joint's present position, by
the servo's own law (`tables`). Without further commands, the joint stays near that goal. Torques are those of
the motor, from its duty cycle and speed; they do not include the friction of the gears.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import ceil

import numpy as np

from palpate.robot_io.driver import DriverContext
from palpate.robot_io.drivers.feetech import tables
from palpate.robot_io.drivers.feetech.feedback import FeetechFeedback, FeetechReader, PlausibilityFilter
from palpate.robot_io.drivers.feetech.protocol import error_names
from palpate.robot_io.drivers.feetech.servos import FeetechLine
from palpate.robot_io.drivers.feetech.tables import POSITION_STEP_RAD, FeetechSettings
from palpate.robot_io.drivers.joint_bus import joint_drivers
from palpate.robot_io.drivers.servo.bus import ServoBus, ServoEncoder
from palpate.robot_io.drivers.servo.feedback import FeedbackReader
from palpate.robot_io.drivers.servo.line import IS_ON, TOO_HOT
from palpate.robot_io.errors import LifecycleError
from palpate.robot_io.examination import Finding, Level, graded, ok
from palpate.robot_io.types import FloatArray, clip

_LEAST_DUTY = 0.1  # smallest torque limit, as a duty cycle
_FASTEST_SHARE = 2.0  # multiple of the no-load speed that a joint may reach when it is thrown


class FeetechBus(ServoBus[FeetechFeedback]):
    """Servos of the STS series; servos that only hold are read and monitored like joints."""

    name = "feetech_bus"
    _settings: FeetechSettings
    _line: FeetechLine

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        validated = context.settings_as(FeetechSettings, settings)
        models = [servo.servo_model for servo in validated.turning]
        self._stall_nm = [model.stall_torque_nm for model in models]
        direction = np.array([servo.direction for servo in validated.turning])
        step_rad = direction * POSITION_STEP_RAD
        step_nm = direction * np.array(self._stall_nm) * tables.DUTY_PER_LOAD
        super().__init__(validated, np.array((step_rad, step_rad, step_nm)), context)
        drag_nms_rad = [model.stall_torque_nm / model.no_load_rad_s for model in models]
        self._drag_loads = (np.array(drag_nms_rad) * step_rad / step_nm).tolist()  # load per speed, in counts
        drag_nm: list[float] = (np.array(drag_nms_rad) * step_rad).tolist()
        stiffness_nm: list[float] = (np.array(self._stall_nm) * validated.duty_per_rad * step_rad).tolist()
        # Drag per speed in counts, stall torque, and torque per count from the position to the goal.
        self._laws = list(zip(drag_nm, self._stall_nm, stiffness_nm, strict=True))
        self._half_tick_s = 0.5 / context.robot_file.control_rate_hz
        # Oldest position that is acted on, at the end of its tick.
        self._oldest_s = context.robot_file.limits.encoder_age_s + 2.0 * self._half_tick_s
        # Largest duty cycle of each servo, in its unit: for its torque at its speed. Those that hold stand
        # still, and may bear what the strongest servo of a joint may.
        limits, pairs = context.robot_file.limits, self._pairs
        servo_nm = pairs.split_torques(limits.torque_nm)
        speed_rad_s = pairs.repeat_for_servos(limits.velocity_rad_s)
        servos = zip(servo_nm, speed_rad_s, drag_nms_rad, self._stall_nm, strict=True)
        turning = [(torque + drag * speed) / stall for torque, speed, drag, stall in servos]
        held = max(torque / stall for torque, stall in zip(servo_nm, self._stall_nm, strict=True))
        duties = [max(duty, _LEAST_DUTY) for duty in (*turning, *len(validated.hold) * [held])]
        counts = [min(ceil(duty / tables.DUTY_PER_LOAD), tables.LARGEST_LIMIT) for duty in duties]
        torque_limits = dict(zip(validated.ids, counts, strict=True))
        self._line = FeetechLine(validated, torque_limits, self._port, context.clock)
        fastest_rad_s = max(model.no_load_rad_s for model in models)
        self._fastest_counts_s = _FASTEST_SHARE * fastest_rad_s / POSITION_STEP_RAD
        self._sent_settings = {servo_id: (0, 0, 0, limit, 1) for servo_id, limit in torque_limits.items()}
        self._plausibility = PlausibilityFilter(context.clock, self._sent_settings, self._fastest_counts_s)
        self._servos = {servo.id: servo for servo in validated.turning}
        # `FeetechFeedback.torque_on` of healthy servos, by whether they are powered.
        self._torque_on = [(on,) * len(validated.ids) for on in (0, 1)]

    def _examine_servo(self, servo_id: int, label: str) -> Iterator[Finding]:
        """See `ServoBus._examine_servo`; of each servo only the most severe finding."""
        if servo_id not in self._servos:
            yield ok(label, "answers, and holds its position while the torque is on")
            return
        line = self._line
        identity = line.identify_servo(self._servos[servo_id])
        errors = line.registers.read(servo_id, tables.STATUS)
        is_hot = identity.temperature_c > identity.temperature_limit_c
        value = (
            f"{identity.servo.model}, firmware {identity.firmware}, {identity.voltage_v:.1f} V, "
            f"{identity.temperature_c} °C (its limit {identity.temperature_limit_c} °C), "
            f"homing offset {identity.homing_offset}"
        )
        if errors:
            value += f"; error: {error_names(errors)}"
        elif identity.problem:
            value += f"; {identity.problem}"
        elif not is_hot:
            if line.torque_limits[servo_id] == tables.LARGEST_LIMIT:
                value += "; its own torque limit is its stall torque, so only the guard enforces 'limits'"
            value += "; no watchdog: it holds its last goal when the program dies"
        yield graded(
            label,
            value,
            (Level.FAIL, errors, "remove the cause, then restart it"),
            (Level.FAIL, identity.problem, "correct the robot file, or the supply"),
            (Level.WARN, is_hot, TOO_HOT),
        )

    def _prepare_feedback(self) -> FeedbackReader[FeetechFeedback]:
        self._line.identify()
        self._line.prepare()
        self._plausibility.restart()
        return FeetechReader(self._port, self._clock, self._sent_settings, self._plausibility)

    def _counts(self, feedback: FeetechFeedback) -> Sequence[Sequence[float]]:
        """See `ServoBus._counts`; the duty cycle includes what the speed takes, which is no torque."""
        # Servos that hold come last, and have no drag.
        servos = zip(self._drag_loads, feedback.load, feedback.speed, feedback.torque_on, strict=False)
        torques = [(load - speed * drag) * torque_on for drag, load, speed, torque_on in servos]
        count = len(torques)
        return feedback.position[:count], feedback.speed[:count], torques

    def _is_healthy(self, feedback: FeetechFeedback) -> bool:
        return (
            feedback.torque_on == self._torque_on[self._powered]
            and not any(feedback.errors)
            and max(feedback.speed) <= self._fastest_counts_s
            and min(feedback.speed) >= -self._fastest_counts_s
        )

    def _problem(self, feedback: FeetechFeedback) -> str | None:
        states = feedback.torque_on, feedback.errors, feedback.speed
        for label, torque_on, errors, speed in zip(self._labels, *states, strict=True):
            if torque_on and not self._powered:
                return f"{label}: {IS_ON}"
            if self._powered and not torque_on:
                why = error_names(errors) if errors else "none; has it restarted?"
                return f"{label}: has switched its torque off (error: {why})"
            if abs(speed) > self._fastest_counts_s:
                speed_rad_s = speed * POSITION_STEP_RAD
                limit_rad_s = self._fastest_counts_s * POSITION_STEP_RAD
                return f"{label}: reports {speed_rad_s:.3g} rad/s, but its maximum is {limit_rad_s:.3g} rad/s"
        return None

    def _goals(self, torque_nm: list[float]) -> tuple[list[int], FloatArray]:
        """Compute goals from the servos' control law and predicted positions; see `ServoBus._goals`."""
        if self.sample is None:
            raise LifecycleError(
                "read the servos first, because a torque command starts from their positions"
            )
        feedback, asked_at_s = self.sample
        # Without newer positions the goals must not move on, because the joints would follow them.
        ahead_s = min(self._clock.now_s() - asked_at_s, self._oldest_s) + self._half_tick_s
        counts, sent_nm, highest = [], [], tables.COUNTS_PER_REVOLUTION - 1
        shares_nm = self._pairs.split_torques(torque_nm)
        # Servos that hold come last, and get no goal.
        servos = zip(self._laws, shares_nm, feedback.position, feedback.speed, strict=False)
        for (drag_per_speed_nm, stall_nm, torque_per_count_nm), wanted_nm, position, speed in servos:
            expected_count = position + ahead_s * speed
            drag_nm = drag_per_speed_nm * speed
            motor_nm = wanted_nm + drag_nm
            if not -stall_nm <= motor_nm <= stall_nm:
                motor_nm = clip(motor_nm, -stall_nm, stall_nm)
            goal = round(expected_count + motor_nm / torque_per_count_nm)
            if not 0 <= goal <= highest:
                goal = 0 if goal < 0 else highest
            counts.append(goal)
            sent_nm.append((goal - expected_count) * torque_per_count_nm - drag_nm)
        self._plausibility.sent(counts)
        return counts, np.array(self._pairs.sum_pairs(sent_nm))

    def _switch_on(self) -> None:
        self._plausibility.restart()
        self._plausibility.sent(list(self._line.switch_on().values()))


FeetechEncoder, FeetechTorque = joint_drivers(FeetechBus, "feetech", ServoEncoder)
