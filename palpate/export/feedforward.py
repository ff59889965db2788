"""Feedforward of joints from their fitted models: a table, and the same as Python and C source."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import isfinite
from pathlib import Path

import yaml

from palpate.common.files import write_text
from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import ParameterEstimate, rounded, with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.kinds import Kind

EQUATION = (
    "effort = gravity.sine sin(q) + gravity.cosine cos(q) + inertia a + viscous v "
    "+ coulomb.level tanh(v / coulomb.transition) "
    "+ (stribeck.level + stribeck.rise exp(-(v / stribeck.speed)^2)) tanh(v / stribeck.transition)"
)


@dataclass(frozen=True)
class JointTerms:
    """Terms of one joint's effort; lengths in rad (m for a linear axis), efforts in N m (N)."""

    gravity_sine: float = 0.0  # [effort]
    gravity_cosine: float = 0.0  # [effort]
    inertia: float = 0.0  # [kg m^2 or kg]
    viscous: float = 0.0  # [effort s/length]
    coulomb_level: float = 0.0  # [effort]
    coulomb_transition: float = 1.0  # speed over which the friction changes sign [length/s]
    stribeck_level: float = 0.0  # [effort]
    stribeck_rise: float = 0.0  # [effort]
    stribeck_speed: float = 1.0  # over which the rise is gone [length/s]
    stribeck_transition: float = 1.0  # [length/s]


# Where each parameter of a fitted effect goes.
_FIELDS: Mapping[str, Mapping[str, str]] = {
    "armature": {"inertia": "inertia"},
    "asymmetric_friction": {  # means of both directions
        "dry": "coulomb_level",
        "viscous": "viscous",
        "transition": "coulomb_transition",
    },
    "coulomb_friction": {"force": "coulomb_level", "transition": "coulomb_transition"},
    "gravity_tilt": {"tilt": "gravity_cosine"},  # of a pendulum; the tilt of a whole arm is in rad
    "inertia": {"m": "inertia"},
    "pendulum": {"inertia": "inertia", "gravity": "gravity_sine"},
    "stribeck_friction": {
        "coulomb": "stribeck_level",
        "rise": "stribeck_rise",
        "speed": "stribeck_speed",
        "transition": "stribeck_transition",
    },
    "viscous_friction": {"d": "viscous"},
    "weight": {"g1": "gravity_sine", "g2": "gravity_cosine"},
}
_OF_ARM = "depends on all joints of the arm: add the inverse dynamics of its URDF"
_REASONS = {
    "bias": "may be a constant effort or the sensor's zero, which the motion cannot distinguish",
    "gravity_tilt": _OF_ARM,
    "payload": _OF_ARM,
    "rigid_body": _OF_ARM,
    "rigid_body_fitted": _OF_ARM,
    "torque_gain": "is a scale error of the torque reading: for a drive whose commands have the same scale, "
    "multiply the table by this gain",
}
SYMMETRIC = "friction is the same in both directions: their mean is exported"
_OF_READING = {Kind.SENSOR_DYNAMICS, Kind.SENSOR_STATICS, Kind.DRIFT}


