"""What a physics engine must do: move one serial arm by joint torques and a force at its tip."""

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
    by semi-implicit Euler: v(n+1) = v(n) + h a(n), x(n+1) = x(n) + h v(n+1), with h the step [s]. The URDF is
    what `dynamics_urdf` makes of the robot's, and gravity is the fall acceleration in the world (3) [m/s^2].

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
        """Put the joints at n positions [rad] with n velocities [rad/s]."""

    @abstractmethod
    def joint_state(self) -> list[float]:
        """The n positions [rad] followed by the n velocities [rad/s]."""

    @abstractmethod
    def tip_state(self) -> tuple[Sequence[float], Sequence[float], Quaternion]:
        """Position [m], velocity [m/s] and orientation of the tip frame in the world, at present."""

    @abstractmethod
    def push(self, torque_nm: Sequence[float], tip_force_z_n: float, tip_position_m: Sequence[float]) -> None:
        """Apply torques (n) along the joint axes and an upward force at the tip for the next step only."""

    @abstractmethod
    def brake(self, friction_nm: Sequence[float]) -> None:
        """Resist the joints' motion with at most these torques (n) [N m], from the next step on.

        The engine solves for dry friction with the motion: it is the limit while a joint moves, and what is
        needed while it stands.
        """

    @abstractmethod
    def step(self) -> None:
        """Let h pass."""

    @abstractmethod
    def mass_matrix(self, position_rad: Sequence[float]) -> FloatArray:
        """Joint-space inertia (n, n) [kg m^2] at n positions [rad]."""

    @abstractmethod
    def inverse_dynamics(
        self,
        position_rad: Sequence[float],
        velocity_rad_s: Sequence[float],
        acceleration_rad_s2: Sequence[float],
    ) -> FloatArray:
        """Torques (n) [N m] for a motion in free air: n positions, velocities and accelerations."""

    def set_surface(self, contact: EngineContact | None, height_m: float) -> None:
        """Put a surface with a contact of the engine's own at a world height [m], or take it away.

        InputError: the engine has none.
        """
        if contact is not None:
            raise InputError(
                f"contact law '{contact.name}' is PyBullet's own contact, and engine '{self.name}' has none: "
                "use 'kelvin_voigt' or 'hunt_crossley', or engine pybullet"
            )

    def surface_force_n(self) -> float:
        """What the surface of `set_surface` pushes the tip with at present [N]."""
        return 0.0

    def close(self) -> None:  # noqa: B027, not every engine holds something
        """Free what the engine holds. Can be called again."""


def check_serial(joints: Sequence[str], towards_tip: Sequence[str]) -> None:
    """Refuse with `InputError` an arm without joints, or with joints (by name) that do not move the tip."""
    aside = [joint for joint in joints if joint not in towards_tip]
    if aside or not joints:
        names = ", ".join(aside) or "(the arm has none)"
        raise InputError(f"URDF: not a serial arm; joints that do not move the tip: {names}")
