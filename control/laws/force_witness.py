"""The second witness of the contact force: what the joints need beyond their model and the force sensor.

With M the mass matrix and n the tool's direction, the controller's correction c of a motion that is followed
stands for a torque M c that nobody expected. A force f on the tip, beyond what the sensor says, explains it
as M c = J^T n f, so f = m (J^T n).c with the mass m = 1 / (n^T J M^-1 J^T n) that the tip has along n. The
inverse dynamics of the controller are the model; nothing is computed twice. It is the stationary form of a
disturbance observer, Siciliano et al., "Robotics", Springer 2009, section 8.5.2 and problem 8.13.
"""

import math

from control.arm.rigid_body import RigidBody
from control.laws.gains import WitnessGains
from control.laws.hybrid import ControlOutput
from robot_io.errors import SafetyTripError
from robot_io.types import Measurement

_FREE_FILTER_S = 0.05  # in free air what weight and friction leave unexplained is learnt within this
_MASS_TICKS = 50  # the arm moves by millimetres meanwhile
_STALL_PERIODS = 3  # a tick so late leaves the arm off its motion,
_STALL_S = 0.1  # which proves nothing for so long


class ForceWitness:
    """Compares the force sensor with the joint torques, tick after tick.

    A share of the plan's force limit is the threshold. The controller balances `force_feedforward` of the
    measured force by itself.
    """

    def __init__(
        self, body: RigidBody, gains: WitnessGains, force_limit_n: float, force_feedforward: float
    ) -> None:
        self._body = body
        self._threshold_n = gains.share * force_limit_n + gains.floor_n
        self._opposed_n = 0.5 * gains.floor_n
        self._filter_s, self._samples = gains.filter_s, gains.samples
        self._left_to_pid = 1.0 - force_feedforward
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._ticks, self._period_s = 0, math.inf
        self._mass_kg = self._stalled_s = 0.0
        self.pause()

    def pause(self) -> None:
        """Forget what was learnt in free air: what is unexplained at the next look counts as free air."""
        self._free_n = self._beyond_n = math.nan
        self._sensed_n, self._count = 0.0, 0

    def watch(
        self, measurement: Measurement, output: ControlOutput, dt_s: float, *, in_free_air: bool
    ) -> None:
        """Judge one tick; in free air nothing but the arm itself can be what is not explained.

        SafetyTripError: for several ticks the joint torques have said something else than the sensor.
        """
        if self._ticks % _MASS_TICKS == 0:
            self._mass_kg = self._body.mass_along(measurement.joint_position_rad, output.push_lever_m)
        self._ticks += 1
        beyond_n = self._mass_kg * float(output.push_lever_m.dot(output.correction_rad_s2))
        beyond_n -= self._left_to_pid * output.force_n
        if math.isnan(self._free_n):
            self._free_n, self._beyond_n, self._sensed_n = beyond_n, beyond_n, output.force_n
        share = dt_s / (dt_s + self._filter_s)
        self._beyond_n += (beyond_n - self._beyond_n) * share
        self._sensed_n += (output.force_n - self._sensed_n) * share
        if in_free_air:
            self._free_n += (beyond_n - self._free_n) * dt_s / (dt_s + _FREE_FILTER_S)
        unexplained_n = self._beyond_n - self._free_n
        contradicted = abs(unexplained_n) > self._threshold_n or self._is_opposed(unexplained_n)
        suspicious = contradicted and not self._is_stalled(dt_s)
        self._count = self._count + 1 if suspicious else 0
        if self._count >= self._samples:
            raise SafetyTripError(
                f"joint torques say about {output.force_n + unexplained_n:.1f} N where the force sensor says "
                f"{output.force_n:.1f} N: is the sensor alive, and does nothing else touch the arm?"
            )

    def _is_opposed(self, unexplained_n: float) -> bool:
        """Whether the sensor says pull and the joints say push, as where its sign is wrong.

        Each must say it louder than half of what weight and friction may leave unexplained: a push that small
        and a pull that small can be both at once, on something sticky.
        """
        return self._sensed_n < -self._opposed_n and self._sensed_n + unexplained_n > self._opposed_n

    def _is_stalled(self, dt_s: float) -> bool:
        self._period_s = min(self._period_s, dt_s)
        self._stalled_s = max(self._stalled_s - dt_s, 0.0)
        if dt_s > _STALL_PERIODS * self._period_s:
            self._stalled_s = _STALL_S
        return self._stalled_s > 0.0
