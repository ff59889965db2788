"""Feedforward of joints from their fitted models: a table, and the same as Python and C source."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from palpate.common.files import write_text
from palpate.estimation.estimate import rounded, with_unit
from palpate.export.simulator import WrittenModels
from palpate.export.target_terms import (
    SYMMETRIC,
    TILT_OF_ARM,
    FittedJoint,
    TargetTerm,
    Terms,
    as_comment,
    express,
    mean_of_directions,
    named,
)

EQUATION = (
    "effort = gravity.sine sin(q) + gravity.cosine cos(q) + inertia a + viscous v "
    "+ coulomb.level tanh(v / coulomb.transition) "
    "+ (stribeck.level + stribeck.rise exp(-(v / stribeck.speed)^2)) tanh(v / stribeck.transition)"
)
# Values of a joint without these terms; lengths in rad (m for a linear axis), efforts in N m (N).
_NONE = {
    "gravity_sine": 0.0,  # [effort]
    "gravity_cosine": 0.0,  # [effort]
    "inertia": 0.0,  # [kg m^2 or kg]
    "viscous": 0.0,  # [effort s/length]
    "coulomb_level": 0.0,  # [effort]
    "coulomb_transition": 1.0,  # speed over which the friction changes sign [length/s]
    "stribeck_level": 0.0,  # [effort]
    "stribeck_rise": 0.0,  # [effort]
    "stribeck_speed": 1.0,  # over which the rise is gone [length/s]
    "stribeck_transition": 1.0,  # [length/s]
}
_OF_ARM = "depends on all joints of the arm: add the inverse dynamics of its URDF"
TERMS: Terms = {
    "armature": named(inertia="inertia"),
    "asymmetric_friction": TargetTerm(
        lambda p: {
            **dict(zip(("coulomb_level", "viscous"), mean_of_directions(p), strict=True)),
            "coulomb_transition": p["transition"],
        },
        SYMMETRIC,
    ),
    "coulomb_friction": named(coulomb_level="force", coulomb_transition="transition"),
    "gravity_tilt": named(gravity_cosine="tilt"),
    TILT_OF_ARM: _OF_ARM,
    "inertia": named(inertia="m"),
    "payload": _OF_ARM,
    "pendulum": named(inertia="inertia", gravity_sine="gravity"),
    "rigid_body": _OF_ARM,
    "rigid_body_fitted": _OF_ARM,
    "stribeck_friction": named(
        stribeck_level="coulomb",
        stribeck_rise="rise",
        stribeck_speed="speed",
        stribeck_transition="transition",
    ),
    "torque_gain": "is a scale error of the torque reading: for a drive whose commands have the same scale, "
    "multiply the table by this gain",
    "viscous_friction": named(viscous="d"),
    "weight": named(gravity_sine="g1", gravity_cosine="g2"),
}


def write_feedforward(
    path: Path, joints: Sequence[FittedJoint], failures: Sequence[str], source: str
) -> WrittenModels:
    """Write the table (.yaml) of fitted joints, and the functions (.py, .c) beside it.

    Args:
        path: path of the table.
        joints: with their fits.
        failures: why other joints have no fit, one line each.
        source: description of the measurement.

    Raises:
        InputError: a file cannot be written.
    """
    arm = express(joints, TERMS, source)
    left_out, table, python, c = (*arm.left_out, *failures), dict[str, object](), "", ""
    for joint, target in zip(sorted(joints, key=lambda each: each.number), arm.joints, strict=True):
        terms = _NONE | {name: value.number for name, value in target.values.items()}
        ranges = {
            name: [float(end(getattr(joint.fit.data, name))) for end in (np.min, np.max)]
            for name in ("position", "velocity", "acceleration")
        }
        table[joint.name] = {
            "model": joint.model,
            "effort_unit": joint.effort_unit,
            "position_unit": joint.kind.position_unit,
            "gravity": {"sine": terms["gravity_sine"], "cosine": terms["gravity_cosine"]},
            "inertia": terms["inertia"],
            "coulomb": {"level": terms["coulomb_level"], "transition": terms["coulomb_transition"]},
            "stribeck": {
                name: terms[f"stribeck_{name}"] for name in ("level", "rise", "speed", "transition")
            },
            "viscous": terms["viscous"],
            "recorded": ranges,
        }
        low, high = ranges["velocity"]
        fastest = with_unit(high, joint.kind.position_unit)
        title = f"{joint.name}: {joint.effort_unit}, recorded from {rounded(low)} to {fastest}/s"
        numbers = ", ".join(map(repr, terms.values()))  # read as the same values by Python and C
        python += f"    {joint.number}: ({numbers}),  # {title}\n"
        c += f"    {{{joint.number}, {{{numbers}}}}}, /* {title} */\n"
    content = {"source": source, "equation": EQUATION, "joints": table, "left_out": list(left_out)}
    fields = "".join(f"    double {name};\n" for name in _NONE)
    about = as_comment(source)
    texts = {
        path: yaml.safe_dump(content, sort_keys=False, width=100, allow_unicode=True),
        path.with_suffix(".py"): _PYTHON.format(source=about, names=", ".join(_NONE), rows=python),
        path.with_suffix(".c"): _C.format(source=about, names=fields, rows=c),
    }
    for file, text in texts.items():
        write_text(file, text)
    used = dict.fromkeys(
        f"{joint.channel}: {'; '.join(value.fitted)}"
        for joint in arm.joints
        for value in joint.values.values()
    )
    return WrittenModels(tuple(texts), tuple(used), left_out)


_PYTHON = '''"""Feedforward effort of joints, written by palpate export from {source}.

