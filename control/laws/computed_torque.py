"""Computed torque with a PID for disturbances.

    tau = M(q) (a_ref + PID(q_ref - q, v_ref - v)) + C(q, v) v + g(q) + tau_contact

One call of the recursive Newton-Euler algorithm gives all but the last term, and the error then behaves as
a decoupled, linear oscillator on every joint. Siciliano et al., "Robotics", Springer 2009, section 8.5.2;
figure 2 of "Compliance Estimation during Bilateral Teleoperation of a Robotic Arm".
"""

import numpy as np

from control.arm.rigid_body import RigidBody
from control.laws.gains import TrackingGains
from control.paths.trajectory import JointMotion
from robot_io.clip import clip
from robot_io.errors import InputError
from robot_io.types import FloatArray, Measurement


class Pid:
    """output = kp e + ki integral(e) + kd filtered(de/dt), limited.

    The derivative passes a first-order low-pass (backward Euler). The integral of a joint stands still while
    its output is limited and the error would drive it further (conditional integration). Astrom and Murray,
    "Feedback Systems", Princeton 2008, section 10.4.

    Gains are kp [output/rad], ki [output/(rad s)] and kd [output s/rad]; `output_limit` holds either way, and
    `derivative_filter_s` is the low-pass's time constant, 0 for none. A negative gain and a limit that is not
    positive raise `InputError`.
    """

    def __init__(
        self,
        joint_count: int,
        *,
        kp: float,
        ki: float,
        kd: float,
        output_limit: float,
        derivative_filter_s: float = 0.0,
    ) -> None:
        if min(kp, ki, kd, derivative_filter_s) < 0.0 or not output_limit > 0.0:
            raise InputError(
                f"PID: gains {kp}, {ki}, {kd} and filter {derivative_filter_s} s must not be negative, "
                f"output limit {output_limit} must be positive"
            )
        self._kp, self._ki, self._kd = kp, ki, kd
        self._limit = output_limit
        self._filter_s = derivative_filter_s
        self._joint_count = joint_count
        self.reset()

    @property
    def integral(self) -> FloatArray:
        """The integral part of the output, shape (n,)."""
        return np.array(self._integral)

    def reset(self) -> None:
        """Forget the past."""
        self._integral = [0.0] * self._joint_count  # times ki, so that a change of gain makes no bump
        self._rate = [0.0] * self._joint_count

    def step(self, error_rad: FloatArray, error_rate_rad_s: FloatArray, dt_s: float) -> FloatArray:
        """Output (n,) for errors (n,), reference minus measured [rad], and their rates (n,) [rad/s]."""
        followed = dt_s / (dt_s + self._filter_s)
        output: list[float] = []  # joint by joint: for a few of them several times as fast as arrays
        errors = zip(error_rad.tolist(), error_rate_rad_s.tolist(), strict=True)
        for joint, (error, error_rate) in enumerate(errors):
            self._rate[joint] += (error_rate - self._rate[joint]) * followed
            growth = error * (self._ki * dt_s)
            wanted = self._kp * error + self._kd * self._rate[joint] + self._integral[joint] + growth
            allowed = clip(wanted, -self._limit, self._limit)
            if not (wanted - allowed) * growth > 0.0:
                self._integral[joint] += growth
            output.append(allowed)
        return np.array(output)


class ComputedTorque:
    """Follows joint motions; `correction_rad_s2` (n,) is what the PID added in the last step [rad/s^2]."""

    def __init__(self, body: RigidBody, gains: TrackingGains) -> None:
        self._body = body
        self.correction_rad_s2: FloatArray = np.zeros(body.joint_count)
        bandwidth = gains.bandwidth_rad_s
        self._pid = Pid(
            body.joint_count,
            kp=bandwidth**2,
            ki=bandwidth**2 * gains.integral_rate_1_s,
            kd=2.0 * gains.damping_ratio * bandwidth,
            output_limit=gains.acceleration_limit_rad_s2,
            derivative_filter_s=gains.derivative_filter_s,
        )

    def reset(self) -> None:
        """Forget the disturbances seen so far."""
        self._pid.reset()

    def step(
        self, measurement: Measurement, motion: JointMotion, contact_torque_nm: FloatArray, dt_s: float
    ) -> FloatArray:
        """Joint torques (n,) [N m] that follow a motion, and balance the force at the tip."""
        position, velocity = measurement.joint_position_rad, measurement.joint_velocity_rad_s
        correction = self._pid.step(motion.position_rad - position, motion.velocity_rad_s - velocity, dt_s)
        self.correction_rad_s2 = correction
        acceleration = motion.acceleration_rad_s2 + correction
        return self._body.inverse_dynamics(position, velocity, acceleration) + contact_torque_nm
