"""Interface of physics engines, with one serial arm driven by joint torques and a force at its tip."""

import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import scipy

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.urdf_text import joints_to_root, linked_name, parse_urdf
from palpate.robot_io.types import FloatArray
from palpate.sim_backend.contact_laws.standard import EngineContact


def dynamics_urdf(
    urdf_text: str,
    tip_frame: str,
    *,
    mass_scale: float = 1.0,
    tip_radius_m: float,
    sensor_axis_tip: Sequence[float],
) -> str:
    """Reduce a URDF to the engine's: without visuals, meshes and shapes, with a sphere behind the tip.

    The sphere touches a surface with the tip frame's origin. It is a shape of the last moving link, because
    PyBullet lets links behind a fixed joint pass through static bodies. A link without <inertial> gets no
    mass, as URDF specifies; PyBullet would give it 1 kg.

    Args:
        urdf_text: the robot's URDF.
        tip_frame: link whose origin is the contact point.
        mass_scale: factor on all masses and inertias [-].
        tip_radius_m: radius of the sphere [m].
        sensor_axis_tip: unit vector in the tip frame along which the tool pushes.

    Raises:
        InputError: the text is not a URDF, has an invalid number, or lacks the link of the tip frame.
    """
    try:
        robot = parse_urdf(urdf_text)
        _reduce(robot, tip_frame, mass_scale, -tip_radius_m * np.asarray(sensor_axis_tip))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"URDF: {error}") from error
    return ET.tostring(robot, encoding="unicode")


def _reduce(robot: ET.Element, tip_frame: str, mass_scale: float, behind_tip_m: FloatArray) -> None:
    if not robot.get("name"):
        raise InputError("URDF: <robot> has no name")
    links = {link.get("name", ""): link for link in robot.findall("link")}
    if tip_frame not in links:
        raise InputError(f"URDF: no link '{tip_frame}' for tip_frame. Valid: {', '.join(sorted(links))}")
    for link in links.values():
        for child in list(link):
            if child.tag != "inertial":
                link.remove(child)
        inertial = link.find("inertial")
        if inertial is None:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "mass", value="0")
            ET.SubElement(inertial, "inertia", ixx="0", ixy="0", ixz="0", iyy="0", iyz="0", izz="0")
        for element in (*inertial.iter("mass"), *inertial.iter("inertia")):
            for key, value in element.attrib.items():
                element.set(key, repr(float(value) * mass_scale))
    carrier, center = tip_frame, behind_tip_m  # in the nearest ancestor that is moved by a joint
    for joint in joints_to_root(robot, tip_frame):
        if joint.get("type") != "fixed":
            break
        origin = joint.find("origin")
        if origin is not None:
            xyz, rpy = (
                [float(number) for number in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy")
            )
            if any(rpy):  # importing scipy.spatial takes long
                center = scipy.spatial.transform.Rotation.from_euler("xyz", rpy).apply(center)
            center = center + xyz
        carrier = linked_name(joint, "parent")
    sphere = ET.SubElement(links[carrier], "collision")
    ET.SubElement(sphere, "origin", xyz=" ".join(map(repr, center.tolist())), rpy="0 0 0")
    radius = repr(float(np.linalg.norm(behind_tip_m)))
    ET.SubElement(ET.SubElement(sphere, "geometry"), "sphere", radius=radius)


Joints = Sequence[float]  # one value per joint, shape (n,)
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # (x, y, z, w)


class Engine(ABC):
    """Serial arm of revolute and prismatic joints with its base fixed at the world's origin.

    Kinematics and dynamics are the engine's own, but all its built-in losses are disabled. It integrates
    by semi-implicit Euler: v(n+1) = v(n) + h a(n), x(n+1) = x(n) + h v(n+1), with h the step [s].

    Args:
        urdf_text: URDF from `dynamics_urdf`.
        tip_frame: link of the tip.
        step_s: step h [s].
        gravity_m_s2: gravity vector in the world, shape (3,) [m/s^2].

    Raises:
        InputError: the engine cannot load the URDF, or it is not a serial arm that ends at the tip frame.
    """

    name: ClassVar[str]  # name in a scenario

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
    def place(self, position_rad: Joints, velocity_rad_s: Joints) -> None:
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
    def push(self, torque_nm: Joints, tip_force_z_n: float, tip_position_m: Sequence[float]) -> None:
        """Apply torques and an upward force at the tip for the next step only.

        Args:
            torque_nm: torques along the joint axes, shape (n,) [N m].
            tip_force_z_n: upward force [N].
            tip_position_m: position of the tip in the world, shape (3,) [m].
        """

    @abstractmethod
    def brake(self, friction_nm: Joints) -> None:
        """Apply dry friction to the joints from the next step on.

        The engine solves for friction together with the motion: friction equals its limit while a joint
        moves, and the required holding torque while the joint is at rest.

        Args:
            friction_nm: largest torques, shape (n,) [N m].
        """

    @abstractmethod
    def step(self) -> None:
        """Integrate one step."""

    @abstractmethod
    def mass_matrix(self, position_rad: Joints) -> FloatArray:
        """Compute the joint-space inertia, shape (n, n) [kg m^2].

        Args:
            position_rad: shape (n,) [rad].
        """

    @abstractmethod
    def inverse_dynamics(
        self, position_rad: Joints, velocity_rad_s: Joints, acceleration_rad_s2: Joints
    ) -> FloatArray:
        """Compute the torques of a motion in free air, shape (n,) [N m].

        Args:
            position_rad: shape (n,) [rad].
            velocity_rad_s: shape (n,) [rad/s].
            acceleration_rad_s2: shape (n,) [rad/s^2].
        """

    def set_surface(self, contact: EngineContact | None, height_m: float) -> None:
        """Add a surface with the engine's own contact to the world, or remove it.

        Args:
            contact: stiffness and damping; None to remove the surface.
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

    def close(self) -> None:  # noqa: B027, some engines hold no resources
        """Free resources; can be called repeatedly."""


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
