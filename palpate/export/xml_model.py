"""Write fitted joints into an MJCF or a URDF: attributes of joints, gravity, and a payload at the tip."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, degrees
from posixpath import isabs, join, normpath
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from palpate.export.target_terms import TargetArm, TargetJoint, TermValue, as_comment
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.urdf_text import parse_xml
from palpate.robot_io.types import FloatArray

_DIRECTORIES = ("meshdir", "texturedir")
_NOT_IN_THEM = ("include", "model")  # MuJoCo looks for these files beside the main file


def _rebase_mjcf(root: Element, place: str, folder: str) -> None:
    """Let the asset directories of an MJCF lead back to the original's folder."""
    if folder == ".":
        return
    if (included := root.find(".//include")) is not None:
        raise InputError(
            f"{place}: MuJoCo looks for the included file {included.get('file', '')} beside the main file; "
            f"write the copy to the folder of {place} with -o"
        )
    for model in root.iter("model"):
        if name := model.get("file"):
            model.set("file", _moved(name, folder))
    assets = (each for each in root.iter() if each.tag not in _NOT_IN_THEM)
    if not any(key.startswith("file") for each in assets for key in each.attrib):
        return
    compilers = root.findall("compiler")
    now = dict.fromkeys(_DIRECTORIES, "")
    for compiler in compilers:  # a later one takes precedence
        now |= dict.fromkeys(_DIRECTORIES, compiler.get("assetdir", "")) if compiler.get("assetdir") else {}
        now |= {key: compiler.get(key, "") for key in _DIRECTORIES if compiler.get(key) is not None}
    if not compilers:
        root.insert(0, Element("compiler"))
    last = root.findall("compiler")[-1]
    for key, directory in now.items():
        last.set(key, _moved(directory, folder))


def _moved(path: str, folder: str) -> str:
    return path if isabs(path) or folder == "." else normpath(join(folder, path))


PAYLOAD = "palpate_payload"
_SMALL_INERTIA = "1e-9"  # inertia of a point mass, which must not be zero in either format [kg m^2]
_SMALL_ARMATURE = 1e-5  # inertia between the flanks of a gap, which MuJoCo needs [kg m^2]
_JOINTS = ("hinge", "slide")
_SCALED = ("motor", "general")  # actuators whose force is a gain times the control
_SERVO_GAINS = (("kp", "1"), ("kv", "0"))  # of a <position> actuator, with MuJoCo's defaults
_PASSIVE = ("armature", "damping", "frictionloss", "stiffness")


@dataclass(frozen=True)
class Mounting:
    """How the arm is mounted, and where its tip is."""

    tip_frame: str  # name of the tip's frame, empty where no URDF is known
    tip_m: FloatArray  # shape (3,), the tip in the frame of the link that the last joint moves
    tilt_axis: FloatArray  # shape (3,), unit axis about which a tilt turns the base
    gravity_m_s2: FloatArray  # shape (3,), fall acceleration in the axes of the base


@dataclass(frozen=True)
class PatchedModel:
    """A patched file."""

    text: str  # text of the file
    used: tuple[str, ...]  # what was written, one line each
    left_out: tuple[str, ...]  # what is not in it, was kept or is doubtful, one line each


