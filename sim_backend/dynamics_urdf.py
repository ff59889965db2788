"""Conversion of a robot's URDF to the physics: joints, masses, and one sphere at the tip."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from robot_io.errors import InputError
from robot_io.files.urdf_text import parse_urdf
from robot_io.types import FloatArray


def dynamics_urdf(
    urdf_text: str,
    tip_frame: str,
    *,
    mass_scale: float = 1.0,
    tip_radius_m: float,
    sensor_axis_tip: Sequence[float],
) -> str:
    """Remove pictures, meshes and collision shapes, and add one sphere behind the tip frame.

    The sphere touches a surface with the tip frame's origin. It is a shape of the last moving link, because
    PyBullet lets links behind a fixed joint pass through static bodies. A link without <inertial>, to which
    PyBullet would give 1 kg, gets no mass, as URDF means it.

    Args:
        urdf_text: the robot's URDF.
        tip_frame: link whose origin is the contact point.
        mass_scale: factor on all masses and inertias [-].
        tip_radius_m: of the sphere [m].
        sensor_axis_tip: unit vector in the tip frame along which the tool pushes.

    Returns:
        The URDF for the engine.

    Raises:
        InputError: not a URDF, a number in it is invalid, or it has no link of the tip frame's name.
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
        _keep_only_inertial(link, mass_scale)
    carrier, centre = _in_last_moving_link(robot, tip_frame, behind_tip_m)
    links[carrier].append(_sphere(float(np.linalg.norm(behind_tip_m)), centre))


def _keep_only_inertial(link: ET.Element, mass_scale: float) -> None:
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


def _in_last_moving_link(robot: ET.Element, link: str, point: FloatArray) -> tuple[str, FloatArray]:
    """The nearest ancestor of `link` that is moved by a joint, and `point` (3,) [m] in its frame."""
    parent_joints = {_name(joint, "child"): joint for joint in robot.findall("joint")}
    while link in parent_joints and parent_joints[link].get("type") == "fixed":
        joint = parent_joints[link]
        origin = joint.find("origin")
        if origin is not None:
            xyz, rpy = (
                [float(number) for number in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy")
            )
            point = Rotation.from_euler("xyz", rpy).apply(point) + xyz
        link = _name(joint, "parent")
    return link, point


def _name(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    if element is None:
        raise InputError(f"URDF: joint '{joint.get('name')}' has no <{role}>")
    return element.get("link", "")


def _sphere(radius_m: float, centre_m: FloatArray) -> ET.Element:
    collision = ET.Element("collision")
    ET.SubElement(collision, "origin", xyz=" ".join(map(repr, centre_m.tolist())), rpy="0 0 0")
    ET.SubElement(ET.SubElement(collision, "geometry"), "sphere", radius=repr(radius_m))
    return collision
