"""Interface of a physics engine: one serial arm, moved by joint torques and a force at its tip."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from robot_io.errors import InputError
from robot_io.types import FloatArray
from sim_backend.contact_laws import EngineContact

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # (x, y, z, w)


class Engine(ABC):
    """A serial arm of revolute and prismatic joints, its base fixed at the world's origin.

    Kinematics and dynamics are the engine's own; every loss that it would add by itself is off. It integrates
    by semi-implicit Euler: v(n+1) = v(n) + h a(n), x(n+1) = x(n) + h v(n+1), with h the step [s].

    Args:
        urdf_text: made by `dynamics_urdf`.
        tip_frame: link whose motion counts.
        step_s: step h [s].
        gravity_m_s2: fall acceleration in the world, shape (3,) [m/s^2].

    Raises:
        InputError: the engine cannot load the URDF, or it is not a serial arm that ends at the tip frame.
    """

    name: ClassVar[str]  # what a scenario calls it

    torque_limit_nm: list[float]  # largest torque of each drive, the URDF's effort limits (n) [N m]

    @abstractmethod
    def __init__(
        self, urdf_text: str, tip_frame: str, *, step_s: float, gravity_m_s2: Sequence[float]
    ) -> None: ...

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self.torque_limit_nm)

    @abstractmethod
    def place(self, position_rad: Sequence[float], velocity_rad_s: Sequence[float]) -> None:
        """Set positions and velocities of the joints.

        Args:
            position_rad: shape (n,) [rad].
            velocity_rad_s: shape (n,) [rad/s].
        """

    @abstractmethod
    def joint_state(self) -> list[float]:
        """Return the n positions [rad] followed by the n velocities [rad/s]."""

    @abstractmethod
    def tip_state(self) -> tuple[Sequence[float], Sequence[float], Quaternion]:
        """Return position [m], velocity [m/s] and orientation of the tip frame in the world."""

    @abstractmethod
    def push(self, torque_nm: Sequence[float], tip_force_z_n: float, tip_position_m: Sequence[float]) -> None:
        """Apply torques and an upward force at the tip for the next step only.

        Args:
            torque_nm: along the joint axes, shape (n,) [N m].
            tip_force_z_n: upwards [N].
            tip_position_m: of the tip in the world, shape (3,) [m].
        """

    @abstractmethod
    def brake(self, friction_nm: Sequence[float]) -> None:
        """Resist the joints' motion by dry friction from the next step on.

        The engine solves for friction with the motion: it is the limit while a joint moves, and what is
        needed while it stands.

        Args:
            friction_nm: largest torques, shape (n,) [N m].
        """

    @abstractmethod
    def step(self) -> None:
        """Integrate one step."""

    @abstractmethod
    def mass_matrix(self, position_rad: Sequence[float]) -> FloatArray:
        """Compute the joint-space inertia.

        Args:
            position_rad: shape (n,) [rad].

        Returns:
            Shape (n, n) [kg m^2].
        """

    @abstractmethod
    def inverse_dynamics(
        self,
        position_rad: Sequence[float],
        velocity_rad_s: Sequence[float],
        acceleration_rad_s2: Sequence[float],
    ) -> FloatArray:
        """Compute the torques of a motion in free air.

        Args:
            position_rad: shape (n,) [rad].
            velocity_rad_s: shape (n,) [rad/s].
            acceleration_rad_s2: shape (n,) [rad/s^2].

        Returns:
            Shape (n,) [N m].
        """

    def set_surface(self, contact: EngineContact | None, height_m: float) -> None:
        """Put a surface with the engine's own contact into the world, or take it away.

        Args:
            contact: stiffness and damping; None to take the surface away.
            height_m: world height of the surface [m].

        Raises:
            InputError: the engine has no contact of its own.
        """
        if contact is not None:
            raise InputError(
                f"contact law '{contact.name}' is PyBullet's own contact, and engine '{self.name}' has none: "
                "use 'kelvin_voigt' or 'hunt_crossley', or engine pybullet"
            )

    def surface_force_n(self) -> float:
        """Return the force of the surface of `set_surface` on the tip [N]."""
        return 0.0

    def close(self) -> None:  # noqa: B027, not every engine holds something
        """Free resources; can be called again."""


def check_serial(joints: Sequence[str], towards_tip: Sequence[str]) -> None:
    """Check that an arm is serial.

    Args:
        joints: names of all joints.
        towards_tip: names of the joints that move the tip.

    Raises:
        InputError: the arm has no joints, or joints that do not move the tip.
    """
    aside = [joint for joint in joints if joint not in towards_tip]
    if aside or not joints:
        names = ", ".join(aside) or "(the arm has none)"
        raise InputError(f"URDF: not a serial arm; joints that do not move the tip: {names}")
