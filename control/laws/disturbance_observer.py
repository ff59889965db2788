"""Disturbance observer: compares the force sensor with the joint torques that the model does not explain.

With M the mass matrix and n the tool's direction, the controller's correction c while following a motion
corresponds to an unmodeled torque M c. A force f on the tip, beyond what the sensor reads, explains it as
M c = J^T n f, so f = m (J^T n).c with the mass m = 1 / (n^T J M^-1 J^T n) that the tip has along n. This is
the steady-state form of a disturbance observer: Siciliano et al., "Robotics", Springer 2009, section 8.5.2
and problem 8.13.
"""

import math

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import DisturbanceObserverGains
from palpate.control.laws.hybrid import ControlOutput
from palpate.robot_io.errors import SafetyTripError
from palpate.robot_io.types import Measurement

_FREE_FILTER_S = 0.05  # time constant of the free-air baseline
_MASS_TICKS = 50  # ticks between updates of the tip's mass, in which the arm moves by millimeters
_STALL_PERIODS = 3  # after a later tick than this, the arm is off its motion
_STALL_S = 0.1  # and is not checked for this time


class DisturbanceObserver:
    """Trips when force sensor and joint torques contradict each other.

    Args:
        body: model of the arm.
        gains: threshold, filter and debounce.
        force_limit_n: force limit of the plan, of which a share is the threshold [N].
        force_feedforward: share of the measured force that the controller balances by itself.
    """

    def __init__(
        self, body: RigidBody, gains: DisturbanceObserverGains, force_limit_n: float, force_feedforward: float
    ) -> None:
        self._body = body
        self._threshold_n = gains.share * force_limit_n + gains.floor_n
        self._opposed_n = 0.5 * gains.floor_n
        self._filter_s, self._samples = gains.filter_s, gains.samples
        self._pid_share = 1.0 - force_feedforward
        self.restart()

    def restart(self) -> None:
        """Reset all state."""
        self._ticks, self._period_s = 0, math.inf
        self._mass_kg = self._stalled_s = 0.0
        self.pause()

    def pause(self) -> None:
        """Reset the free-air baseline to the disturbance of the next tick."""
        self._baseline_n = self._unread_n = math.nan
        self._sensed_n, self._count = 0.0, 0

    def update(
        self, measurement: Measurement, output: ControlOutput, dt_s: float, *, in_free_air: bool
    ) -> None:
        """Check one tick.

        Args:
            measurement: state of the arm.
            output: output of the controller in this tick.
            dt_s: time since the last tick [s].
            in_free_air: whether nothing touches the arm, so that the disturbance is due to weight and
                friction.

        Raises:
            SafetyTripError: the joint torques have contradicted the sensor for several ticks.
        """
        if self._ticks % _MASS_TICKS == 0:
            self._mass_kg = self._body.effective_mass(measurement.joint_position_rad, output.push_lever_m)
        self._ticks += 1
        unread_n = self._mass_kg * float(output.push_lever_m.dot(output.correction_rad_s2))
        unread_n -= self._pid_share * output.force_n
        if math.isnan(self._baseline_n):
            self._baseline_n, self._unread_n, self._sensed_n = unread_n, unread_n, output.force_n
        filter_share = dt_s / (dt_s + self._filter_s)
        self._unread_n += (unread_n - self._unread_n) * filter_share
        self._sensed_n += (output.force_n - self._sensed_n) * filter_share
        if in_free_air:
            self._baseline_n += (unread_n - self._baseline_n) * dt_s / (dt_s + _FREE_FILTER_S)
        unexplained_n = self._unread_n - self._baseline_n
        # With a wrong sign, the sensor reads a pull while the joints indicate a push. Both must exceed
        # half of what weight and friction may leave unexplained.
        is_opposed = self._sensed_n < -self._opposed_n and self._sensed_n + unexplained_n > self._opposed_n
        is_suspicious = abs(unexplained_n) > self._threshold_n or is_opposed
        if is_suspicious:  # unless the loop has stalled
            self._period_s = min(self._period_s, dt_s)
            is_late = dt_s > _STALL_PERIODS * self._period_s
            self._stalled_s = _STALL_S if is_late else max(self._stalled_s - dt_s, 0.0)
            is_suspicious = self._stalled_s <= 0.0
        self._count = self._count + 1 if is_suspicious else 0
        if self._count >= self._samples:
            raise SafetyTripError(
                f"the joint torques indicate about {output.force_n + unexplained_n:.1f} N, but the force "
                f"sensor reads {output.force_n:.1f} N; does the sensor work, and does anything else "
                "touch the arm?"
            )
