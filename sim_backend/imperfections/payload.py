"""A mass that the arm's URDF does not know."""

import xml.etree.ElementTree as ET
from typing import Self

from numpy.random import Generator

from robot_io.errors import InputError
from robot_io.files.file_model import NotNegative
from sim_backend.hooks import Effects, PlantEffect
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, channel_of, joint_of

_RADIUS_M = 0.01


class Payload(JointImperfection):
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

    def effects(self, joint_count: int) -> Effects:
        index = self.index_in(joint_count)
        return Effects(plant=(_Ball(index, self.mass_kg),)) if self.mass_kg else Effects()

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