@dataclass(frozen=True)
class FittedJoint:
    """The fitted model of one joint."""

    name: str  # name of the channel, such as "joint_2"
    model: str  # base model and added effects
    kind: ChannelKind
    effort_unit: str
    fit: FitResult
    # Torque per goal error of a position servo [N m/rad]; None keeps its parameters in rad of goal error.
    servo_gain_nm_rad: float | None = None

    @property
    def number(self) -> int:
        """Number of the joint, from 1."""
        return int(self.name.removeprefix("joint_"))

    @property
    def by_effect(self) -> dict[str, dict[str, ParameterEstimate]]:
        """Fitted parameters by effect and own name; empty for effects with known parameters."""
        effects: dict[str, dict[str, ParameterEstimate]] = {
            effect.name: {} for effect in self.fit.model.effects
        }
        stated_parameters = {**self.fit.model.gains, **self.fit.model.inner}
        for name, parameter in self.fit.parameters.items():
            effect, _, own = name.partition(".")
            if (gain := self.servo_gain_nm_rad) is not None:  # from units of the goal error to N m and kg m^2
                stated = stated_parameters[name]
                parameter = replace(parameter, unit=stated.unit_of(ChannelKind.REVOLUTE))  # noqa: PLW2901
                if "{effort}" in stated.unit or "{inertia}" in stated.unit:
                    low, high = (gain * end for end in parameter.interval)
                    value, std_err = gain * parameter.value, gain * parameter.std_err
                    parameter = replace(parameter, value=value, std_err=std_err, interval=(low, high))  # noqa: PLW2901
            effects.setdefault(effect, {})[own] = parameter
        return effects


@dataclass(frozen=True)
class Feedforward:
    """A feedforward of joints."""

    joints: tuple[FittedJoint, ...]  # by their numbers
    terms: tuple[JointTerms, ...]  # terms of each joint
    used: tuple[str, ...]  # what went into it, one line each
    left_out: tuple[str, ...]  # what the table cannot express or the data do not determine, one line each

    def write(self, path: Path, source: str) -> None:
        """Write the table (.yaml), and the functions (.py, .c) beside it.

        Args:
            path: path of the table.
            source: description of the measurement.

        Raises:
            InputError: a file cannot be written.
        """
        pairs = list(zip(self.joints, self.terms, strict=True))
        joints = {
            joint.name: {
                "model": joint.model,
                "effort_unit": joint.effort_unit,
                "position_unit": joint.kind.position_unit,
                "gravity": {"sine": terms.gravity_sine, "cosine": terms.gravity_cosine},
                "inertia": terms.inertia,
                "coulomb": {"level": terms.coulomb_level, "transition": terms.coulomb_transition},
                "stribeck": {
                    "level": terms.stribeck_level,
                    "rise": terms.stribeck_rise,
                    "speed": terms.stribeck_speed,
                    "transition": terms.stribeck_transition,
                },
                "viscous": terms.viscous,
                "recorded": {
                    name: list(_range(joint, name)) for name in ("position", "velocity", "acceleration")
                },
            }
            for joint, terms in pairs
        }
        content = {"source": source, "equation": EQUATION, "joints": joints, "left_out": list(self.left_out)}
        write_text(path, yaml.safe_dump(content, sort_keys=False, width=100, allow_unicode=True))
        rows = "".join(f"    {joint.number}: ({_literals(t)}),  # {_title(joint)}\n" for joint, t in pairs)
        names = ", ".join(asdict(JointTerms()))
        text = _PYTHON.format(source=as_comment(source), names=names, rows=rows)
        write_text(path.with_suffix(".py"), text)
        lines = (f"{{{joint.number}, {{{_literals(t)}}}}}, /* {_title(joint)} */" for joint, t in pairs)
        rows = "".join(f"    {line}\n" for line in lines)
        names = "".join(f"    double {name};\n" for name in asdict(JointTerms()))
        text = _C.format(source=as_comment(source), names=names, rows=rows)
        write_text(path.with_suffix(".c"), text)


def _literals(terms: JointTerms) -> str:
    """Write numbers so that Python and C read the same values."""
    return ", ".join(map(repr, asdict(terms).values()))


