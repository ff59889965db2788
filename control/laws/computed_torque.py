"""Computed torque with a PID for disturbances.

    tau = M(q) (a_ref + PID(q_ref - q, v_ref - v)) + C(q, v) v + g(q) + tau_contact

One call of the recursive Newton-Euler algorithm gives all but the last term, and the error then behaves as
a decoupled, linear oscillator on every joint. Siciliano et al., "Robotics", Springer 2009, section 8.5.2;
figure 2 of "Compliance Estimation during Bilateral Teleoperation of a Robotic Arm".
"""

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import TrackingGains
from palpate.control.paths.trajectory import JointMotion
from palpate.robot_io.types import FloatArray, Measurement, clip


class Pid:
    """PID controller with filtered derivative and limited output: kp e + ki integral(e) + kd filtered(de/dt).

    The derivative passes a first-order low-pass (backward Euler). A joint's integral is held while
    its output is limited and the error would increase it (conditional integration).

    Args:
        joint_count: number of joints n.
        kp: proportional gain [output/rad].
        ki: integral gain [output/(rad s)].
        kd: derivative gain [output s/rad].
        output_limit: largest output of either sign.
        derivative_filter_s: time constant of the low-pass [s], 0 for none.

    Source: Astrom and Murray, "Feedback Systems", Princeton 2008, section 10.4.
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
        self._kp, self._ki, self._kd = kp, ki, kd
        self._limit = output_limit
        self._filter_s = derivative_filter_s
        self._joint_count = joint_count
        self.reset()

    @property
    def integral(self) -> FloatArray:
        """Integral part of the output, shape (n,)."""
        return np.array(self._integral)

    def reset(self) -> None:
        """Clear integral and derivative."""
        # Multiplied by ki, so that a change of the gain causes no step.
        self._integral = [0.0] * self._joint_count
        self._rate = [0.0] * self._joint_count

    def step(self, error_rad: FloatArray, error_rate_rad_s: FloatArray, dt_s: float) -> FloatArray:
        """Compute the output for one step, shape (n,).

        Args:
            error_rad: reference minus measured position, shape (n,) [rad].
            error_rate_rad_s: rate of the error, shape (n,) [rad/s].
            dt_s: length of the step [s].
        """
        filter_share = dt_s / (dt_s + self._filter_s)
        kp, ki_dt, kd, limit = self._kp, self._ki * dt_s, self._kd, self._limit
        output: list[float] = []  # for few joints, a loop is several times faster than arrays
        errors = zip(error_rad.tolist(), error_rate_rad_s.tolist(), self._rate, self._integral, strict=True)
        for joint, (error, error_rate, last_rate, integral) in enumerate(errors):
            self._rate[joint] = rate = last_rate + (error_rate - last_rate) * filter_share
            growth = error * ki_dt
            unlimited = kp * error + kd * rate + integral + growth
            limited = clip(unlimited, -limit, limit)
            if not (unlimited - limited) * growth > 0.0:
                self._integral[joint] = integral + growth
            output.append(limited)
        return np.array(output)


class ComputedTorque:
    """Computed torque with PID feedback, which follows joint motions.

    Args:
        body: model of the arm.
        gains: gains of the feedback.

    Attributes:
        correction_rad_s2: acceleration that the PID added in the last step, shape (n,) [rad/s^2].
    """

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
        """Clear the feedback's integral and derivative."""
        self._pid.reset()

    def step(
        self, measurement: Measurement, motion: JointMotion, contact_torque_nm: FloatArray, dt_s: float
    ) -> FloatArray:
        """Compute torques that follow a motion and balance the force at the tip, shape (n,) [N m].

        Args:
            measurement: state of the arm.
            motion: reference of the joints.
            contact_torque_nm: torque that balances the contact force, shape (n,) [N m].
            dt_s: length of the step [s].
        """
        position, velocity = measurement.joint_position_rad, measurement.joint_velocity_rad_s
        correction = self._pid.step(motion.position_rad - position, motion.velocity_rad_s - velocity, dt_s)
        self.correction_rad_s2 = correction
        acceleration = motion.acceleration_rad_s2 + correction
        return self._body.inverse_dynamics(position, velocity, acceleration) + contact_torque_nm
