"""The world that couplings are tried in, on one axis: hand, leader's device, follower's arm, object.

Nothing here shares code with what renders forces (control/teleop). Positions are positive into the object,
whose surface is at 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

SUBSTEP_S = 0.25e-3
DEVICE_LIMIT_N = 60.0  # of both devices' motors
WALL_M = 0.25  # neither device goes further


@dataclass(frozen=True)
class SpringDamper:
    """F = k x + c v, never pulling."""

    k: float
    c: float

    def push_n(self, x: float, v: float) -> float:
        """Compression [N] at depth `x` [m] and rate `v` [m/s]."""
        return max(0.0, self.k * x + self.c * v) if x > 0.0 else 0.0


@dataclass(frozen=True)
class SoftSphere:
    """F = h x^n (1 + d v), never pulling: stiffens with depth, loses energy as it is compressed."""

    h: float
    d: float
    n: float

    def push_n(self, x: float, v: float) -> float:
        """Compression [N] at depth `x` [m] and rate `v` [m/s]."""
        return self.h * math.pow(x, self.n) * max(0.0, 1.0 + self.d * v) if x > 0.0 else 0.0


@dataclass
class Mass:
    """A mass on a rail with friction, between two walls."""

    mass_kg: float
    friction_n_s_m: float
    x: float
    v: float = 0.0

    def advance(self, force_n: float, dt_s: float) -> None:
        """Semi-implicit Euler over one substep."""
        self.v += dt_s * (force_n - self.friction_n_s_m * self.v) / self.mass_kg
        self.x += dt_s * self.v
        if abs(self.x) > WALL_M:
            self.x, self.v = math.copysign(WALL_M, self.x), 0.0


@dataclass(frozen=True)
class HandArm:
    """Spring and damper of a human arm towards where it wants to be (de Vlugt et al., Biol. Cybern. 2002)."""

    plan: Callable[[float], tuple[float, float]]  # time [s] to position [m] and velocity [m/s]
    stiffness_n_m: float = 600.0
    damping_n_s_m: float = 12.0

    def force_n(self, time_s: float, x: float, v: float) -> float:
        """Push on the device [N]."""
        wanted_m, wanted_m_s = self.plan(time_s)
        return self.stiffness_n_m * (wanted_m - x) + self.damping_n_s_m * (wanted_m_s - v)


def limited(force_n: float) -> float:
    """What a device's motor gives."""
    return max(-DEVICE_LIMIT_N, min(DEVICE_LIMIT_N, force_n))


def presses(
    depth_m: float, clear_m: float, times_s: tuple[tuple[float, float], ...], ramp_s: float = 0.5
) -> Callable[[float], tuple[float, float]]:
    """A plan: `depth_m` inside between each pair of times, `clear_m` outside otherwise; smooth ramps."""

    def plan(time_s: float) -> tuple[float, float]:
        share = rate = 0.0
        for begin_s, end_s in times_s:
            for at_s, sign in ((begin_s, 1.0), (end_s, -1.0)):
                u = min(1.0, max(0.0, (time_s - at_s) / ramp_s))
                share += sign * u * u * (3.0 - 2.0 * u)
                rate += sign * 6.0 * u * (1.0 - u) / ramp_s
        way_m = depth_m + clear_m
        return -clear_m + way_m * share, way_m * rate

    return plan