def patch_mjcf(
    text: str,
    place: str,
    arm: TargetArm,
    mounting: Mounting,
    *,
    by_name: bool,
    folder: str = ".",
    servo_gain_nm_rad: float | None = None,
) -> PatchedModel:
    """Write the values of an arm into the text of an MJCF.

    A value replaces that of the file, because the fitted model has no other friction, spring or rotor.

    Args:
        text: text of the MJCF.
        place: origin of the text, for error messages.
        arm: terms of the arm, expressed for `SimulatorFormat.MJCF`.
        mounting: mounting of the arm.
        by_name: find joints by their names; otherwise the n-th hinge or slide joint is joint n.
        folder: path from the folder of the copy to that of the original, where its meshes are.
        servo_gain_nm_rad: gain of position servos whose torques were not measured [N m/rad], or None.

    Raises:
        InputError: the file cannot be read, is no MJCF, lacks a joint, or includes files and goes elsewhere.
    """
    root = _parsed(text, place, "mujoco")
    _rebase_mjcf(root, place, folder)
    model = _Mjcf(place, root)
    for joint in arm.joints:
        element = model.joint(joint, by_name=by_name)
        model.set_joint(element, joint)
        if servo_gain_nm_rad is not None:
            model.check_servo(element, joint, servo_gain_nm_rad)
    if (tilt := arm.arm.get("tilt_rad", arm.arm.get("pitch_rad"))) is not None:
        from scipy.spatial.transform import Rotation  # noqa: PLC0415, slow to import

        turn = Rotation.from_rotvec(tilt.number * mounting.tilt_axis)
        if "roll_rad" in arm.arm:
            turn = Rotation.from_euler("YX", [tilt.number, arm.arm["roll_rad"].number])
        gravity = turn.inv().apply(mounting.gravity_m_s2)
        if (option := root.find("option")) is None:
            root.insert(0, option := Element("option"))
        option.set("gravity", " ".join(f"{value:.9g}" for value in gravity))
        _comment(root, option, "gravity", tilt.fitted)
        model.used.append(f"arm: gravity {option.get('gravity')} ({'; '.join(tilt.fitted)})")
    if (payload := arm.arm.get("payload_kg")) is not None:
        model.add_payload(payload, mounting)
    return _patched(text, root, arm, model.used, model.left_out)


