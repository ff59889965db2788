"""Parsing of foreign URDFs: bounded, a tree, finite numbers."""

import math
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from palpate.robot_io.files.file_model import MAX_TEXT_BYTES

MOST_ELEMENTS = 20_000
MOST_LINKS = 500
MOST_DEPTH = 20
_TENSOR = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
_NUMBERS = {  # of an element: its attributes, and how many numbers each holds
    "inertia": (tuple(dict.fromkeys(_TENSOR)), 1),
    "origin": (("xyz", "rpy"), 3),
    "axis": (("xyz",), 3),
    "limit": (("lower", "upper", "effort", "velocity"), 1),
}
_ROUNDING = 1e-4  # rounding of published tensors, as a share of the largest moment


def parse_urdf(text: str) -> Element:
    """Parse a URDF; its links must be a tree, its numbers finite and its masses possible.

    Args:
        text: XML.

    Raises:
        ValueError: the text is not such a URDF, or is larger than any arm needs.
    """
    robot = parse_xml(text)
    if robot.tag != "robot":
        raise ValueError(f"its root is <{robot.tag}>, not <robot>")
    _check_tree(robot)
    for link in robot.iter("link"):
        name = link.get("name")
        for inertial in link.iter("inertial"):
            # With impossible masses and inertias, a mass matrix need not be positive.
            for mass in inertial.iter("mass"):
                if not 0.0 <= _number(mass.get("value", "")) < math.inf:
                    raise ValueError(f"mass of link '{name}' is {mass.get('value')} kg, must be 0 or more")
            for element in inertial.iter("inertia"):
                values = dict(_finite_numbers(element))
                tensor = np.array([values.get(key, math.nan) for key in _TENSOR]).reshape(3, 3)
                if not np.isfinite(tensor).all():
                    raise ValueError(f"inertia of link '{name}' lacks a number")
                moments = np.linalg.eigvalsh(tensor)
                if moments[0] < -_ROUNDING * abs(moments[2]):
                    moment = f"{moments[0]:.3g} kg m^2"
                    raise ValueError(f"inertia of link '{name}' has a negative moment, {moment}")
    for element in robot.iter():
        list(_finite_numbers(element))
    return robot


def parse_xml(text: str, *, comments: bool = False) -> Element:
    """Parse XML without document type or entities, of bounded size.

    Args:
        text: XML.
        comments: keep comments within the root element.

    Raises:
        ValueError: the text is not XML, has a document type, or is larger than any arm needs.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise ValueError(f"larger than {MAX_TEXT_BYTES} characters")
    try:
        parser = ElementTree.XMLParser(target=_BoundedTreeBuilder(insert_comments=comments))  # noqa: S314, bounded
        return ElementTree.fromstring(text, parser)  # noqa: S314, bounded
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error


def joints_to_root(robot: Element, link: str) -> list[Element]:
    """List the joints from a link to the root of the tree, that of the link itself first.

    Args:
        robot: root of a URDF from `parse_urdf`.
        link: name of the link.
    """
    by_child = {linked_name(joint, "child"): joint for joint in robot.findall("joint")}
    joints: list[Element] = []
    while link in by_child:
        joints.append(by_child[link])
        link = linked_name(joints[-1], "parent")
    return joints


def last_link(robot: Element) -> str:
    """Return the link at the end of the longest chain of joints; of several, the one named last.

    Args:
        robot: root of a URDF from `parse_urdf`.
    """
    names = [link.get("name", "") for link in robot.findall("link")]
    return max(reversed(names), key=lambda name: len(joints_to_root(robot, name)), default="")


class _BoundedTreeBuilder(ElementTree.TreeBuilder):
    """Refuses documents that are deeper or longer than a URDF, before they take memory."""

    _depth = _count = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> Element:
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > MOST_DEPTH or self._count > MOST_ELEMENTS:
            raise ValueError(f"more than {MOST_ELEMENTS} elements, or nested deeper than {MOST_DEPTH}")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> Element:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, *_: object) -> None:
        raise ValueError("a document type declaration (<!DOCTYPE>) is not allowed")


def _check_tree(robot: Element) -> None:
    links = {link.get("name", "") for link in robot.findall("link")}
    if len(links) > MOST_LINKS:
        raise ValueError(f"{len(links)} links, at most {MOST_LINKS}")
    parents: dict[str, str] = {}
    for joint in robot.findall("joint"):
        child, parent = (linked_name(joint, role) for role in ("child", "parent"))
        if child in parents:
            raise ValueError(f"link '{child}' has two parent joints")
        parents[child] = parent
        if len(parents) > MOST_LINKS:
            raise ValueError(f"more than {MOST_LINKS} joints")
    for link in parents:
        above = link
        for _ in range(len(parents)):
            above = parents.get(above, "")
        if above in parents:
            raise ValueError(f"link '{link}' is its own ancestor, so its joints form a loop")


def linked_name(joint: Element, role: str) -> str:
    """Return the name of a joint's link; raise `ValueError` if it has none.

    Args:
        joint: joint of a URDF.
        role: "parent" or "child".
    """
    element = joint.find(role)
    if element is None or not element.get("link"):
        raise ValueError(f"joint '{joint.get('name')}' has no <{role}>")
    return element.get("link", "")


def _finite_numbers(element: Element) -> Iterator[tuple[str, float]]:
    """An element's numbers; each is finite."""
    names, count = _NUMBERS.get(element.tag, ((), 0))
    for name in names:
        if (text := element.get(name)) is None:
            continue
        values = [_number(word) for word in text.split()]
        if len(values) != count or not all(map(math.isfinite, values)):
            raise ValueError(f"<{element.tag} {name}='{text:.60}'> is not {count} finite numbers")
        yield name, values[0]


def _number(word: str) -> float:
    try:
        return math.nan if "_" in word else float(word)
    except ValueError:
        return math.nan
