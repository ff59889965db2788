"""Fitted joints as a patched MJCF or URDF, as Isaac Lab's actuators, or as BAM's parameters."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.common.files import output_file, write_text
from palpate.control.arm.rigid_body import RigidBody
from palpate.estimation.study import Arm
from palpate.export.target_terms import TABLE, FittedJoint, SimulatorFormat, TargetArm, as_comment, express
from palpate.export.xml_model import Mounting, patch_mjcf, patch_urdf
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import read_text


def _isaaclab_text(arm: TargetArm) -> str:
    """Write actuator configurations of Isaac Lab, a Python module with one dict `ACTUATORS`."""
    lines = [
        f'"""Actuators of Isaac Lab, written by palpate export from {as_comment(arm.source)}.',
        "",
        "Friction is an effort [N m; N for a linear axis], as in Isaac Sim 5 and newer.",
        "stiffness and damping are gains of the drive and keep their values from the USD.",
        *map(as_comment, arm.notes),
        '"""',
        "",
        "from isaaclab.actuators import ImplicitActuatorCfg",
        "",
        *(f"# left out or doubtful: {as_comment(line)}" for line in arm.left_out),
        "ACTUATORS = {",
    ]
    for joint in arm.joints:
        lines += [
            f"    {joint.name!r}: ImplicitActuatorCfg(",
            f"        joint_names_expr=[{joint.name!r}],",
            "        stiffness=None,",
            "        damping=None,",
        ]
        for key, value in joint.values.items():
            lines.append(f"        {key}={value.number!r},  # {as_comment('; '.join(value.fitted))}")
        lines.append("    ),")
    return "\n".join([*lines, "}", ""])


# Values of BAM's models; values that were not fitted are set to zero, unlike BAM's defaults.
_BAM_MODELS: Mapping[str, tuple[str, ...]] = {
    "m1": ("friction_base", "friction_viscous"),
    "m2": ("friction_base", "friction_viscous", "friction_stribeck", "dtheta_stribeck", "alpha"),
    "m3": ("friction_base", "friction_viscous", "load_friction_base"),
    "m4": (
        *("friction_base", "friction_viscous", "friction_stribeck", "dtheta_stribeck", "alpha"),
        *("load_friction_base", "load_friction_stribeck"),
    ),
}
# Keys of BAM's file that the fit replaces, together with the load friction of models M5 and M6.
_OF_BAM = frozenset({"armature", *_BAM_MODELS["m4"]})


def _bam_texts(arm: TargetArm, patch: Path | None) -> list[str]:
    """Write parameter files of BAM (better-actuator-models), one for the servo of each joint."""
    motor: dict[str, object] = {}
    if patch is not None:
        try:
            motor = json.loads(read_text(patch))
        except (OSError, ValueError) as error:
            raise InputError(f"{patch}: not a BAM parameter file ({error})") from error
        if not isinstance(motor, dict) or "actuator" not in motor:
            raise InputError(f'{patch}: not a BAM parameter file: it names no "actuator"')
    texts = []
    for joint in arm.joints:
        model = next(
            name for name, keys in _BAM_MODELS.items() if not (joint.values.keys() - {"armature"}) - {*keys}
        )
        known = {key: value.number for key, value in joint.values.items()}
        kept = (key for key in motor if not (key in _OF_BAM or key.startswith("load_friction_")))
        content = {key: motor[key] for key in kept}
        content |= {"model": model} | {key: known.get(key, 0.0) for key in _BAM_MODELS[model]}
        if (armature := known.get("armature", motor.get("armature"))) is not None:
            content["armature"] = armature
        content["palpate"] = {
            "source": arm.source,
            "notes": list(arm.notes),
            "values": joint.lines(),
            "not_in_it": list(joint.lost),
        }
        texts.append(json.dumps(content, indent=4, ensure_ascii=True) + "\n")
    return texts