def make_feedforward(joints: Sequence[FittedJoint]) -> Feedforward:
    """Make the feedforward of fitted joints, ordered by number.

    Args:
        joints: with their fits.
    """
    ordered = sorted(joints, key=lambda joint: joint.number)
    terms, used, left_out = [], list[str](), list[str]()
    for joint in ordered:
        values = asdict(JointTerms())
        for effect, parameters in joint.by_effect.items():
            fields = _FIELDS.get(effect)
            units = {parameter.unit for parameter in parameters.values()}
            if fields is None or (effect == "gravity_tilt" and units == {"rad"}):
                left_out.append(f"{joint.name}: '{effect}' {reason_left_out(effect, _REASONS, 'table')}")
                continue
            numbers = {own: float(parameter.value) for own, parameter in parameters.items()}
            if effect == "asymmetric_friction":
                numbers["dry"], numbers["viscous"] = mean_of_directions(numbers)
                left_out.append(f"{joint.name}: '{effect}': {SYMMETRIC}")
            for own in fields.keys() & numbers.keys():
                if own in {"transition", "speed"}:
                    values[fields[own]] = numbers[own]
                else:
                    values[fields[own]] += numbers[own]
            for own, parameter in parameters.items():
                low, high = parameter.interval
                is_known = isfinite(low) and isfinite(high)
                if own not in {"transition", "speed"} and not (is_known and (low > 0.0 or high < 0.0)):
                    value = with_unit(parameter.value, parameter.unit)
                    doubt = "its interval includes zero" if is_known else "the data do not determine it alone"
                    left_out.append(f"{joint.name}: {effect}.{own} {value} is exported, but {doubt}")
            listed = ", ".join(f"{own} {one.value:.5g} {one.unit}" for own, one in parameters.items())
            used.append(f"{joint.name}: {effect} {listed}")
        terms.append(JointTerms(**values))
    return Feedforward(tuple(ordered), tuple(terms), tuple(used), tuple(left_out))


def mean_of_directions(friction: Mapping[str, float]) -> tuple[float, float]:
    """Return dry and viscous part of `asymmetric_friction` for a format that has one of each.

    Args:
        friction: fitted parameters of the effect, by their own names.
    """
    return (
        0.5 * (friction["forward"] + friction["backward"]),
        0.5 * (friction["viscous_forward"] + friction["viscous_backward"]),
    )


def reason_left_out(effect: str, reasons: Mapping[str, str], target: str) -> str:
    """Say why a target has no term for an effect.

    Args:
        effect: name of the effect.
        reasons: reasons of effects that have one of their own.
        target: kind of the output, such as "table".
    """
    if effect in reasons:
        return reasons[effect]
    if effect not in EFFECTS:
        return f"is your own effect, for which the {target} has no term"
    kind = EFFECTS[effect].kind
    if kind in _OF_READING:
        return "is an error of the reading, not of the joint"
    if kind is Kind.RUN_DIFFERENCES:
        return "differs from run to run"
    return f"has no term in the {target} ({EFFECTS[effect].equation})"


def _range(joint: FittedJoint, name: str) -> tuple[float, float]:
    values = getattr(joint.fit.data, name)
    return float(values.min()), float(values.max())


def _title(joint: FittedJoint) -> str:
    low, high = _range(joint, "velocity")
    fastest = with_unit(high, joint.kind.position_unit)
    return f"{joint.name}: {joint.effort_unit}, recorded from {rounded(low)} to {fastest}/s"


def as_comment(text: str) -> str:
    """Make text one line that cannot end a comment of XML, Python or C, or a docstring.

    Args:
        text: any text, such as the name of a file.
    """
    plain = json.dumps(text, ensure_ascii=True)[1:-1].replace("\\", "/")
    return plain.replace('/"', "'").replace("--", "- -").replace("*/", "* /")


_PYTHON = '''"""Feedforward effort of joints, written by palpate export from {source}.

Give the desired motion, not the measured one, whose noise near zero speed makes friction chatter.
"""

from math import cos, exp, sin, tanh

# By number of the joint: {names}
TABLE = {{
{rows}}}


def feedforward(joint: int, position: float, velocity: float, acceleration: float) -> float:
    """Effort that moves a joint [N m, or N of a linear axis].

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

/* Effort that moves a joint [N m, or N of a linear axis]; NAN for a joint that is not in the table.
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
