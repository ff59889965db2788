"""Where a hidden effect enters the world: at the contact, at the joints, at a sensor.

Effects are small objects with one method, called at each physics step or sample; they may keep a state.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple


class ContactState(NamedTuple):
    """What happens at the tip at one physics step.

    Attributes:
        time_s: time of the state [s].
        step_s: length of a physics step [s].
        depth_m: how far the tip is below the surface [m]; negative above it.
        rate_m_s: d(depth)/dt [m/s].
    """

    time_s: float
    step_s: float
    depth_m: float
    rate_m_s: float


class JointState(NamedTuple):
    """What happens at the joints at one physics step.

    Attributes:
        time_s: time of the state [s].
        step_s: length of a physics step [s].
        position_rad: n positions [rad].
        velocity_rad_s: n velocities [rad/s].
    """

    time_s: float
    step_s: float
    position_rad: Sequence[float]
    velocity_rad_s: Sequence[float]


class ContactEffect(ABC):
    """Changes the force between object and tip."""

    @abstractmethod
    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """The force on the tip along the surface normal [N], given the force so far.

        Called once at each physics step, in contact or not, in the order of the list.
        """


class JointEffect(ABC):
    """Changes the torque between drives and links."""

    @abstractmethod
    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> list[float]:
        """The torques that reach the links (n) [N m], given the torques so far, along the joint axes.

        Called once at each physics step. The drive's torque sensor does not see the change, as one that
        measures motor current does not see what the bearings take.
        """


class SensorEffect(ABC):
    """Changes what a sensor makes of a sample."""

    @abstractmethod
    def measure(self, time_s: float, value: Sequence[float]) -> list[float]:
        """The sample after the effect, given the noisy sample before resolution and range are applied.

        Called once at each sample, in the order of the list.

        Args:
            time_s: when the sample was taken [s].
            value: force (1,) [N], torques (n,) [N m] or positions (n,) [rad].
        """


@dataclass(frozen=True)
class Effects:
    """All that is hidden in one world.

    Attributes:
        contact: at the contact, applied in this order.
        joint: at the joints.
        force: in the force sensor.
        torque: in the torque sensors.
        encoder: in the encoders, before the velocity is derived.
    """

    contact: tuple[ContactEffect, ...] = ()
    joint: tuple[JointEffect, ...] = ()
    force: tuple[SensorEffect, ...] = ()
    torque: tuple[SensorEffect, ...] = ()
    encoder: tuple[SensorEffect, ...] = ()


NO_EFFECTS = Effects()
