"""Couplings between a leader and a follower on one simulated axis.

A hand holds the leader's device, the follower's arm meets an object, and a link in one process delays,
jitters and loses packets each way. Nothing here shares code with what renders forces.
Positions are positive into the object, whose surface is at 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.teleop_couplings import Coupling, DevicePort, Packet
from benchmarks.teleop_link import DelayLine, LinkFaults

DT_S = 1e-3
SUBSTEP_S = 0.25e-3
SUBSTEPS = round(DT_S / SUBSTEP_S)
DEVICE_LIMIT_N = 60.0  # of both devices' motors
WALL_M = 0.25  # neither device goes further
START_M = -0.02
FORCE_NOISE_N = 0.02
ENCODER_STEP_M = 5e-6


@dataclass(frozen=True)
class SpringDamper:
    """F = k x + c v, never pulling."""

    k: float
    c: float

    def push_n(self, x: float, v: float) -> float:
        """Compression [N] at depth `x` [m] and rate `v` [m/s]."""
        return max(0.0, self.k * x + self.c * v) if x > 0.0 else 0.0


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


class SimulatedLink:
    """A link with the same faults in both directions."""

    def __init__(self, faults: LinkFaults, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._to_leader, self._to_follower = DelayLine(faults, rng), DelayLine(faults, rng)

    def exchange(self, time_s: float, to_follower: Packet, to_leader: Packet) -> None:
        """Send one packet in each direction at `time_s` [s]."""
        self._to_follower.send(to_follower, time_s)
        self._to_leader.send(to_leader, time_s)

    def arrived(self, time_s: float) -> tuple[list[tuple[int, Packet]], list[tuple[int, Packet]]]:
        """Packets that have come to the leader and to the follower by `time_s` [s], each with its number."""
        return self._to_leader.arrived(time_s), self._to_follower.arrived(time_s)


# True values of each step, free of sensors: felt is the leader's motor against the hand, positive outwards;
# driven is the follower's motor.
TRACE = ("time_s", "hand_m", "hand_m_s", "felt_n", "follower_m", "object_n", "driven_n")


def run(
    coupling: Coupling,
    thing: SpringDamper,
    hand: HandArm,
    link: SimulatedLink,
    duration_s: float,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Let a hand work on an object through a coupling.

    Args:
        coupling: leader and follower.
        thing: the object.
        hand: the operator's arm, which yields to forces.
        link: both ways.
        duration_s: how long [s].
        seed: of the force sensor's noise.

    Returns:
        The columns of `TRACE`, one value a step.
    """
    noise_n = FORCE_NOISE_N * np.random.default_rng([seed, 1]).standard_normal(round(duration_s / DT_S))
    leader, follower = coupling.leader(), coupling.follower()
    channels = coupling.channel(), coupling.channel()
    device, arm, rows = Mass(0.15, 0.5, START_M), Mass(1.0, 5.0, START_M), []
    for tick, noise in enumerate(noise_n):
        time_s = tick * DT_S
        hand_n, push_n = hand.force_n(time_s, device.x, device.v), thing.push_n(arm.x, arm.v)
        for channel, packets in zip(channels, link.arrived(time_s), strict=True):
            for number, packet in packets:
                channel.take(number, packet)
        at_leader, at_follower = (channel.packet() for channel in channels)
        led_n, to_follower = leader.step(DevicePort(_read(device.x), device.v, hand_n), at_leader, DT_S)
        at_arm = DevicePort(_read(arm.x), arm.v, push_n + noise)
        driven_n, to_leader = follower.step(at_arm, at_follower, DT_S)
        link.exchange(time_s, to_follower, to_leader)
        led_n, driven_n = limited(led_n), limited(driven_n)
        rows.append((time_s, device.x, device.v, -led_n, arm.x, push_n, driven_n))
        for substep in range(SUBSTEPS):
            at_s = time_s + substep * SUBSTEP_S
            device.advance(led_n + hand.force_n(at_s, device.x, device.v), SUBSTEP_S)
            arm.advance(driven_n - thing.push_n(arm.x, arm.v), SUBSTEP_S)
    return dict(zip(TRACE, np.array(rows).T, strict=True))


def _read(position_m: float) -> float:
    """What an encoder shows."""
    return round(position_m / ENCODER_STEP_M) * ENCODER_STEP_M


def returned_energy_j(trace: dict[str, np.ndarray]) -> np.ndarray:
    """Energy that the leader's motor has given to the hand, above what it took; at each step [J].

    Everything behind that motor begins at rest: if it is passive, this never rises above zero.
    """
    return np.concatenate([[0.0], np.cumsum(-trace["felt_n"][:-1] * np.diff(trace["hand_m"]))])
