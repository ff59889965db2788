"""Interfaces of hidden effects in the world: at the contact, the joints, a sensor, or in the plant.

Effects are small objects called at each physics step or sample; they may keep a state.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import ClassVar, NamedTuple

from palpate.robot_io.types import FloatArray


class ContactState(NamedTuple):
    """Motion of the tip at one physics step."""

    time_s: float  # time of the state [s]
    step_s: float  # length of a physics step [s]
    depth_m: float  # depth of the tip below the surface [m]; negative above it
    rate_m_s: float  # d(depth)/dt [m/s]


class JointStepState(NamedTuple):
    """Motion of the joints at one physics step."""

    time_s: float  # time of the state [s]
    step_s: float  # length of a physics step [s]
    position_rad: Sequence[float]  # n positions [rad]
    velocity_rad_s: Sequence[float]  # n velocities [rad/s]
    drive_torque_nm: Sequence[float]  # n torques commanded to the drives [N m]
    # Returns the joint-space inertia (n, n) [kg m^2] at these positions.
    mass_matrix: Callable[[], FloatArray]
    # Returns the torques (n) [N m] of a motion without acceleration, in free air.
    bias_torque_nm: Callable[[], FloatArray]


class ContactEffect(ABC):
    """Changes the force between object and tip after the limit to pushing, so it may pull."""

    @abstractmethod
    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """Compute the force on the tip along the surface normal after the effect [N].

        Called at each physics step, with or without contact, in the order of the list. With a compliant tool
        it is called several times per step, with a solver's trial motions. `commit_state` stores the state.

        Args:
            state: motion of the tip.
            force_n: force so far [N].
        """

    def commit_state(self) -> None:  # noqa: B027, most effects have no memory
        """Store the last call's motion, which is the valid one of this step, in the memory."""


class MaterialEffect(ContactEffect):
    """Part of the object's material, added to the law before the sum is limited to pushing."""

    # Whether it acts between tip and surface, and thus not on a free surface.
    acts_on_tip: ClassVar[bool] = False

    def transform_state(self, state: ContactState) -> ContactState:
        """Compute the motion that acts on the material; a changed geometry enters here.

        Args:
            state: motion of the tip.
        """
        return state

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        return force_n


class ToolEffect(ABC):
    """Acts between the tip and the object."""

    @abstractmethod
    def contact_force_n(self, state: ContactState, surface_n: Callable[[ContactState], float]) -> float:
        """Compute the force on the tip [N].

        Args:
            state: motion of the tip.
            surface_n: returns the object's force for a motion; the last evaluated motion is the valid one.
        """

    def commit_state(self) -> None:  # noqa: B027, a tool need not have a memory
        """Store the last call's motion in the memory."""


class JointEffect(ABC):
    """Changes the torque between drives and links."""

    @abstractmethod
    def joint_torque_nm(self, state: JointStepState, torque_nm: Sequence[float]) -> Sequence[float]:
        """Compute the torques that reach the links, shape (n,) [N m]; called once at each physics step.

        The drive's torque sensor does not measure the change, just as a motor current does not include
        bearing friction.

        Args:
            state: motion of the joints.
            torque_nm: torques so far, along the joint axes, shape (n,) [N m].
        """

    def restart(self) -> None:  # noqa: B027, most effects have no memory
        """Reset the memory, because the arm was placed elsewhere."""


@dataclass(frozen=True)
class JointFriction:
    """Friction in one joint: opposes its motion, and holds it at rest up to a limit.

    The engine solves for the resistance together with the motion, so friction brings a joint to rest and
    keeps it there, and never reverses it.
    """

    index: int  # index of the joint, from 0
    # Returns the largest resistance [N m] at an absolute speed [rad/s] and a torque of the drive along the
    # motion [N m], negative if the drive brakes.
    resistance_nm: Callable[[float, float], float]

    def limit_nm(self, state: JointStepState) -> float:
        """Compute the resistance of the joint, 0 or more [N m]; called once at each physics step.

        As with `JointEffect`, the drive's torque sensor does not measure it.

        Args:
            state: motion of the joints.
        """
        velocity_rad_s, drive_nm = state.velocity_rad_s[self.index], state.drive_torque_nm[self.index]
        along_nm = abs(drive_nm) if drive_nm * velocity_rad_s >= 0.0 else -abs(drive_nm)
        return self.resistance_nm(abs(velocity_rad_s), along_nm)


class SensorHook(ABC):
    """Changes a sensor's samples."""

    # Whether it acts on the noise-free signal (mechanical effects) or on the noisy one (electrical effects).
    ahead_of_noise: bool = False

    @abstractmethod
    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        """Compute the changed sample; called once per sample, before resolution and range are applied.

        Args:
            time_s: time of the sample [s].
            value: force (1,) [N], torques (n,) [N m] or positions (n,) [rad].
        """


class PlantEffect(ABC):  # noqa: B024, one of the two is enough
    """Changes the arm or gravity before the simulation begins."""

    def urdf(self, urdf_text: str, tip_frame: str) -> str:
        """Change the arm.

        Args:
            urdf_text: URDF so far.
            tip_frame: link at the contact point.
        """
        return urdf_text

    def gravity_m_s2(self, gravity_m_s2: Sequence[float]) -> Sequence[float]:
        """Change gravity, shape (3,) [m/s^2].

        Args:
            gravity_m_s2: fall acceleration in the world so far, shape (3,) [m/s^2].
        """
        return gravity_m_s2


@dataclass(frozen=True)
class HiddenEffects:
    """Hidden effects of one world; the sum of two contains both, in this order."""

    contact: tuple[ContactEffect, ...] = ()  # at the contact, applied in this order
    tool: tuple[ToolEffect, ...] = ()  # between tip and object, from the object to the tip
    joint: tuple[JointEffect, ...] = ()  # at the joints, from the drives to the links
    friction: tuple[JointFriction, ...] = ()  # at the joints
    plant: tuple[PlantEffect, ...] = ()  # in masses and gravity
    force: tuple[SensorHook, ...] = ()  # in the force sensor
    torque: tuple[SensorHook, ...] = ()  # in the torque sensors
    encoder: tuple[SensorHook, ...] = ()  # in the encoders, before the velocity is derived

    def __add__(self, more: "HiddenEffects") -> "HiddenEffects":
        return HiddenEffects(*(getattr(self, f.name) + getattr(more, f.name) for f in fields(self)))


NO_EFFECTS = HiddenEffects()


Transducer = Callable[[float, float], float]
"""Function from (time of the sample [s], value) to another value; it may have memory."""


@dataclass(frozen=True)
class ChannelEffect(SensorHook):
    """Passes one value of a sample through a transducer."""

    index: int  # index of the value, from 0
    transducer: Transducer
    ahead_of_noise: bool

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self.index] = self.transducer(time_s, changed[self.index])
        return changed


@dataclass(frozen=True)
class AddedTorque(JointEffect):
    """Additional torque in one joint."""

    index: int  # index of the joint, from 0
    # Returns the torque [N m] at a position [rad] and a torque of the drive [N m].
    torque_nm: Callable[[float, float], float]

    def joint_torque_nm(self, state: JointStepState, torque_nm: Sequence[float]) -> Sequence[float]:
        i, changed = self.index, list(torque_nm)
        changed[i] += self.torque_nm(state.position_rad[i], state.drive_torque_nm[i])
        return changed