def patch_urdf(
    text: str, place: str, arm: TargetArm, mounting: Mounting, *, folder: str = "."
) -> PatchedModel:
    """Write the values of an arm into the text of a URDF.

    Args:
        text: text of the URDF.
        place: origin of the text, for error messages.
        arm: terms of the arm, expressed for `SimulatorFormat.URDF`.
        mounting: mounting of the arm.
        folder: path from the folder of the copy to that of the original, where its meshes are.

    Raises:
        InputError: the file cannot be read, is no URDF, or lacks a joint.
    """
    root = _parsed(text, place, "robot")
    # Relative paths of meshes and textures lead back to the original's folder.
    compilers = [each for each in root.findall("mujoco/compiler") if each.get("meshdir")]
    for each in compilers:  # MuJoCo's own extension of the format
        each.set("meshdir", _moved(each.get("meshdir", ""), folder))
    for each in root.iter():
        name = each.get("filename", "")
        if any(compiler.get("strippath") == "false" for compiler in compilers):
            break  # paths of meshes start at this directory
        if each.tag in {"mesh", "texture"} and name and "://" not in name:
            each.set("filename", _moved(name, folder))
    used, left_out = list[str](), list[str]()
    for joint in arm.joints:
        element = _named(place, root.findall("joint"), joint)
        if joint.values:
            dynamics = element.find("dynamics")
            dynamics = SubElement(element, "dynamics") if dynamics is None else dynamics
            for key, value in joint.values.items():
                dynamics.set(key, f"{value.number:.9g}")
            _comment(root, element, joint.channel, joint.lines())
            used += [f"{joint.channel} '{joint.name}': {line}" for line in joint.lines()]
    payload = arm.arm.get("payload_kg")
    if payload is not None and payload.number <= 0.0:
        left_out.append(_too_light(payload.number))
    elif payload is not None:
        link = SubElement(root, "link", {"name": PAYLOAD})
        inertial = SubElement(link, "inertial")
        SubElement(inertial, "mass", {"value": f"{payload.number:.9g}"})
        moments = dict.fromkeys(("ixx", "iyy", "izz"), _SMALL_INERTIA)
        SubElement(inertial, "inertia", moments | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
        mount = SubElement(root, "joint", {"name": f"{PAYLOAD}_mount", "type": "fixed"})
        SubElement(mount, "parent", {"link": mounting.tip_frame})
        SubElement(mount, "child", {"link": PAYLOAD})
        _comment(root, link, "payload", payload.fitted)
        used.append(f"arm: link '{PAYLOAD}' at '{mounting.tip_frame}' ({'; '.join(payload.fitted)})")
    return _patched(text, root, arm, used, left_out)


class _Mjcf:
    """An MJCF that is being changed."""

    def __init__(self, place: str, root: Element) -> None:
        self._place, self._root = place, root
        self.used, self.left_out = list[str](), list[str]()
        self._parents = {child: parent for parent in root.iter() for child in parent}
        self._defaults = {
            each.get("class", "main"): each for top in root.findall("default") for each in top.iter("default")
        }
        joints = root.iterfind("worldbody//joint")
        self._joints = [joint for joint in joints if self.value(joint, "type", "hinge") in _JOINTS]

    def value(self, element: Element, name: str, absent: str) -> str:
        """Return an attribute of an element or of its default class.

        Args:
            element: joint or actuator.
            name: name of the attribute.
            absent: value if neither states it, MuJoCo's default.
        """
        if (own := element.get(name)) is not None:
            return own
        tags = {element.tag} if element.tag == "joint" else {element.tag, *_SCALED}
        class_name, above = element.get("class"), self._parents.get(element)
        while class_name is None and above is not None:
            class_name, above = above.get("childclass"), self._parents.get(above)
        default = self._defaults.get("main" if class_name is None else class_name)
        while default is not None:
            for each in default:
                if each.tag in tags and (value := each.get(name)) is not None:
                    return value
            above = self._parents.get(default)
            default = above if above is not None and above.tag == "default" else None
        return absent

    def joint(self, joint: TargetJoint, *, by_name: bool) -> Element:
        if by_name:
            return _named(self._place, self._joints, joint, self._if_included())
        if joint.number > len(self._joints):
            raise InputError(
                f"{self._place}: has {len(self._joints)} hinge and slide joints, "
                f"but {joint.channel} was measured{self._if_included()}"
            )
        return self._joints[joint.number - 1]

    def _if_included(self) -> str:
        """Return the advice for a joint that may be in an included file, or nothing."""
        names = [each.get("file", "") for each in self._root.iter("include")]
        return f"; if it is in the included file {' or '.join(names)}, patch that file" if names else ""

    def set_joint(self, element: Element, joint: TargetJoint) -> None:
        """Write one joint's values into its hinge or slide joint."""
        number = {key: value.number for key, value in joint.values.items()}
        is_hinge = self.value(element, "type", "hinge") == "hinge"
        angles = [each.get("angle") for each in self._root.findall("compiler") if each.get("angle")]
        in_file = degrees if is_hinge and (not angles or angles[-1] == "degree") else float
        texts = {key: f"{number[key]:.9g}" for key in sorted(number.keys() & {"armature", "frictionloss"})}
        if "frictionloss" in texts:  # by default friction changes sign some 10 ms ahead of the motion
            texts["solreffriction"] = f"{2.0 * self._step_s():.9g} 1"
        if number.keys() & {"damping", "damping_quadratic"}:
            texts["damping"] = _polynomial(number.get("damping", 0.0), number.get("damping_quadratic", 0.0))
        if number.keys() & {"stiffness", "cubic"}:
            k, p, k3 = (number.get(key, 0.0) for key in ("stiffness", "preload", "cubic"))
            # Rest position: the root of k q + preload + cubic q^3 nearest zero.
            roots = np.roots(np.array([k3, 0.0, k, p]))
            real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 * (1.0 + abs(root.real))]
            rest = min(real, key=abs) if real else (0.0 if p == 0.0 else None)
            if rest is None:
                self._omit(joint, f"preload {p:.5g} is left out, because no fitted spring balances it")
                rest = 0.0
            texts["stiffness"] = _polynomial(k + 3.0 * k3 * rest**2, 3.0 * k3 * rest, k3)
            texts["springref"] = f"{in_file(rest):.9g}"
        for key in _PASSIVE:
            before = self.value(element, key, "0")
            if key not in texts and any(self._numbers(element, key, before)):
                self._omit(joint, f"{key} {before} of the file is kept, because the fitted model has none")
        for key, value in texts.items():
            element.set(key, value)
        if joint.values:
            _comment(self._root, element, joint.channel, joint.lines())
            self.used += [f"{joint.channel} '{element.get('name', '')}': {line}" for line in joint.lines()]
        if "gap" in number:
            self._add_gap(element, joint, in_file(0.5 * number["gap"]))
        if "gear" in number:
            self._scale_actuators(element, joint, number["gear"])
        if "sensor_delay_s" in number:
            if element.get("name") is None:
                element.set("name", joint.channel)
            section = self._root.find("sensor")
            section = SubElement(self._root, "sensor") if section is None else section
            delay = joint.values["sensor_delay_s"]
            about = {"name": f"{joint.channel}_effort", "joint": element.get("name", "")}
            about |= {"delay": f"{delay.number:.9g}", "nsample": f"{ceil(delay.number / self._step_s()) + 1}"}
            sensor = SubElement(section, "jointactuatorfrc", about)
            _comment(self._root, sensor, "delay", delay.fitted)

    def _omit(self, joint: TargetJoint, line: str) -> None:
        self.left_out.append(f"{joint.channel}: {line}")

    def _step_s(self) -> float:
        step_s = 0.002  # MuJoCo's default; the last option takes precedence
        for option in self._root.findall("option[@timestep]")[-1:]:
            step_s = self._numbers(option, "timestep", option.get("timestep", ""))[0]
        if step_s <= 0.0:
            raise InputError(f"{self._place}: <option> timestep {step_s:g} s: must be above 0")
        return step_s

    def _numbers(self, element: Element, name: str, text: str) -> list[float]:
        """The numbers in an attribute; `InputError` if it holds anything else or nothing."""
        try:
            numbers = [float(word) for word in text.split()]
        except ValueError:
            numbers = []
        if not numbers or not np.isfinite(numbers).all():
            called = "".join(f" '{element.get(key)}'" for key in ("name", "joint") if element.get(key))
            raise InputError(
                f"{self._place}: <{element.tag}>{called} {name} {text[:40]!a}: not a finite number"
            )
        return numbers

    def _add_gap(self, element: Element, joint: TargetJoint, half: float) -> None:
        name = f"{element.get('name') or joint.channel}_backlash"
        if any(key.get("qpos") for key in self._root.iter("key")):
            self._omit(joint, "'backlash' adds a joint, so remove the file's keyframes with positions first")
            return
        parent = self._parents[element]
        own = {"name": name, "limited": "true", "range": f"{-half:.9g} {half:.9g}"}
        own |= {"armature": f"{_SMALL_ARMATURE}", "damping": "0", "frictionloss": "0", "stiffness": "0"}
        own |= {key: value for key in ("type", "axis", "pos") if (value := self.value(element, key, ""))}
        parent.insert(list(parent).index(element) + 1, Element("joint", own))
        self.used.append(f"{joint.channel}: new joint '{name}' adds one entry to qpos and qvel")
        if not any(self._numbers(element, "armature", self.value(element, "armature", "0"))):
            unknown = "the inertia of the rotor is unknown"
            self._omit(joint, f"{unknown}, and without an armature the contact at the gap's ends is soft")

    def check_servo(self, element: Element, joint: TargetJoint, gain_nm_rad: float) -> None:
        """Report where the joint's <position> actuator contradicts a fit to goals and positions.

        Args:
            element: the joint.
            joint: its fitted values.
            gain_nm_rad: torque per goal error that was used in the fit [N m/rad].
        """
        for each in self._actuators(element):
            if each.tag != "position":
                continue
            kp, kv = (self._numbers(each, name, self.value(each, name, no))[0] for name, no in _SERVO_GAINS)
            if abs(kp - gain_nm_rad) > 1e-3 * gain_nm_rad:
                gain = f"the servo's gain is {gain_nm_rad:g} N m/rad"
                self._omit(joint, f"kp {kp:g} of <position> is kept, but {gain}")
            if kv:
                included = "the fitted damping already includes the servo's damping"
                self._omit(joint, f"kv {kv:g} of <position> is kept, but {included}")

    def _actuators(self, element: Element) -> list[Element]:
        name = element.get("name")
        actuators = () if name is None else self._root.iterfind("actuator/*")
        return [each for each in actuators if each.get("joint") == name]

    def _scale_actuators(self, element: Element, joint: TargetJoint, factor: float) -> None:
        actuators = self._actuators(element)
        scaled = [each for each in actuators if each.tag in _SCALED and not each.get("biastype")]
        for each in scaled:
            first, *further = self._numbers(each, "gear", self.value(each, "gear", "1"))
            each.set("gear", " ".join(f"{value:.9g}" for value in (first * factor, *further)))
            _comment(self._root, each, "gear", [f"{first:.9g} of the file times {factor:.9g}"])
        if not scaled:
            kinds = ", ".join(f"<{each.tag}>" for each in actuators) or "none"
            left_out = "'torque_gain' is left out, because it scales the gear of a <motor>"
            self._omit(joint, f"{left_out}; actuators of this joint: {kinds}")

    def add_payload(self, payload: TermValue, mounting: Mounting) -> None:
        """Add a point mass at the tip; a mass of zero or less is only reported.

        Args:
            payload: the mass [kg].
            mounting: where the tip is.
        """
        if payload.number <= 0.0:
            self.left_out.append(_too_light(payload.number))
            return
        site = self._tip(mounting.tip_frame, "site")
        body = self._tip(mounting.tip_frame, "body")
        if site is not None:
            place, where = self._parents[site], site.get("pos", "0 0 0")
        elif body is not None:
            place, where = body, "0 0 0"
        else:
            place = self._parents[self._joints[-1]]
            where = " ".join(f"{value:.9g}" for value in mounting.tip_m)
        load = SubElement(place, "body", {"name": PAYLOAD, "pos": where})
        moments = " ".join([_SMALL_INERTIA] * 3)
        inertial = {"pos": "0 0 0", "mass": f"{payload.number:.9g}", "diaginertia": moments}
        SubElement(load, "inertial", inertial)
        _comment(self._root, load, "payload", payload.fitted)
        where = f"at ({where}) of '{place.get('name', place.tag)}'"
        self.used.append(f"arm: new body '{PAYLOAD}' {where} ({'; '.join(payload.fitted)})")

    def _tip(self, name: str, tag: str) -> Element | None:
        found = (each for each in self._root.iterfind(f"worldbody//{tag}") if each.get("name") == name)
        return next(found, None)