@dataclass(frozen=True)
class WrittenModels:
    """Files of an export."""

    files: tuple[Path, ...]
    used: tuple[str, ...]  # what went into them, one line each
    left_out: tuple[str, ...]  # what the target cannot express, with the reason, one line each


def write_simulator(
    joints: Sequence[FittedJoint],
    target: SimulatorFormat,
    path: Path,
    mounted: Arm,
    *,
    patch: Path | None,
    failures: Sequence[str],
    source: str,
    notes: Sequence[str],
) -> WrittenModels:
    """Write fitted joints in a simulator's file format.

    Args:
        joints: with their fits.
        target: the simulator.
        path: file to write; for BAM, each of several joints has its own file with the joint in its name.
        mounted: the arm to which the joints belong.
        patch: file of the user that is read, or None.
        failures: why other joints have no fit, one line each.
        source: description of the measurement.
        notes: how it was read, in sentences.

    Raises:
        InputError: `patch` is missing, not readable or lacks a joint, or a file cannot be written.
    """
    body = None
    if mounted.urdf:
        body = RigidBody.from_urdf(mounted.urdf, mounted.tip_frame, origin=mounted.origin)
    names = () if body is None else body.joint_names
    arm = express(joints, TABLE[target], source, names, mounted.rotor_inertia_kg_m2)
    arm = replace(arm, left_out=(*arm.left_out, *failures), notes=tuple(notes))
    used = [f"{joint.channel} '{joint.name}': {line}" for joint in arm.joints for line in joint.lines()]
    texts: dict[Path, str]
    if target is SimulatorFormat.BAM:
        if patch is None:
            line = 'BAM needs "actuator", "kt" and "R" of the motor: give its parameter file with --patch'
            arm = replace(arm, left_out=(*arm.left_out, line))
        several = len(arm.joints) > 1
        texts = {
            (path.with_stem(f"{path.stem}_{joint.channel}") if several else path): text
            for joint, text in zip(arm.joints, _bam_texts(arm, patch), strict=True)
        }
    elif target is SimulatorFormat.ISAACLAB:
        if patch is not None:
            raise InputError(f"--patch {patch}: Isaac Lab's actuators go to a separate file; omit --patch")
        texts = {path: _isaaclab_text(arm)}
    else:
        tip, axis = np.zeros(3), np.array([0.0, 1.0, 0.0])
        if body is not None:  # the axis of the first joint, pointing along world x or y
            tip, axis = body.tip_in_last_link, body.joint_axes()[0].axis_world
            axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
        mounting = Mounting(mounted.tip_frame, tip, axis, np.array(mounted.gravity_m_s2))
        if patch is None and (target is SimulatorFormat.MJCF or not mounted.urdf):
            raise InputError(f"--format {target} changes a copy of your file: name it with --patch FILE")
        text, place = (mounted.urdf, mounted.origin) if patch is None else (_patch_text(patch), str(patch))
        original = Path(place)
        folder = (
            os.path.relpath(original.resolve().parent, path.resolve().parent) if original.is_file() else "."
        )
        if target is SimulatorFormat.MJCF:
            gain = joints[0].servo_gain_nm_rad
            patched = patch_mjcf(
                text, place, arm, mounting, by_name=body is not None, folder=folder, servo_gain_nm_rad=gain
            )
        else:
            patched = patch_urdf(text, place, arm, mounting, folder=folder)
        texts, used = {path: patched.text}, list(patched.used)
        arm = replace(arm, left_out=patched.left_out)
    kept = [Path(each) for each in (patch, mounted.origin) if each and Path(each).is_file()]
    for file in texts:
        output_file(file, force=True, keep=kept)
    for file, text in texts.items():
        write_text(file, text)
    return WrittenModels(tuple(texts), tuple(used), arm.left_out)


def _patch_text(patch: Path) -> str:
    """Read the file to patch; raise `InputError` if it is not text."""
    try:
        return read_text(patch)
    except (OSError, ValueError) as error:
        raise InputError(f"--patch {patch}: cannot be read ({error})") from error
