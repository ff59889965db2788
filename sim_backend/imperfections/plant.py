"""Hidden effects in masses and gravity: a payload, a tilted base."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import cos, sin
from typing import Self

from numpy.random import Generator

from robot_io.errors import InputError
from robot_io.files.file_model import NotNegative, Number
from sim_backend.hooks import HiddenEffects, PlantEffect
from sim_backend.imperfection import Imperfection, JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, channel_of, joint_of

_RADIUS_M = 0.01


class HiddenPayload(JointImperfection):
    """A small ball of mass m at the far end of a link: where the next joint begins, or at the tip.

    It has weight and inertia, and shows in the joint that moves the link and in those before it.
    """

    name = "payload"
    shows_in = LOADED  # a tool that hangs straight down gives its joint no lever
    # M [kg]; scaled by the arm's mass_scale as the rest of it.
    mass_kg: NotNegative = parameter("kg", 0.005, 1.0, le=50.0)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(channel_of(joint) for joint in range(1, self.joint + 1))

    def effects(self, joint_count: int) -> HiddenEffects:
        index = self.index_in(joint_count)
        return HiddenEffects(plant=(_Ball(index, self.mass_kg),)) if self.mass_kg else HiddenEffects()

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at the tip."""
        mass_kg = strength * scale.joint_noise_nm / scale.joint(channel).weight_nm_kg
        return cls(joint=max(len(scale.joints), joint_of(channel)), mass_kg=mass_kg)


class _Ball(PlantEffect):
    def __init__(self, index: int, mass_kg: float) -> None:
        self._index = index
        self._mass_kg = mass_kg

    def urdf(self, urdf_text: str, tip_frame: str) -> str:
        try:
            robot = ET.fromstring(urdf_text)  # noqa: S314 - expat refuses entity bombs; nothing external is read
        except ET.ParseError as error:
            raise InputError(f"URDF: not XML ({error})") from error
        carrier, xyz = _far_end(robot, tip_frame, self._index)
        name = f"hidden_payload_{len(robot.findall('link'))}"
        inertial = ET.SubElement(ET.SubElement(robot, "link", name=name), "inertial")
        ET.SubElement(inertial, "mass", value=repr(self._mass_kg))
        own = repr(0.4 * self._mass_kg * _RADIUS_M**2)
        ET.SubElement(inertial, "inertia", ixx=own, iyy=own, izz=own, ixy="0", ixz="0", iyz="0")
        mount = ET.SubElement(robot, "joint", name=f"{name}_mount", type="fixed")
        ET.SubElement(mount, "parent", link=carrier)
        ET.SubElement(mount, "child", link=name)
        ET.SubElement(mount, "origin", xyz=xyz)
        return ET.tostring(robot, encoding="unicode")


def _far_end(robot: ET.Element, tip_frame: str, index: int) -> tuple[str, str]:
    """The link behind the movable joint `index` of the chain to the tip, and the place of its far end."""
    by_child = {
        child.get("link", ""): joint for joint in robot.iter("joint") for child in joint.iter("child")
    }
    movable: list[ET.Element] = []
    link = tip_frame
    while link in by_child:
        joint = by_child.pop(link)
        if joint.get("type") != "fixed":
            movable.insert(0, joint)
        link = next((parent.get("link", "") for parent in joint.iter("parent")), "")
    if index + 1 >= len(movable):
        return tip_frame, "0 0 0"
    parent, origin = movable[index + 1].find("parent"), movable[index + 1].find("origin")
    carrier = tip_frame if parent is None else parent.get("link", "")
    return carrier, "0 0 0" if origin is None else origin.get("xyz", "0 0 0")


class HiddenGravityTilt(Imperfection):
    """Gravity is turned against the arm's base, g = R^T (0, 0, -9.81): the table is not level.

    R turns the base by `pitch_rad` about its y axis, x dipping, after `roll_rad` about its x axis. The object
    is tilted with it. An arm that moves in the x-z plane feels pitch alone.
    """

    name = "gravity_tilt"
    shows_in = LOADED
    pitch_rad: Number = parameter("rad", -0.1, 0.1, ge=-1.6, le=1.6)  # about y [rad]
    roll_rad: Number = parameter("rad", -0.1, 0.1, ge=-1.6, le=1.6, default=0.0)  # about x [rad]

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the base's joint carries most of the arm, and those after it less."""
        return tuple(channel_of(joint) for joint in (1, 2, 3))

    def effects(self, joint_count: int) -> HiddenEffects:
        return HiddenEffects(plant=(_Slope(self.pitch_rad, self.roll_rad),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        sign = generator.choice([-1.0, 1.0])
        return cls(pitch_rad=sign * strength * scale.joint_noise_nm / scale.joint(channel).tilt_nm_rad)


class _Slope(PlantEffect):
    def __init__(self, pitch_rad: float, roll_rad: float) -> None:
        self._pitch_rad = pitch_rad
        self._roll_rad = roll_rad

    def gravity_m_s2(self, gravity_m_s2: Sequence[float]) -> Sequence[float]:
        """The vector in the tilted base's frame: turned back about y, then about x."""
        x, y, z = gravity_m_s2
        c, s = cos(self._pitch_rad), sin(self._pitch_rad)
        x, z = c * x - s * z, s * x + c * z
        c, s = cos(self._roll_rad), sin(self._roll_rad)
        return x, c * y + s * z, -s * y + c * z
