"""Computed torque with a PID for disturbances.

    tau = M(q) (a_ref + PID(q_ref - q, v_ref - v)) + C(q, v) v + g(q) + tau_contact

One call of the recursive Newton-Euler algorithm gives all but the last term, and the error then behaves as
a decoupled, linear oscillator on every joint. Siciliano et al., "Robotics", Springer 2009, section 8.5.2;
figure 2 of "Compliance Estimation during Bilateral Teleoperation of a Robotic Arm".
"""

import numpy as np

from control.arm.rigid_body import RigidBody
from control.laws.gains import TrackingGains
from control.laws.pid import Pid
from control.paths.motion import JointMotion
from robot_io.types import FloatArray, Measurement


class ComputedTorque:
    """Follows joint motions.

    Args:
        body: the arm's dynamics.
        gains: bandwidth, damping and integral.

    Attributes:
        correction_rad_s2: what the PID added to the accelerations in the last step, shape (n,) [rad/s^2].
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
        """Forget the disturbances seen so far."""
        self._pid.reset()

    def step(
        self, measurement: Measurement, motion: JointMotion, contact_torque_nm: FloatArray, dt_s: float
    ) -> FloatArray:
        """Joint torques, shape (n,) [N m].

        Args:
            measurement: joint positions and velocities are used.
            motion: what to follow.
            contact_torque_nm: joint torques that balance the force at the tip, shape (n,) [N m].
            dt_s: time since the last step [s].
        """
        position, velocity = measurement.joint_position_rad, measurement.joint_velocity_rad_s
        correction = self._pid.step(motion.position_rad - position, motion.velocity_rad_s - velocity, dt_s)
        self.correction_rad_s2 = correction
        acceleration = motion.acceleration_rad_s2 + correction
        return self._body.inverse_dynamics(position, velocity, acceleration) + contact_torque_nm
