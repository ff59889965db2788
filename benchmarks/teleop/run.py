"""One run of a coupling in the world of `devices`, over the link of `link`."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from benchmarks.teleop.devices import SUBSTEP_S, HandArm, Mass, limited
from benchmarks.teleop.link import Arrived, Line, LinkFaults
from control.teleop.couplings.channel import Packet
from control.teleop.couplings.coupling import Coupling, Port

DT_S = 1e-3
SUBSTEPS = round(DT_S / SUBSTEP_S)
START_M = -0.02
FORCE_NOISE_N = 0.02
ENCODER_STEP_M = 5e-6


class Object(Protocol):
    """Anything that pushes back."""

    def push_n(self, x: float, v: float) -> float:
        """Compression [N] at depth [m] and rate [m/s]."""
        ...


class Lines(Protocol):
    """Both ways of a link."""

    def exchange(self, time_s: float, to_follower: Packet, to_leader: Packet) -> None:
        """Send one packet each way."""
        ...

    def arrived(self, time_s: float) -> tuple[Arrived, Arrived]:
        """What has come to the leader and to the follower since the last call."""
        ...


class SimulatedLink:
    """Two `Line`s."""

    def __init__(self, faults: LinkFaults, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._to_leader, self._to_follower = Line(faults, rng), Line(faults, rng)

    def exchange(self, time_s: float, to_follower: Packet, to_leader: Packet) -> None:
        self._to_follower.send(to_follower, time_s)
        self._to_leader.send(to_leader, time_s)

    def arrived(self, time_s: float) -> tuple[Arrived, Arrived]:
        return self._to_leader.arrived(time_s), self._to_follower.arrived(time_s)


@dataclass
class Trace:
    """What happened, one value a step; true values, free of sensors."""

    time_s: list[float] = field(default_factory=list)
    hand_m: list[float] = field(default_factory=list)  # the leader's device
    hand_m_s: list[float] = field(default_factory=list)
    felt_n: list[float] = field(
        default_factory=list
    )  # the leader's motor against the hand, positive outwards
    follower_m: list[float] = field(default_factory=list)
    object_n: list[float] = field(default_factory=list)  # the real object on the follower
    driven_n: list[float] = field(default_factory=list)  # the follower's motor

    def arrays(self) -> dict[str, np.ndarray]:
        """The same as arrays."""
        return {name: np.array(values) for name, values in vars(self).items()}


def run(
    coupling: Coupling,
    thing: Object,
    hand: HandArm | Callable[[float], tuple[float, float]],
    link: Lines,
    duration_s: float,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Let a hand work on an object through a coupling.

    Args:
        coupling: leader and follower.
        thing: the object.
        hand: an arm that yields to forces, or a motion (time to position and velocity) that does not.
        link: both ways.
        duration_s: how long [s].
        seed: of the force sensor's noise.

    Returns:
        The arrays of `Trace`.
    """
    noise_n = FORCE_NOISE_N * np.random.default_rng([seed, 1]).standard_normal(round(duration_s / DT_S))
    leader, follower = coupling.leader(), coupling.follower()
    channels = coupling.channel(), coupling.channel()
    device, arm, trace = Mass(0.15, 0.5, START_M), Mass(1.0, 5.0, START_M), Trace()
    led_n = 0.0
    yielding = isinstance(hand, HandArm)
    for tick, noise in enumerate(noise_n):
        time_s = tick * DT_S
        if not yielding:
            device.x, device.v = hand(time_s)
        hand_n = hand.force_n(time_s, device.x, device.v) if yielding else -led_n
        push_n = thing.push_n(arm.x, arm.v)
        for channel, packets in zip(channels, link.arrived(time_s), strict=True):
            for number, packet in packets:
                channel.take(number, packet)
        at_leader, at_follower = (channel.packet() for channel in channels)
        led_n, to_follower = leader.step(Port(_read(device.x), device.v, hand_n), at_leader, DT_S)
        driven_n, to_leader = follower.step(Port(_read(arm.x), arm.v, push_n + noise), at_follower, DT_S)
        link.exchange(time_s, to_follower, to_leader)
        led_n, driven_n = limited(led_n), limited(driven_n)
        for values, value in zip(
            vars(trace).values(), (time_s, device.x, device.v, -led_n, arm.x, push_n, driven_n), strict=True
        ):
            values.append(value)
        for substep in range(SUBSTEPS):
            if yielding:
                at_s = time_s + substep * SUBSTEP_S
                device.advance(led_n + hand.force_n(at_s, device.x, device.v), SUBSTEP_S)
            arm.advance(driven_n - thing.push_n(arm.x, arm.v), SUBSTEP_S)
    return trace.arrays()


def _read(position_m: float) -> float:
    """What an encoder shows."""
    return round(position_m / ENCODER_STEP_M) * ENCODER_STEP_M


def given_back_j(trace: dict[str, np.ndarray]) -> np.ndarray:
    """Energy that the leader's motor has given to the hand, above what it took; at each step [J].

    Everything behind that motor begins at rest: if it is passive, this never rises above zero.
    """
    return np.concatenate([[0.0], np.cumsum(-trace["felt_n"][:-1] * np.diff(trace["hand_m"]))])
