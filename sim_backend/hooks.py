"""Where a hidden effect enters the world: at the contact, at the joints, at a sensor, in the plant itself.

Effects are small objects called at each physics step or sample; they may keep a state.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

from robot_io.types import FloatArray


class ContactState(NamedTuple):
    """What happens at the tip at one physics step."""

    time_s: float  # time of the state [s]
    step_s: float  # length of a physics step [s]
    depth_m: float  # how far the tip is below the surface [m]; negative above it
    rate_m_s: float  # d(depth)/dt [m/s]


class JointState(NamedTuple):
    """What happens at the joints at one physics step."""

    time_s: float  # time of the state [s]
    step_s: float  # length of a physics step [s]
    position_rad: Sequence[float]  # n positions [rad]
    velocity_rad_s: Sequence[float]  # n velocities [rad/s]
    drive_torque_nm: Sequence[float]  # n torques that the drives were told to exert [N m]
    mass_matrix: Callable[[], FloatArray]  # gives the joint-space inertia (n, n) [kg m^2] at these positions
    # Gives the torques (n) [N m] of a motion without acceleration, in free air.
    bias_torque_nm: Callable[[], FloatArray]


class ContactEffect(ABC):
    """Changes the force between object and tip, once contact has been limited to pushing: it may pull."""

    @abstractmethod
    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """The force on the tip along the surface normal [N], given the force so far.

        Called at each physics step, in contact or not, in the order of the list; behind a compliant tool more
        than once in a step, with motions that are only tried. What is to be remembered is kept by `settle`.
        """

    def settle(self) -> None:  # noqa: B027, most effects have no memory
        """Take the last call's motion into the memory: it was the one that holds at this step."""


class MaterialEffect(ContactEffect):
    """Is a part of the object's material: it adds to the law before contact is limited to pushing."""

    def felt(self, state: ContactState) -> ContactState:
        """The motion that law and effects feel, given that of the tip; geometry that differs enters here."""
        return state

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """See `ContactEffect.contact_force_n`; below zero the material would have to pull."""
        return force_n


class ToolEffect(ABC):
    """Stands between the tip and the object."""

    @abstractmethod
    def contact_force_n(self, state: ContactState, surface_n: Callable[[ContactState], float]) -> float:
        """The force on the tip [N], where `surface_n` gives what the object answers to a motion.

        The last motion that `surface_n` is asked for is taken as the one that holds.
        """

    def settle(self) -> None:  # noqa: B027, a tool need not have a memory
        """Take the last call's motion into the memory."""


class JointEffect(ABC):
    """Changes the torque between drives and links."""

    @abstractmethod
    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        """The torques that reach the links (n) [N m], given the torques so far, along the joint axes.

        Called once at each physics step. The drive's torque sensor does not see the change, as one that
        measures motor current does not see what the bearings take.
        """

    def restart(self) -> None:  # noqa: B027, most effects have no memory
        """Forget the motion so far: the arm was put elsewhere."""


class FrictionEffect(ABC):
    """Resists the motion of joints: against it while they move, up to as much as needed while they stand.

    The engine solves for the resistance together with the motion, so that it can bring a joint to rest and
    keep it there, and never turns it round, however strong it is.
    """

    @abstractmethod
    def friction_nm(self, state: JointState, limit_nm: Sequence[float]) -> Sequence[float]:
        """The largest resistance of each joint (n) [N m], 0 or more, given the sum so far.

        Called once at each physics step. As with `JointEffect`, the drive's torque sensor does not see it.
        """


class SensorEffect(ABC):
    """Changes what a sensor makes of a sample."""

    # Whether it acts on the clean signal, as what is mechanical does; otherwise it acts on the noisy one, as
    # what is electrical does.
    ahead_of_noise: bool = False

    @abstractmethod
    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        """The sample after the effect, given the sample before resolution and range are applied.

        Called once at each sample, in the order of the list, with the time when it was taken [s] and its
        value: force (1,) [N], torques (n,) [N m] or positions (n,) [rad].
        """


class PlantEffect(ABC):  # noqa: B024, one of the two is enough
    """Changes the arm or what pulls at it, before the world begins."""

    def urdf(self, urdf_text: str, tip_frame: str) -> str:
        """The arm as it really is, given its URDF so far and its link at the contact point."""
        return urdf_text

    def gravity_m_s2(self, gravity_m_s2: Sequence[float]) -> Sequence[float]:
        """The fall acceleration in the world (3) [m/s^2] as it really is, given the one so far."""
        return gravity_m_s2


@dataclass(frozen=True)
class Effects:
    """All that is hidden in one world; the sum of two holds both, in this order."""

    contact: tuple[ContactEffect, ...] = ()  # at the contact, applied in this order
    tool: tuple[ToolEffect, ...] = ()  # between tip and object, from the object to the tip
    joint: tuple[JointEffect, ...] = ()  # at the joints, from the drives to the links
    friction: tuple[FrictionEffect, ...] = ()  # at the joints
    plant: tuple[PlantEffect, ...] = ()  # in masses and gravity
    force: tuple[SensorEffect, ...] = ()  # in the force sensor
    torque: tuple[SensorEffect, ...] = ()  # in the torque sensors
    encoder: tuple[SensorEffect, ...] = ()  # in the encoders, before the velocity is derived

    def __add__(self, other: "Effects") -> "Effects":
        return Effects(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


NO_EFFECTS = Effects()
