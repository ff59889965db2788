"""What every coupling is: two sides, each stepped on its own machine, that send each other small packets.

One axis, positive into the object; three axes are three couplings. Pure: no clock, no link. A side is given
the newest packet that has arrived (in order of sending), again and again until a newer one comes; a packet
that was overtaken is dropped. So a lost packet, a late one and a repeated one all look like an old one.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

Packet = tuple[float, ...]


class Port(NamedTuple):
    """A side's own device at one time."""

    position_m: float  # of the device's tip along the axis [m]
    velocity_m_s: float  # [m/s]
    # Leader: what the hand pushes the device with, positive inwards. Follower: compression of its tool [N].
    force_n: float


class Side(ABC):
    """Leader or follower of a coupling."""

    @abstractmethod
    def step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        """One step of the control loop.

        Args:
            port: the own device now.
            newest: from the other side, None as long as nothing has arrived.
            dt_s: time until the next step, for which the force is held [s].

        Returns:
            The actuator's force on the own device [N], positive inwards, and the packet for the other side.
        """


@dataclass(frozen=True)
class Coupling:
    """A coupling by name, with how its two sides are made, ready to start."""

    name: str
    leader: Callable[[], Side]
    follower: Callable[[], Side]


@dataclass(frozen=True)
class Tracking:
    """The follower's own position control, the same for all: F = K (x_wanted - x) + B (v_wanted - v)."""

    stiffness_n_m: float = 8000.0
    damping_n_s_m: float = 120.0

    def force_n(self, ahead_m: float, faster_m_s: float) -> float:
        """Force [N] for how far the wanted motion is ahead [m] and how much faster it is [m/s]."""
        return self.stiffness_n_m * ahead_m + self.damping_n_s_m * faster_m_s


TRACKING = Tracking()
