"""Writes a URDF from a Denavit-Hartenberg table."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from control.arm.dh import DhTable, rpy_of
from robot_io.errors import InputError
from robot_io.types import FloatArray


@dataclass(frozen=True, slots=True)
class LinkInertia:
    """The mass of the link that one joint moves.

    Attributes:
        mass_kg: mass [kg].
        center_m: centre of mass in the joint's URDF frame (at the joint, z along its axis), 3 values [m].
        inertia_kg_m2: xx, yy, zz, xy, xz, yz about the centre of mass, axes of that frame [kg m^2].
    """

    mass_kg: float
    center_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class JointRange:
    """Limits that a URDF must state: positions [rad or m], effort [N m or N], speed [rad/s or m/s]."""

    low: float = -np.pi
    high: float = np.pi
    effort: float = 100.0
    speed: float = 10.0


def dh_to_urdf(
    table: DhTable,
    inertias: Sequence[LinkInertia] = (),
    ranges: Sequence[JointRange] = (),
    tip_frame: str = "tip",
) -> str:
    """The URDF of a table: one link per joint, then a link called `tip_frame` with the table's last frame.

    Args:
        table: the DH table.
        inertias: one per joint, or empty for kinematics only.
        ranges: one per joint, or empty for the defaults.
        tip_frame: name of the last link.

    Raises:
        InputError: the numbers of joints differ.
    """
    for what, given in (("inertias", inertias), ("ranges", ranges)):
        if given and len(given) != table.joint_count:
            raise InputError(f"{what}: {len(given)} given, the table has {table.joint_count} joints")
    robot = ElementTree.Element("robot", name=table.name)
    ElementTree.SubElement(robot, "link", name="base_link")
    parent, placement, index = "base_link", np.eye(4), 0
    for row in table.rows:
        if row.type == "fixed":
            placement = placement @ row.transform()
            continue
        link = f"{row.name}_link"
        origin = placement @ row.before_joint()
        joint = _joint(robot, row.name, row.type, parent=parent, child=link, placement=origin)
        ElementTree.SubElement(joint, "axis", xyz="0 0 1")
        _add_range(joint, ranges[index] if ranges else JointRange())
        _add_link(robot, link, inertias[index] if inertias else None)
        parent, placement, index = link, row.after_joint(), index + 1
    _joint(robot, f"{tip_frame}_joint", "fixed", parent=parent, child=tip_frame, placement=placement)
    ElementTree.SubElement(robot, "link", name=tip_frame)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(
    robot: ElementTree.Element, name: str, kind: str, *, parent: str, child: str, placement: FloatArray
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(
        joint, "origin", xyz=_numbers(placement[:3, 3]), rpy=_numbers(rpy_of(placement[:3, :3]))
    )
    return joint


def _add_range(joint: ElementTree.Element, joint_range: JointRange) -> None:
    ElementTree.SubElement(
        joint,
        "limit",
        lower=repr(float(joint_range.low)),
        upper=repr(float(joint_range.high)),
        effort=repr(float(joint_range.effort)),
        velocity=repr(float(joint_range.speed)),
    )


def _add_link(robot: ElementTree.Element, name: str, inertia: LinkInertia | None) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    if inertia is None:
        return
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_numbers(inertia.center_m), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=repr(float(inertia.mass_kg)))
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    values = dict(zip(names, map(repr, map(float, inertia.inertia_kg_m2)), strict=True))
    ElementTree.SubElement(inertial, "inertia", values)


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
