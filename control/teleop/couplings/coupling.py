"""What every coupling is: two sides, each stepped on its own machine, that send each other small packets.

One axis, positive into the object; three axes are three couplings. Pure: no clock, no link. A side is given
one packet in each step by its channel: the newest that has arrived, again and again until a newer one comes,
or each after a constant delay. So a lost packet, a late one and a repeated one all look like an old one.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from control.teleop.couplings.channel import Channel, Newest, Packet
from robot_io.errors import InputError


class Port(NamedTuple):
    """A side's own device at one time."""

    position_m: float  # of the device's tip along the axis [m]
    velocity_m_s: float  # [m/s]
    # Leader: what the hand pushes the device with, positive inwards. Follower: compression of its tool [N].
    force_n: float


class Side(ABC):
    """Leader or follower of a coupling; a new one implements `_step`."""

    def step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        """One step of the control loop.

        Args:
            port: the own device now.
            newest: from the other side, as its channel gives it; None as long as nothing has arrived.
            dt_s: time until the next step, for which the force is held [s].

        Returns:
            The actuator's force on the own device [N], positive inwards, and the packet for the other side.

        Raises:
            InputError: a value is not finite, or the time not positive; nothing has changed.
        """
        if not math.isfinite(sum(port) + sum(newest or ())) or not 0.0 < dt_s < math.inf:
            raise InputError(f"coupling: {port}, packet {newest}, step {dt_s} s: all must be finite numbers")
        return self._step(port, newest, dt_s)

    @abstractmethod
    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        """See `step`; the values are finite."""


@dataclass(frozen=True)
class Coupling:
    """A coupling by name, with how its two sides are made, ready to start."""

    name: str
    leader: Callable[[], Side]
    follower: Callable[[], Side]
    channel: Callable[[], Channel] = Newest  # one for each side


@dataclass(frozen=True)
class Tracking:
    """The follower's own position control, the same for all: F = K (x_wanted - x) + B (v_wanted - v)."""

    stiffness_n_m: float = 8000.0
    damping_n_s_m: float = 120.0

    def __post_init__(self) -> None:
        for value in (self.stiffness_n_m, self.damping_n_s_m):
            if not 0.0 <= value < math.inf:
                raise InputError(f"tracking: stiffness and damping are finite and not negative, not {value}")

    def force_n(self, ahead_m: float, faster_m_s: float) -> float:
        """Force [N] for how far the wanted motion is ahead [m] and how much faster it is [m/s]."""
        return self.stiffness_n_m * ahead_m + self.damping_n_s_m * faster_m_s


TRACKING = Tracking()
