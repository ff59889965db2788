"""Feedforward of joints from their fitted models: a table, and the same as Python and C source."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from palpate.common.files import write_text
from palpate.estimation.channel import ChannelData
from palpate.estimation.estimate import Determined, rounded, with_unit
from palpate.estimation.fit.blocks import CARRYING, LOAD
from palpate.export.simulator import WrittenModels
from palpate.export.target_terms import (
    AT_ONCE,
    SYMMETRIC,
    TILT_OF_ARM,
    FittedJoint,
    TargetTerm,
    Terms,
    TermValue,
    as_comment,
    express,
    mean_of_directions,
    named,
)

# Valid in Python and C; t are the values of a joint, and q, v and a its desired motion.
_EQUATIONS = {
    "weight": (
        "t.gravity_sine * sin(q) + t.gravity_cosine * cos(q)",
        "+ t.spring_stiffness * q + t.spring_preload",
    ),
    "load": ("weight + t.friction_link_share * t.inertia * a",),
    "dry_friction": (
        "t.friction_level + t.friction_rise * exp(-(v / t.friction_speed) * (v / t.friction_speed))",
        "+ t.friction_sine * sin(t.friction_cycles * q) + t.friction_cosine * cos(t.friction_cycles * q)",
        "+ t.friction_load * fabs(load)",
    ),
    "effort": (
        "weight + (t.inertia + t.armature) * a + t.viscous * v + t.quadratic * v * fabs(v)",
        "+ dry_friction * tanh(v / t.friction_transition)",
    ),
}
# Values of a joint without these terms, with their units: effort and length are those of the joint.
_FIELDS = {
    "gravity_sine": (0.0, "effort"),
    "gravity_cosine": (0.0, "effort"),
    "spring_stiffness": (0.0, "effort/length"),
    "spring_preload": (0.0, "effort"),
    "inertia": (0.0, "effort s^2/length"),
    "armature": (0.0, "effort s^2/length, of the rotor, not part of the load"),
    "viscous": (0.0, "effort s/length"),
    "quadratic": (0.0, "effort s^2/length^2"),
    "friction_level": (0.0, "effort"),
    "friction_rise": (0.0, "effort, at low speed"),
    "friction_speed": (1.0, "length/s, speed at which the rise has fallen to 37 %"),
    "friction_sine": (0.0, "effort, variation with position"),
    "friction_cosine": (0.0, "effort"),
    "friction_cycles": (0.0, "1/length"),
    "friction_load": (0.0, "friction per load"),
    "friction_link_share": (1.0, "share of the inertia in the load"),
    "friction_transition": (1.0, "length/s, speed over which the friction changes sign"),
}
_NONE = {name: value for name, (value, _) in _FIELDS.items()}
_OF_ARM = "depends on all joints of the arm: add the inverse dynamics of its URDF"
TERMS: Terms = {
    "armature": named(armature="inertia"),
    "asymmetric_friction": TargetTerm(
        lambda p: {
            **dict(zip(("friction_level", "viscous"), mean_of_directions(p), strict=True)),
            "friction_transition": p["transition"],
        },
        SYMMETRIC,
    ),
    "coulomb_friction": named(friction_level="force", friction_transition="transition"),
    "gravity_tilt": named(gravity_cosine="tilt"),
    TILT_OF_ARM: _OF_ARM,
    "inertia": named(inertia="m"),
    "joint_spring": named(spring_stiffness="k", spring_preload="preload"),
    "load_dependent_friction": TargetTerm(
        lambda p: {
            "friction_load": p["mu"],
            "friction_link_share": p.get("link_share", 1.0),
            "friction_transition": p["transition"],
        }
    ),
    "payload": _OF_ARM,
    "pendulum": named(inertia="inertia", gravity_sine="gravity"),
    "position_dependent_friction": named(
        **{f"friction_{name}": name for name in ("level", "sine", "cosine", "cycles", "transition")}
    ),
    "presliding_friction": named(AT_ONCE, friction_level="force"),
    "quadratic_friction": named(quadratic="d2"),
    "rigid_body": _OF_ARM,
    "rigid_body_fitted": _OF_ARM,
    "stribeck_friction": named(
        friction_level="coulomb",
        friction_rise="rise",
        friction_speed="speed",
        friction_transition="transition",
    ),
    "torque_gain": "is a scale error of the torque reading; if the drive's commands have the same error, "
    "multiply the table by this gain",
    "viscous_friction": named(viscous="d"),
    "weight": named(gravity_sine="g1", gravity_cosine="g2"),
}
_UNKNOWN_LOAD = {
    "load_dependent_friction": "needs the load, which depends on other joints or is a recorded signal"
}


def smallest_resolved_speed(data: ChannelData) -> float:
    """Return the smallest speed that the data of a joint resolve [rad/s or m/s].

    It is the median speed of the samples beside reversals, which sampling and velocity noise determine. If
    the joint never reverses, it is the smallest recorded speed.

    Args:
        data: the channel of the joint.
    """
    velocity, speed = data.velocity, np.abs(data.velocity)
    last = np.flatnonzero((velocity[:-1] * velocity[1:] < 0.0) & (np.diff(data.run) == 0))
    if len(last):
        return float(np.median(speed[np.concatenate([last, last + 1])]))
    return float(speed.min(where=speed > 0.0, initial=1.0))


def _values_of(joint: FittedJoint, source: str) -> tuple[dict[str, TermValue], list[str]]:
    """Return the values of one joint, and lines on what is left out or not determined."""
    effects, data = joint.by_effect, joint.fit.data
    is_load_known = all(isinstance(TERMS[name], TargetTerm) for name in CARRYING & effects.keys())
    terms = TERMS if is_load_known and LOAD not in data.recorded else {**TERMS, **_UNKNOWN_LOAD}
    made = express([joint], terms, source)
    values, lines = dict(made.joints[0].values), list(made.left_out)
    for name, parameters in effects.items():
        fitted = parameters.get("transition")
        is_open = name == "presliding_friction" or (fitted and fitted.determined is Determined.NO)
        if not (is_open and isinstance(terms.get(name), TargetTerm)):
            continue
        # Any shorter transition fits as well, but would be a jump that the data do not contain.
        slowest, before = smallest_resolved_speed(data), values.get("friction_transition", TermValue(0.0, ()))
        values["friction_transition"] = replace(before, number=max(before.number, slowest))
        if fitted:
            unit = fitted.unit
            lines.append(
                f"{joint.name}: {name}.transition {fitted.value:.3g} {unit} is not determined; in the table, "
                f"friction changes sign over at least {slowest:.3g} {unit}, the smallest speed that the data "
                "resolve"
            )
    return values, lines


def write_feedforward(
    path: Path, joints: Sequence[FittedJoint], failures: Sequence[str], source: str, notes: Sequence[str]
) -> WrittenModels:
    """Write the table (.yaml) of fitted joints, and the functions (.py, .c) beside it.

    Args:
        path: path of the table.
        joints: with their fits.
        failures: why other joints have no fit, one line each.
        source: description of the measurement.
        notes: how it was read, in sentences.

    Raises:
        InputError: a file cannot be written.
    """
    table, python, c, used, left_out = dict[str, object](), "", "", list[str](), list[str]()
    for joint in sorted(joints, key=lambda each: each.number):
        values, lines = _values_of(joint, source)
        left_out += lines
        fitted = ("; ".join(value.fitted) for value in values.values() if value.fitted)
        used += [f"{joint.name}: {words}" for words in dict.fromkeys(fitted)]
        terms = _NONE | {name: value.number for name, value in values.items()}
        sections = dict[str, Any]()
        for name, number in terms.items():
            section, _, own = name.partition("_")
            sections[section] = sections.get(section, {}) | {own: number} if own else number
        ranges = {
            name: [float(end(getattr(joint.fit.data, name))) for end in (np.min, np.max)]
            for name in ("position", "velocity", "acceleration")
        }
        table[joint.name] = {
            "model": joint.model,
            "effort_unit": joint.effort_unit,
            "position_unit": joint.kind.position_unit,
            **sections,
            "recorded": ranges,
        }
        low, high = ranges["velocity"]
        fastest = with_unit(high, joint.kind.position_unit)
        title = f"{joint.name}: {joint.effort_unit}, recorded from {rounded(low)} to {fastest}/s"
        numbers = ", ".join(map(repr, terms.values()))  # read as the same values by Python and C
        python += f"    {joint.number}: Terms({numbers}),  # {title}\n"
        c += f"    {{{joint.number}, {{{numbers}}}}}, /* {title} */\n"
    left_out += failures
    equations = [f"{name} = {' '.join(parts)}" for name, parts in _EQUATIONS.items()]
    for name in _NONE:
        equations = [line.replace(f"t.{name}", name.replace("_", ".", 1)) for line in equations]
    content = {
        "source": source,
        "notes": list(notes),
        "equations": equations,
        "units": {name.replace("_", ".", 1): unit for name, (_, unit) in _FIELDS.items()},
        "joints": table,
        "left_out": left_out,
    }
    about = [f"{source}.", *notes, *(f"left out or doubtful: {line}" for line in left_out)]
    lines = [as_comment(line) for line in about]
    py_lines = (f"    {name} = (\n{_lines(parts)}\n    )\n" for name, parts in _EQUATIONS.items())
    c_lines = (f"        double {name} =\n{_lines(parts)};\n" for name, parts in _EQUATIONS.items())
    names = "".join(f"    {name}: float  # {unit}\n" for name, (_, unit) in _FIELDS.items())
    fields = "".join(f"    double {name}; /* {unit} */\n" for name, (_, unit) in _FIELDS.items())
    texts = {
        path: yaml.safe_dump(content, sort_keys=False, width=100, allow_unicode=True),
        path.with_suffix(".py"): _PYTHON.format(
            source="\n".join(lines), names=names, rows=python, equations="".join(py_lines)
        ),
        path.with_suffix(".c"): _C.format(
            source="\n * ".join(lines), names=fields, rows=c, equations="".join(c_lines)
        ),
    }
    for file, text in texts.items():
        write_text(file, text)
    return WrittenModels(tuple(texts), tuple(used), tuple(left_out))


def _lines(parts: Sequence[str]) -> str:
    return "\n".join(f"            {part}" for part in parts)


_PYTHON = '''"""Feedforward effort of joints, written by palpate export from {source}

