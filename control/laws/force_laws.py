"""Force laws in contact: a force error becomes a motion along the press line.

Holding is the admittance M dv/dt + D v = F_des - F. On an object F = k x + c v it is stable for any M, D > 0
as long as the delays are short: the fastest reaction is c / M and the slowest k / (c + D). So M is raised on
damped objects and D on stiff ones (Hogan, "Impedance Control", ASME JDSMC 107, 1985; Seraji and Colbaugh,
IJRR 16, 1997).

Loading keeps the set speed as long as the force limit allows. Braking at a constant rate stops where the
object's spring alone reaches the limit, and on the way spring and damping together stay below it:

    v <= sqrt(2 a room / k),    v <= room / c,    room = F_limit - k x

Two hold laws are adaptive: they use the estimate of an online estimator as if it were true (certainty
equivalence). Before its first estimate they use that of the controller's `QuickEstimator`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from palpate.control.laws.gains import ContactGains
from palpate.control.paths.trajectory import LineState
from palpate.robot_io.types import clip

_STIFFNESS_BOUNDS_N_M = (50.0, 30_000.0)
_DAMPING_BOUNDS_N_S_M = (0.0, 400.0)
_STIFFNESS_SPREAD_N_M = 3000.0  # standard deviation before the first sample
_DAMPING_SPREAD_N_S_M = 100.0
_FORCE_NOISE_N = 0.05
_MEMORY_N = 3.0  # change of the spring's force over which older samples fade
_MIN_SPEED_M_S = 0.002  # slower samples are ignored


class Compliance(NamedTuple):
    """Stiffness [N/m] and damping [N s/m] of an object, F = k x + c dx/dt."""

    stiffness_n_m: float
    damping_n_s_m: float


def within_bounds(compliance: Compliance) -> Compliance:
    """Clip a compliance to the range in which the force laws are stable.

    Args:
        compliance: stiffness, clipped to 50 to 30,000 N/m, and damping, clipped to 0 to 400 N s/m.
    """
    stiffness_n_m, damping_n_s_m = compliance
    return Compliance(
        clip(stiffness_n_m, *_STIFFNESS_BOUNDS_N_M), clip(damping_n_s_m, *_DAMPING_BOUNDS_N_S_M)
    )


class QuickEstimator:
    """Recursive least squares of force = k depth + c speed, with forgetting, in plain floats.

    Source: Ljung and Soderstrom, "Theory and Practice of Recursive Identification", MIT Press 1983, section
    2.2.

    Attributes:
        compliance: the estimate, within bounds.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Reset the estimate."""
        self._k = self._c = self._p_kc = 0.0
        self._p_kk, self._p_cc = _STIFFNESS_SPREAD_N_M**2, _DAMPING_SPREAD_N_S_M**2
        self.compliance = within_bounds(Compliance(self._k, self._c))

    def update(self, depth_m: float, speed_m_s: float, force_n: float, dt_s: float) -> None:
        """Update the estimate with one sample; samples slower than 2 mm/s are ignored.

        Args:
            depth_m: travel since the touch, positive into the object [m].
            speed_m_s: positive into the object [m/s].
            force_n: positive in compression [N].
            dt_s: time since the last sample [s].
        """
        if abs(speed_m_s) < _MIN_SPEED_M_S:
            return
        gain_k = self._p_kk * depth_m + self._p_kc * speed_m_s
        gain_c = self._p_kc * depth_m + self._p_cc * speed_m_s
        forget = math.exp(-self.compliance.stiffness_n_m * abs(speed_m_s) * dt_s / _MEMORY_N)
        spread = forget * _FORCE_NOISE_N**2 + depth_m * gain_k + speed_m_s * gain_c
        error_n = force_n - self._k * depth_m - self._c * speed_m_s
        self._k += gain_k * error_n / spread
        self._c += gain_c * error_n / spread
        # The spread is limited to its initial value, because forgetting would inflate it without bound.
        self._p_kk = min((self._p_kk - gain_k**2 / spread) / forget, _STIFFNESS_SPREAD_N_M**2)
        self._p_cc = min((self._p_cc - gain_c**2 / spread) / forget, _DAMPING_SPREAD_N_S_M**2)
        bound = math.sqrt(max(self._p_kk * self._p_cc, 0.0))
        self._p_kc = clip((self._p_kc - gain_k * gain_c / spread) / forget, -bound, bound)
        self.compliance = within_bounds(Compliance(self._k, self._c))


_DAMPING_SHARE = 0.4  # used share of the object's damping; all of it would overshoot, none would creep
_FOLLOW_S = 0.004  # time constant with which the speed follows the braking curve
_BRAKING_RESERVE = 2.0  # multiple of the planned or needed braking; more only if the force exceeds the limit
_MIN_ROOM_N = 0.1
_MAX_OUTWARD = 0.1  # largest outward speed while loading, as a share of the speed limit


@dataclass(frozen=True, slots=True)
class Admittance:
    """Virtual mass [kg] and damping [N s/m] between force error and speed."""

    mass_kg: float
    damping_n_s_m: float

    def acceleration(self, force_error_n: float, speed_m_s: float, dt_s: float) -> float:
        """Compute the acceleration over the next step, by backward Euler, which is stable [m/s^2].

        Args:
            force_error_n: desired minus measured force [N]; positive moves into the object.
            speed_m_s: speed of the reference, positive into the object [m/s].
            dt_s: length of the step [s].
        """
        push_n = force_error_n - self.damping_n_s_m * speed_m_s
        return push_n / (self.mass_kg + self.damping_n_s_m * dt_s)


def scheduled_admittance(compliance: Compliance, gains: ContactGains) -> Admittance:
    """Choose virtual mass and damping for an object, with the damping ratio of the gains.

    Args:
        compliance: compliance of the object, or an estimate of it.
        gains: gains of the force law.
    """
    stiffness_n_m, damping_n_s_m = compliance
    mass_kg = max(gains.mass_kg, damping_n_s_m / gains.reaction_rad_s)
    critical = 2.0 * gains.damping_ratio * math.sqrt(stiffness_n_m * mass_kg)
    return Admittance(mass_kg, max(critical - _DAMPING_SHARE * damping_n_s_m, gains.damping_min_n_s_m))


def loading_acceleration(
    speed_m_s: float, speed_limit_m_s: float, room_n: float, compliance: Compliance, gains: ContactGains
) -> float:
    """Compute the acceleration for loading at the set speed below the force limit [m/s^2].

    Args:
        speed_m_s: speed of the reference, positive into the object [m/s].
        speed_limit_m_s: set speed [m/s].
        room_n: force limit minus the force of the object's spring at the present depth [N].
        compliance: compliance of the object.
        gains: gains of the force law.
    """
    stiffness_n_m, damping_n_s_m = compliance
    room_n -= stiffness_n_m * max(speed_m_s, 0.0) * gains.latency_s
    if room_n > 0.0:
        goal_m_s = min(speed_limit_m_s, math.sqrt(2.0 * gains.braking_m_s2 * room_n / stiffness_n_m))
        if damping_n_s_m * goal_m_s > room_n:
            goal_m_s = room_n / damping_n_s_m
    else:
        goal_m_s = max(room_n / (stiffness_n_m * _FOLLOW_S), -_MAX_OUTWARD * speed_limit_m_s)
    excess_n = max(damping_n_s_m * speed_m_s - room_n, 0.0)
    stopping = stiffness_n_m * speed_m_s**2 / (2.0 * max(room_n, _MIN_ROOM_N))
    max_braking_m_s2 = _BRAKING_RESERVE * max(gains.braking_m_s2, stopping) + excess_n / gains.mass_kg
    max_braking_m_s2 = min(max_braking_m_s2, gains.yielding_m_s2)
    return clip((goal_m_s - speed_m_s) / _FOLLOW_S, -max_braking_m_s2, gains.braking_m_s2)


_IMPEDANCE_N_M = 300.0  # stiffness of the impedance that tracks a force
_REFERENCE_RAD_S = 12.0  # pole of the reference model of the constant force
_HOLD_FOLLOW_S = 0.01  # time constant with which the speed follows it


class Environment(NamedTuple):
    """Current estimate of the object."""

    compliance: Compliance  # F = k x + c dx/dt
    surface_travel_m: float  # position of x = 0 along the press line [m]


class HoldState(NamedTuple):
    """Forces and reference in one tick of a hold."""

    desired_n: float  # force to hold [N]
    force_n: float  # measured [N]
    state: LineState  # reference along the press line
    environment: Environment

    @property
    def error_n(self) -> float:
        """Desired minus measured force [N]."""
        return self.desired_n - self.force_n


HoldLaw = Callable[[HoldState, ContactGains, float], float]
"""Acceleration of the reference [m/s^2] over the next time step [s]."""


def _admittance(hold: HoldState, gains: ContactGains, dt_s: float) -> float:
    """Compute a from M a = F_d - F - D v, with M and D scaled to the object."""
    law = scheduled_admittance(hold.environment.compliance, gains)
    return law.acceleration(hold.error_n, hold.state.speed_m_s, dt_s)


def _tracking(hold: HoldState, gains: ContactGains, dt_s: float) -> float:
    """Compute a from M a + D v + K (x - x_r) = -F, where x_r gives the desired force at rest.

    x_r = x_e + F_d / k + F_d / K, so the final force is as accurate as the estimates of stiffness and
    surface. Seraji and Colbaugh, "Force Tracking in Impedance Control", IJRR 16 (1997), indirect adaptive
    scheme.
    """
    stiffness_n_m, damping_n_s_m = hold.environment.compliance
    rest_m = hold.environment.surface_travel_m + hold.desired_n / stiffness_n_m
    pull_n = _IMPEDANCE_N_M * (rest_m - hold.state.travel_m)
    law = scheduled_admittance(Compliance(stiffness_n_m + _IMPEDANCE_N_M, damping_n_s_m), gains)
    return law.acceleration(hold.error_n + pull_n, hold.state.speed_m_s, dt_s)


def _constant_force(hold: HoldState, gains: ContactGains, dt_s: float) -> float:
    """Track the speed v = a (F_d - F) / k, so that on a spring of stiffness k dF/dt = a (F_d - F).

    S. K. Singh, D. O. Popa, "An Analysis of Some Fundamental Problems in Adaptive Control of Force and
    Impedance Behavior", IEEE Trans. Robotics and Automation 11 (1995). On a damped object the speed is
    limited so that the damper's force does not exceed the error.
    """
    stiffness_n_m, damping_n_s_m = hold.environment.compliance
    rate = stiffness_n_m / _REFERENCE_RAD_S + damping_n_s_m
    return (hold.error_n / rate - hold.state.speed_m_s) / (_HOLD_FOLLOW_S + dt_s)


HOLD_LAWS: Mapping[str, HoldLaw] = MappingProxyType(
    {"admittance": _admittance, "force_tracking_impedance": _tracking, "constant_force": _constant_force}
)