Give the desired motion, not the measured one, whose noise near zero speed makes friction chatter.
"""

from math import cos, exp, sin, tanh

# By number of the joint: {names}
TABLE = {{
{rows}}}


def feedforward(joint: int, position: float, velocity: float, acceleration: float) -> float:
    """Effort that moves a joint, in the unit beside its row: N m, N, or rad of a servo's goal error.

    Args:
        joint: number of the joint, from 1; KeyError for one that is not in the table.
        position: desired [rad, or m].
        velocity: desired [rad/s, or m/s].
        acceleration: desired [rad/s^2, or m/s^2].
    """
    sine, cosine, inertia, viscous, coulomb, turn, level, rise, speed, stribeck_turn = TABLE[joint]
    ratio = velocity / speed
    effort = sine * sin(position) + cosine * cos(position) + inertia * acceleration + viscous * velocity
    effort += coulomb * tanh(velocity / turn)
    return effort + (level + rise * exp(-ratio * ratio)) * tanh(velocity / stribeck_turn)
'''

_C = """/* Feedforward effort of joints, written by palpate export from {source}.
 *
 * Give the desired motion, not the measured one, whose noise near zero speed makes friction chatter.
 */
#include <math.h>
#include <stddef.h>

struct feedforward_terms {{
{names}}};

static const struct {{
    int joint;
    struct feedforward_terms terms;
}} feedforward_table[] = {{
{rows}}};

/* Effort that moves a joint, in the unit beside its row: N m, N, or rad of a servo's goal error; NAN for a
 * joint that is not in the table.
 *
 * joint: its number, from 1; position [rad, or m], velocity and acceleration: desired.
 */
double feedforward(int joint, double position, double velocity, double acceleration)
{{
    for (size_t row = 0; row < sizeof feedforward_table / sizeof feedforward_table[0]; row++) {{
        const struct feedforward_terms *t = &feedforward_table[row].terms;
        if (feedforward_table[row].joint != joint)
            continue;
        double ratio = velocity / t->stribeck_speed;
        double effort = t->gravity_sine * sin(position) + t->gravity_cosine * cos(position)
            + t->inertia * acceleration + t->viscous * velocity;
        effort += t->coulomb_level * tanh(velocity / t->coulomb_transition);
        return effort
            + (t->stribeck_level + t->stribeck_rise * exp(-ratio * ratio))
            * tanh(velocity / t->stribeck_transition);
    }}
    return NAN;
}}
"""
