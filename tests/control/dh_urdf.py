"""Writes a URDF from a Denavit-Hartenberg table."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from palpate.control.arm.dh import DhTable
from palpate.robot_io.errors import InputError


@dataclass(frozen=True, slots=True)
class LinkInertia:
    """The mass of the link that one joint moves."""

    mass_kg: float  # mass [kg]
    # center of mass in the joint's URDF frame (at the joint, z along its axis), 3 values [m].
    center_m: tuple[float, float, float]
    # xx, yy, zz, xy, xz, yz about the center of mass, axes of that frame [kg m^2].
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

    Inertias are one per joint, or none for kinematics only; so are ranges, none for the defaults.

    Raises:
        InputError: the numbers of joints differ.
    """
    for what, given in (("inertias", inertias), ("ranges", ranges)):
        if given and len(given) != table.joint_count:
            raise InputError(f"{what}: {len(given)} given, the table has {table.joint_count} joints")
    robot = Element("robot", name=table.name)
    SubElement(robot, "link", name="base_link")
    parent, placement, index = "base_link", pin.SE3.Identity(), 0
    for row in table.rows:
        if row.type == "fixed":
            placement = placement * row.transform()
            continue
        link = f"{row.name}_link"
        joint = _add_joint(robot, row.name, row.type, parent, link, placement * row.before_joint)
        SubElement(joint, "axis", xyz="0 0 1")
        low, high, effort, speed = map(_text, astuple(ranges[index] if ranges else JointRange()))
        SubElement(joint, "limit", lower=low, upper=high, effort=effort, velocity=speed)
        _add_link(robot, link, inertias[index] if inertias else None)
        parent, placement, index = link, row.after_joint, index + 1
    _add_joint(robot, f"{tip_frame}_joint", "fixed", parent, tip_frame, placement)
    SubElement(robot, "link", name=tip_frame)
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"


def _add_joint(
    robot: Element, name: str, kind: str, parent: str, child: str, placement: "pin.SE3"
) -> Element:
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    rpy = _text(*pin.rpy.matrixToRpy(placement.rotation))
    SubElement(joint, "origin", xyz=_text(*placement.translation), rpy=rpy)
    return joint


def _add_link(robot: Element, name: str, inertia: LinkInertia | None) -> None:
    link = SubElement(robot, "link", name=name)
    if inertia is None:
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_text(*inertia.center_m), rpy="0 0 0")
    SubElement(inertial, "mass", value=_text(inertia.mass_kg))
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    SubElement(inertial, "inertia", dict(zip(names, map(_text, inertia.inertia_kg_m2), strict=True)))


def _text(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
