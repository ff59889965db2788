"""Hybrid controller of figure 2: position before contact, force in contact, one reference for both.

Before contact the reference is the demanded motion X_pre. In contact the force law moves the reference, then
called X_des. Position and speed of the reference are continuous in both directions; only the acceleration can
jump, and it is bounded. Inverse kinematics and computed torque follow the reference in either case.
"Compliance Estimation during Bilateral Teleoperation of a Robotic Arm", section IV-C.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from palpate.control.arm.rigid_body import RigidBody, TipMotion
from palpate.control.laws.computed_torque import ComputedTorque
from palpate.control.laws.force_laws import (
    HOLD_LAWS,
    Compliance,
    Environment,
    HoldState,
    QuickEstimator,
    loading_acceleration,
    within_bounds,
)
from palpate.control.laws.gains import Gains, TouchGains
from palpate.control.laws.touch import release_force_n
from palpate.control.paths.press_line import PressLine
from palpate.control.paths.trajectory import JointMotion, LineState
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import Command, FloatArray, Measurement, Status, clip


class ForceGoal(NamedTuple):
    """Goal in contact."""

    force_n: float  # force to reach or to hold, positive in compression [N]
    speed_limit_m_s: float  # largest inward speed [m/s]
    hold: bool  # whether to follow the hold law rather than load at the speed limit


class HybridReference(NamedTuple):
    """Reference of one tick."""

    # motion while there is no contact, or at all times if `force` is None.
    free: LineState | None = None
    # goal from contact on; with `free` None also while contact is lost for a moment.
    force: ForceGoal | None = None


class ControlOutput(NamedTuple):
    """Output of the controller in one tick."""

    command: Command  # joint torques
    motion: JointMotion  # reference motion of the joints
    tip: TipMotion  # measured motion of the tip
    state: LineState  # reference along the press line
    in_contact: bool  # state of the contact switch
    force_n: float  # measured force above the free-air mean [N]
    push_lever_m: FloatArray  # joint torques per force along the tool, shape (n,) [m]
    # accelerations added by the feedback, shape (n,) [rad/s^2].
    correction_rad_s2: FloatArray


class ContactSwitch:
    """Contact state with hysteresis and debounce.

    Args:
        gains: debounce and release share.
        touch_force_n: force above which there is contact [N].
    """

    def __init__(self, gains: TouchGains, touch_force_n: float) -> None:
        self._debounce, self._count = gains.debounce_samples, 0
        self.touch_force_n, self.release_force_n = touch_force_n, release_force_n(touch_force_n, gains)
        self.in_contact = False

    def update(self, force_n: float) -> bool:
        """Update the state with one new force sample, and return whether there is contact.

        Args:
            force_n: above the free-air mean [N].
        """
        is_change = force_n < self.release_force_n if self.in_contact else force_n > self.touch_force_n
        self._count = self._count + 1 if is_change else 0
        if self._count >= self._debounce:
            self.in_contact = not self.in_contact
            self._count = 0
        return self.in_contact


class HybridController:
    """Position and force control along a press line; joint motions between lines.

    Args:
        body: model of the arm.
        sensor_axis_tip: direction in which the tool pushes, tip frame, shape (3,).
        gains: gains of all laws.
        hold_law: name in `HOLD_LAWS`.
        estimated: returns the online estimate of stiffness [N/m], damping [N s/m] and surface along the press
            direction [m], NaN before there is one; None for no estimator.
    """

    def __init__(
        self,
        body: RigidBody,
        sensor_axis_tip: FloatArray,
        gains: Gains,
        hold_law: str = "admittance",
        estimated: Callable[[], tuple[float, float, float]] | None = None,
    ) -> None:
        self._hold_law = HOLD_LAWS[hold_law]
        self._estimated = estimated
        self._body = body
        self._axis_tip = sensor_axis_tip
        self._contact_gains = gains.contact
        self._torque = ComputedTorque(body, gains.tracking)
        self._line: PressLine | None = None
        self.reference_rad = np.zeros(body.joint_count)  # reference joint positions
        self._force_at_s = -math.inf
        self._touch_gains = gains.touch
        self.switch = ContactSwitch(gains.touch, gains.touch.touch_force_n)
        self.quick_estimator = QuickEstimator()
        self.state = LineState(0.0)  # reference along the press line
        self.force_bias_n = 0.0  # force in free air, which is subtracted
        self.surface_travel_m = 0.0  # travel at which the last touch began, to within one tick
        self._clear_travel_m = 0.0  # last travel without force

    def start(self, measurement: Measurement) -> None:
        """Begin from the measured joint positions, with the measured force as the free-air force.

        Args:
            measurement: state of the arm.
        """
        self._torque.reset()
        self.reference_rad = measurement.joint_position_rad.copy()
        self.force_bias_n = measurement.force_n if math.isfinite(measurement.force_n) else 0.0

    def set_line(self, line: PressLine, travel_m: float) -> None:
        """Follow a press line from now on, at rest.

        Args:
            line: the press line.
            travel_m: travel of the joints' present reference [m].
        """
        self._line = line
        self.state = LineState(travel_m)

    def tare(self, force_bias_n: float, touch_force_n: float) -> None:
        """Set the free-air force and the touch force; the contact state is cleared.

        Args:
            force_bias_n: force in free air [N].
            touch_force_n: force above it that counts as contact [N].
        """
        self.force_bias_n = force_bias_n
        self.switch = ContactSwitch(self._touch_gains, touch_force_n)

    def step_joints(self, measurement: Measurement, motion: JointMotion, dt_s: float) -> ControlOutput:
        """Follow a joint motion in free air.

        Args:
            measurement: state of the arm.
            motion: reference of the joints.
            dt_s: time since the last tick [s].
        """
        tip = self._body.tip_motion(measurement.joint_position_rad, measurement.joint_velocity_rad_s)
        force_n = measurement.force_n - self.force_bias_n
        if self._is_new(measurement):
            self.switch.update(force_n)
        return self._follow(measurement, motion, tip, force_n, dt_s)

    def step(self, measurement: Measurement, reference: HybridReference, dt_s: float) -> ControlOutput:
        """Follow the press line.

        Args:
            measurement: state of the arm.
            reference: motion before contact, force in contact.
            dt_s: time since the last tick [s].

        Raises:
            InputError: no line is set, or the reference left the arm's reach.
        """
        if self._line is None:
            raise InputError("hybrid controller: call set_line before step")
        tip = self._body.tip_motion(measurement.joint_position_rad, measurement.joint_velocity_rad_s)
        force_n = measurement.force_n - self.force_bias_n
        speed_m_s = float(tip.velocity_world_m_s.dot(self._line.direction_world))
        since_s = measurement.force_at_s - self._force_at_s
        if self._is_new(measurement):
            travel_m, was_in_contact = self._line.travel_of(tip.position_world_m), self.switch.in_contact
            if not was_in_contact and force_n < self.switch.release_force_n:
                self._clear_travel_m = travel_m
            if self.switch.update(force_n):
                if not was_in_contact:
                    self.surface_travel_m = self._clear_travel_m
                    self.quick_estimator.reset()
                self.quick_estimator.update(travel_m - self.surface_travel_m, speed_m_s, force_n, since_s)
        goal, free, last = reference.force, reference.free, self.state
        if free is not None and (goal is None or not self.switch.in_contact):
            self.state = free
        elif goal is None:
            raise InputError("hybrid controller: the reference has neither a motion nor a force")
        else:
            speed = last.speed_m_s + last.acceleration_m_s2 * dt_s
            travel = last.travel_m + 0.5 * (last.speed_m_s + speed) * dt_s
            self.state = LineState(travel, speed, self._force_law(goal, force_n, speed_m_s, speed, dt_s))
        motion = self._line.joint_motion(self.state, self.reference_rad)
        return self._follow(measurement, motion, tip, force_n, dt_s)

    def _is_new(self, measurement: Measurement) -> bool:
        """Return whether the force was sampled since the last tick."""
        is_new = measurement.force_at_s > self._force_at_s and measurement.force_status == Status.OK
        self._force_at_s = max(self._force_at_s, measurement.force_at_s)
        return is_new

    def _force_law(
        self, goal: ForceGoal, force_n: float, measured_m_s: float, speed_m_s: float, dt_s: float
    ) -> float:
        """Return the acceleration of the reference [m/s^2]."""
        compliance, gains = self.quick_estimator.compliance, self._contact_gains
        if goal.hold:
            state = LineState(self.state.travel_m, speed_m_s, self.state.acceleration_m_s2)
            hold = HoldState(goal.force_n, force_n, state, self._environment())
            acceleration_m_s2 = self._hold_law(hold, gains, dt_s)
            acceleration_m_s2 = min(acceleration_m_s2, (goal.speed_limit_m_s - speed_m_s) / dt_s)
            return clip(acceleration_m_s2, -gains.yielding_m_s2, gains.yielding_m_s2)
        # The measured speed gives the spring's share of the force; the reference's speed integrates the force
        # error. The mean of both follows the limit closely and does not oscillate.
        spring_n = force_n - compliance.damping_n_s_m * 0.5 * (measured_m_s + speed_m_s)
        room_n = gains.loading_aim * goal.force_n - spring_n
        return loading_acceleration(speed_m_s, goal.speed_limit_m_s, room_n, compliance, gains)

    def _environment(self) -> Environment:
        """Return the online estimate, or the quick estimate if there is none."""
        quick_estimate = Environment(self.quick_estimator.compliance, self.surface_travel_m)
        if self._estimated is None or self._line is None:
            return quick_estimate
        stiffness_n_m, damping_n_s_m, surface_m = self._estimated()
        if not stiffness_n_m > 0.0:
            return quick_estimate
        origin_m = float(self._line.start_world_m.dot(self._line.direction_world))
        compliance = within_bounds(Compliance(stiffness_n_m, damping_n_s_m))
        return Environment(compliance, surface_m - origin_m)

    def _follow(
        self, measurement: Measurement, motion: JointMotion, tip: TipMotion, force_n: float, dt_s: float
    ) -> ControlOutput:
        self.reference_rad = motion.position_rad
        push_world = tip.rotation_world_tip.dot(self._axis_tip)
        lever_m = push_world.dot(tip.jacobian_world[:3])
        contact_torque = lever_m * (force_n * self._contact_gains.force_feedforward)
        torque = self._torque.step(measurement, motion, contact_torque, dt_s)
        contact, correction = self.switch.in_contact, self._torque.correction_rad_s2
        return ControlOutput(Command(torque), motion, tip, self.state, contact, force_n, lever_m, correction)