Give the desired motion. Near zero speed, the noise of a measured motion makes friction chatter.
"""

from math import cos, exp, fabs, sin, tanh
from typing import NamedTuple


class Terms(NamedTuple):
    """Effort is in the unit beside the row of a joint; length is rad, or m for a linear axis."""

{names}

# By number of the joint
TABLE = {{
{rows}}}


def feedforward(joint: int, position: float, velocity: float, acceleration: float) -> float:
    """Effort that moves a joint, in the unit beside its row.

    Args:
        joint: number of the joint, from 1; KeyError for one that is not in the table.
        position: desired [rad, or m].
        velocity: desired [rad/s, or m/s].
        acceleration: desired [rad/s^2, or m/s^2].
    """
    t, q, v, a = TABLE[joint], position, velocity, acceleration
{equations}    return effort
'''

_C = """/* Feedforward effort of joints, written by palpate export from {source}
 *
 * Give the desired motion. Near zero speed, the noise of a measured motion makes friction chatter.
 */
#include <math.h>
#include <stddef.h>

/* Effort is in the unit beside the row of a joint; length is rad, or m for a linear axis. */
struct feedforward_terms {{
{names}}};

static const struct {{
    int joint;
    struct feedforward_terms terms;
}} feedforward_table[] = {{
{rows}}};

/* Effort that moves a joint, in the unit beside its row; NAN for a joint that is not in the table.
 *
 * joint: its number, from 1; position q [rad, or m], velocity v and acceleration a: desired.
 */
double feedforward(int joint, double q, double v, double a)
{{
    for (size_t row = 0; row < sizeof feedforward_table / sizeof feedforward_table[0]; row++) {{
        const struct feedforward_terms t = feedforward_table[row].terms;
        if (feedforward_table[row].joint != joint)
            continue;
{equations}        return effort;
    }}
    return NAN;
}}
"""
