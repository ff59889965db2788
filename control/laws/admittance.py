"""The force law in contact: a force error becomes a motion along the press line.

Holding is the admittance M dv/dt + D v = F_des - F. On an object F = k x + c v it is stable for any M, D > 0
as long as the delays are short: the fastest reaction is c / M and the slowest k / (c + D). So M is raised on
damped objects and D on stiff ones (Hogan, "Impedance Control", ASME JDSMC 107, 1985; Seraji and Colbaugh,
IJRR 16, 1997).

Loading keeps the set speed for as long as the force limit allows. Braking at a constant rate stops where the
object's spring alone reaches the limit, and on the way spring and damping together stay below it:

    v <= sqrt(2 a room / k),    v <= room / c,    room = F_limit - k x
"""

import math
from dataclasses import dataclass

from control.laws.gains import ContactGains
from control.laws.object_guess import Compliance
from robot_io.clip import clip

_OWN_DAMPING = 0.4  # of the object's damping counts; all of it would overshoot, none would creep
_FOLLOW_S = 0.004  # how fast the speed follows the braking curve
_BRAKING_RESERVE = 2.0  # times the planned or needed braking; more only against force above the limit
_LEAST_ROOM_N = 0.1
_BACK_OUT = 0.1  # of the speed limit: the fastest way back out while loading


@dataclass(frozen=True, slots=True)
class Admittance:
    """Virtual mass [kg] and damping [N s/m] between force error and speed."""

    mass_kg: float
    damping_n_s_m: float

    def acceleration(self, force_error_n: float, speed_m_s: float, dt_s: float) -> float:
        """Acceleration [m/s^2] over the next `dt_s` [s] (backward Euler, stable for any damping).

        The force error is the desired minus the measured force; positive wants to go in.
        """
        push_n = force_error_n - self.damping_n_s_m * speed_m_s
        return push_n / (self.mass_kg + self.damping_n_s_m * dt_s)


def scheduled_admittance(compliance: Compliance, gains: ContactGains) -> Admittance:
    """The admittance for an object of about this compliance."""
    stiffness_n_m, damping_n_s_m = compliance
    mass_kg = max(gains.mass_kg, damping_n_s_m / gains.reaction_rad_s)
    critical = 2.0 * gains.damping_ratio * math.sqrt(stiffness_n_m * mass_kg)
    wanted = critical - _OWN_DAMPING * damping_n_s_m
    return Admittance(mass_kg, max(wanted, gains.damping_min_n_s_m))


def loading_acceleration(
    speed_m_s: float, speed_limit_m_s: float, room_n: float, compliance: Compliance, gains: ContactGains
) -> float:
    """Acceleration [m/s^2] that presses in at the set speed (`speed_limit_m_s`) below the force limit.

    `room_n` is the force limit minus what the object's spring gives at the present depth [N].
    """
    stiffness_n_m, damping_n_s_m = compliance
    room_n -= stiffness_n_m * max(speed_m_s, 0.0) * gains.latency_s
    if room_n > 0.0:
        goal_m_s = min(speed_limit_m_s, math.sqrt(2.0 * gains.braking_m_s2 * room_n / stiffness_n_m))
        if damping_n_s_m * goal_m_s > room_n:
            goal_m_s = room_n / damping_n_s_m
    else:
        goal_m_s = max(room_n / (stiffness_n_m * _FOLLOW_S), -_BACK_OUT * speed_limit_m_s)
    excess_n = max(damping_n_s_m * speed_m_s - room_n, 0.0)
    stopping = stiffness_n_m * speed_m_s**2 / (2.0 * max(room_n, _LEAST_ROOM_N))
    hardest = _BRAKING_RESERVE * max(gains.braking_m_s2, stopping) + excess_n / gains.mass_kg
    hardest = min(hardest, gains.yielding_m_s2)
    change = (goal_m_s - speed_m_s) / _FOLLOW_S
    return clip(change, -hardest, gains.braking_m_s2)
