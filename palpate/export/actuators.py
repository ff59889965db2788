"""Parameters of joints as actuators of Isaac Lab, and as parameter files of BAM."""

import json
from collections.abc import Mapping
from pathlib import Path

from palpate.export.feedforward import as_comment
from palpate.export.target_terms import TargetArm
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import read_text


def isaaclab_text(arm: TargetArm) -> str:
    """Write actuator configurations of Isaac Lab, a Python module with one dict `ACTUATORS`.

    Args:
        arm: terms of the arm, expressed for `SimulatorFormat.ISAACLAB`.
    """
    lines = [
        f'"""Actuators of Isaac Lab, written by palpate export from {as_comment(arm.source)}.',
        "",
        "Friction is an effort [N m, N of a linear axis], as in Isaac Sim 5 and newer.",
        "stiffness and damping are gains of the drive and stay those of the USD.",
        '"""',
        "",
        "from isaaclab.actuators import ImplicitActuatorCfg",
        "",
        *(f"# not in it: {as_comment(line)}" for line in arm.left_out),
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


def bam_texts(arm: TargetArm, patch: Path | None) -> list[str]:
    """Write parameter files of BAM (better-actuator-models), one for the servo of each joint.

    Args:
        arm: terms of the arm, expressed for `SimulatorFormat.BAM`.
        patch: parameter file with the other parameters (actuator, kt, R ...), which are copied; None without
            such a file.

    Raises:
        InputError: `patch` is not a parameter file of BAM.
    """
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
        content = {
            key: value
            for key, value in motor.items()
            if not (key in _OF_BAM or key.startswith("load_friction_"))
        }
        content |= {"model": model} | {key: known.get(key, 0.0) for key in _BAM_MODELS[model]}
        if (armature := known.get("armature", motor.get("armature"))) is not None:
            content["armature"] = armature
        content["palpate"] = {"source": arm.source, "values": joint.lines(), "not_in_it": list(joint.lost)}
        texts.append(json.dumps(content, indent=4, ensure_ascii=True) + "\n")
    return texts
