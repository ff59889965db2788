"""Laws that hold a force, from what is measured and known of the object to a motion along the press line.

Two of them are adaptive control: they take for true what an online estimator has found so far, which is
handed to them (certainty equivalence); before there is an estimate it is the controller's own quick guess.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from control.laws.admittance import scheduled_admittance
from control.laws.gains import ContactGains
from control.laws.object_guess import Compliance
from control.paths.trajectory import LineState

_IMPEDANCE_N_M = 300.0  # stiffness of the impedance that tracks a force
_REFERENCE_RAD_S = 12.0  # pole of the reference model of the constant force
_FOLLOW_S = 0.01  # how fast the speed follows it


class Environment(NamedTuple):
    """The object as it is known now."""

    compliance: Compliance  # F = k x + c dx/dt
    surface_travel_m: float  # where x begins along the press line [m]


class Held(NamedTuple):
    """One tick of a hold."""

    desired_n: float  # force to hold [N]
    force_n: float  # measured [N]
    state: LineState  # reference along the press line
    known: Environment

    @property
    def error_n(self) -> float:
        """Force that lacks [N]."""
        return self.desired_n - self.force_n


HoldLaw = Callable[[Held, ContactGains, float], float]
"""Acceleration of the reference [m/s^2] over the next time step [s]."""


def _admittance(held: Held, gains: ContactGains, dt_s: float) -> float:
    """M a = F_d - F - D v, with M and D scaled to the object."""
    law = scheduled_admittance(held.known.compliance, gains)
    return law.acceleration(held.error_n, held.state.speed_m_s, dt_s)


def _force_tracking(held: Held, gains: ContactGains, dt_s: float) -> float:
    """M a + D v + K (x - x_r) = -F with x_r where this impedance comes to rest at the desired force.

    x_r = x_e + F_d / k + F_d / K: the force is right in the end as far as stiffness and surface are. Seraji
    and Colbaugh, "Force Tracking in Impedance Control", IJRR 16 (1997), indirect adaptive scheme.
    """
    stiffness_n_m, damping_n_s_m = held.known.compliance
    rest_m = held.known.surface_travel_m + held.desired_n / stiffness_n_m
    pull_n = _IMPEDANCE_N_M * (rest_m - held.state.travel_m)
    law = scheduled_admittance(Compliance(stiffness_n_m + _IMPEDANCE_N_M, damping_n_s_m), gains)
    return law.acceleration(held.error_n + pull_n, held.state.speed_m_s, dt_s)


def _constant_force(held: Held, gains: ContactGains, dt_s: float) -> float:
    """Speed v = a (F_d - F) / k: on a spring of stiffness k the force follows the model dF/dt = a (F_d - F).

    S. K. Singh, D. O. Popa, "An Analysis of Some Fundamental Problems in Adaptive Control of Force and
    Impedance Behavior", IEEE Trans. Robotics and Automation 11 (1995). On a damped object the speed is held
    below what the damper turns into the whole error.
    """
    stiffness_n_m, damping_n_s_m = held.known.compliance
    rate = stiffness_n_m / _REFERENCE_RAD_S + damping_n_s_m
    return (held.error_n / rate - held.state.speed_m_s) / (_FOLLOW_S + dt_s)


HOLD_LAWS: Mapping[str, HoldLaw] = MappingProxyType(
    {
        "admittance": _admittance,
        "force_tracking_impedance": _force_tracking,
        "constant_force": _constant_force,
    }
)