def _polynomial(*coefficients: float) -> str:
    """Return the coefficients of MuJoCo's spring or damper polynomial, without trailing zeros."""
    kept = np.trim_zeros(np.array(coefficients), "b")
    return " ".join(f"{value:.9g}" for value in kept) or "0"


def _too_light(mass_kg: float) -> str:
    return f"'payload' {mass_kg:.5g} kg is negative: subtract it from the mass of the last body by hand"


def _parsed(text: str, place: str, tag: str) -> Element:
    try:
        root = parse_xml(text, comments=True)
    except ValueError as error:
        raise InputError(f"{place}: not readable as XML ({error})") from error
    if root.tag != tag:
        raise InputError(f"{place}: its root is <{root.tag}>, not <{tag}>")
    return root


def _named(place: str, joints: Sequence[Element], joint: TargetJoint, advice: str = "") -> Element:
    found = [each for each in joints if each.get("name") == joint.name]
    if not found:
        names = dict.fromkeys(name for each in joints if (name := each.get("name")))
        raise InputError(
            f"{place}: {joint.channel} needs a joint '{joint.name}', but the file has none (the name comes "
            "from the URDF of --urdf; without --urdf, it is the channel's name). Valid: "
            f"{', '.join(names) or 'none'}{advice}"
        )
    if len(found) > 1:
        raise InputError(f"{place}: {len(found)} joints are called '{joint.name}': rename all but one")
    return found[0]


def _comment(root: Element, element: Element, title: str, lines: Sequence[str]) -> None:
    """Put a comment before an element."""
    parent = next(each for each in root.iter() if element in list(each))
    text = f" palpate {title}: {_xml_comment('; '.join(lines))} "
    parent.insert(list(parent).index(element), ElementTree.Comment(text))


def _xml_comment(text: str) -> str:
    return as_comment(text).replace("--", "- -")


def _patched(
    before: str, root: Element, arm: TargetArm, used: Sequence[str], left_out: Sequence[str]
) -> PatchedModel:
    """Join the text before the root, comments on omitted effects, and the changed root."""
    out = (*arm.left_out, *left_out)
    lines = [f"Patched by palpate export from {arm.source}.", *arm.notes]
    lines += [f"left out or doubtful: {line}" for line in out]
    comments = "".join(f"<!-- {_xml_comment(line)} -->\n" for line in lines)
    head, opened, _ = before.partition(f"<{root.tag}")
    head = head if opened and head.count("<!--") == head.count("-->") else ""
    ElementTree.indent(root)
    text = f"{head}{comments}{ElementTree.tostring(root, encoding='unicode')}\n"
    return PatchedModel(text, tuple(used), out)
