"""How each format of fitted joints represents each effect, or why it cannot."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import isfinite

from palpate.estimation.channel import ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.estimate import ParameterEstimate, text_with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.kinds import Kind


class SimulatorFormat(StrEnum):
    """Simulator whose file is written."""

    MJCF = "mjcf"
    URDF = "urdf"
    ISAACLAB = "isaaclab"
    BAM = "bam"


FitSummary = Mapping[str, float]  # parameters of one effect, by their own names


@dataclass(frozen=True)
class TargetTerm:
    """How a target expresses an effect."""

    values: Callable[[FitSummary], Mapping[str, float]]  # the target's values by name; those of effects add
    lost: str = ""  # what of the effect the target does not express
    none: str = ""  # why the target has no values for these parameters, and what to do by hand


Terms = Mapping[str, TargetTerm | str]  # by effect; a text says why the target has no term


def named(lost: str = "", **names: str) -> TargetTerm:
    """Make values from fitted parameters.

    Args:
        lost: what of the effect the target does not express.
        names: target's name = fitted name.
    """
    return TargetTerm(lambda p: {key: p[name] for key, name in names.items()}, lost)


_ONE_LEVEL = "dry friction in the target has one level at all speeds, so the rise at low speed is left out"
AT_ONCE = "dry friction in the target changes sign at once, so the path over which it builds up is left out"
_NO_PLACE = "dry friction in the target has one level everywhere, so its variation with position is left out"
_OF_BODIES = "includes everything the joint carries; set masses and inertias of the bodies by hand"
_NO_LOAD = "is left out, because the target has no friction that grows with the load"
_LATE = "delays the reading (if negative, the motion lags the effort); set the delay of the action by hand"
_GAIN = "scales the torque reading; on the real joint, divide the reading by this gain"

TILT_OF_ARM = "gravity_tilt of an arm"  # its parameters are angles; those of a pendulum are torques
SYMMETRIC = "the target has equal friction in both directions, so the mean of both is exported"
# Reasons for every target; its own terms take precedence.
_REASONS: Mapping[str, str] = {
    "bias": "may be a constant effort or the sensor's zero, which the motion cannot distinguish",
    "encoder_zero": "is an error of the encoders: calibrate them (palpate calibrate encoder)",
    "gravity_tilt": "is the weight of a single pendulum; to get a tilt angle, fit with the arm's URDF",
    "inertia": _OF_BODIES,
    "pendulum": _OF_BODIES,
    "rigid_body": "",  # stated in the arm's own file
    "rigid_body_fitted": _OF_BODIES,
    "weight": _OF_BODIES,
}
_OF_READING = {Kind.SENSOR_DYNAMICS, Kind.SENSOR_STATICS, Kind.DRIFT}
_SHAPES = {"speed", "transition"}  # where friction changes, not how large it is


def mean_of_directions(friction: Mapping[str, float]) -> tuple[float, float]:
    """Return dry and viscous part of `asymmetric_friction` for a format that has one of each.

    Args:
        friction: fitted parameters of the effect, by their own names.
    """
    return (
        0.5 * (friction["forward"] + friction["backward"]),
        0.5 * (friction["viscous_forward"] + friction["viscous_backward"]),
    )


def _friction(dry: Sequence[str], viscous: str) -> dict[str, TargetTerm | str]:
    """Return the terms of dry and viscous friction for a target with these names for their levels."""

    def level(fitted: str, lost: str = "") -> TargetTerm:
        return named(lost, **dict.fromkeys(dry, fitted))

    return {
        "asymmetric_friction": TargetTerm(
            lambda p: {
                **dict.fromkeys(dry, mean_of_directions(p)[0]),
                viscous: mean_of_directions(p)[1],
            },
            SYMMETRIC,
        ),
        "coulomb_friction": level("force"),
        "damping": named(**{viscous: "c"}),
        "position_dependent_friction": level("level", _NO_PLACE),
        "presliding_friction": level("force", AT_ONCE),
        "stribeck_friction": level("coulomb", _ONE_LEVEL),
        "viscous_friction": named(**{viscous: "d"}),
    }


_NO_LOADS = dict.fromkeys(("load_dependent_friction", "load_dependent_presliding"), _NO_LOAD)
TABLE: Mapping[SimulatorFormat, Terms] = {
    SimulatorFormat.MJCF: {
        **_friction(("frictionloss",), "damping"),
        **_NO_LOADS,
        "armature": named(armature="inertia"),
        "backlash": named("the motor's share of inertia and friction stays with the first joint", gap="gap"),
        "cubic_stiffness": named(cubic="k3"),
        "delay": TargetTerm(
            lambda p: {"sensor_delay_s": p["time"]} if p["time"] > 0.0 else {},
            none="is negative, so the motion lags the effort; set the actuator's delay by hand",
        ),
        TILT_OF_ARM: TargetTerm(lambda p: {f"{key}_rad": angle for key, angle in p.items()}),
        "joint_elasticity": "needs a second body behind a spring",
        "joint_spring": named(stiffness="k", preload="preload"),
        "payload": named(payload_kg="mass"),
        "quadratic_friction": named(damping_quadratic="d2"),
        "stiffness": named(stiffness="k"),
        "torque_gain": TargetTerm(lambda p: {"gear": 1.0 / p["gain"]}),
        "torque_ripple": "is left out, because only a <dcmotor> has cogging",
    },
    SimulatorFormat.URDF: {
        **_friction(("friction",), "damping"),
        **_NO_LOADS,
        "armature": "is left out, because a URDF has no inertia of a rotor",
        TILT_OF_ARM: "is left out, because a URDF has no gravity; tilt the base where the arm is placed in "
        "the world",
        "payload": named(payload_kg="mass"),
        "torque_gain": _GAIN,
    },
    SimulatorFormat.ISAACLAB: {
        **_friction(("friction", "dynamic_friction"), "viscous_friction"),
        **_NO_LOADS,
        "armature": named(armature="inertia"),
        "backlash": "needs a second joint in the USD",
        "delay": _LATE,
        TILT_OF_ARM: "is set in the scene: SimulationCfg(gravity=...)",
        "payload": "is a mass of the USD: add a rigid body at the tip, or randomize_rigid_body_mass",
        "stribeck_friction": TargetTerm(
            lambda p: {
                "friction": max(p["coulomb"] + p["rise"], p["coulomb"]),
                "dynamic_friction": p["coulomb"],
            },
            "static friction ends as soon as the joint moves, not gradually around the Stribeck speed",
        ),
        "torque_gain": _GAIN,
    },
    SimulatorFormat.BAM: {
        **_friction(("friction_base",), "friction_viscous"),
        "armature": named(armature="inertia"),
        "delay": _LATE,
        # BAM's load is the difference of motor and external torque, twice the load of a joint in balance
        "load_dependent_friction": TargetTerm(lambda p: {"load_friction_base": 0.5 * p["mu"]}),
        "payload": "is a mass of the arm, not of the servo",
        "stribeck_friction": TargetTerm(
            lambda p: {
                "friction_base": p["coulomb"],
                "friction_stribeck": max(p["rise"], 0.0),
                "dtheta_stribeck": p["speed"],
                "alpha": 2.0,
            }
        ),
        "torque_gain": _GAIN,
    },
}
# Frictions that no simulator accepts below zero.
_PASSIVE = {"damping", "friction_viscous", "viscous_friction"} | {
    *("dynamic_friction", "friction", "friction_base", "frictionloss"),
}
OF_ARM = frozenset({"tilt_rad", "pitch_rad", "roll_rad", "payload_kg"})  # values of the whole arm


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
class TermValue:
    """One value of a target."""

    number: float  # in SI units
    fitted: tuple[str, ...]  # parameters that it comes from, with their 95 % intervals


Values = Mapping[str, TermValue]


@dataclass(frozen=True)
class TargetJoint:
    """Values of one joint for a target."""

    channel: str  # such as "joint_2"
    name: str  # in the arm's file; the channel's where there is none
    values: Values
    lost: tuple[str, ...]  # what of the fitted model is not in the values, one line each

    @property
    def number(self) -> int:
        """Return the number of the joint, from 1."""
        return int(self.channel.removeprefix("joint_"))

    def lines(self) -> list[str]:
        """Return one line for each value, with the sources of its fit."""
        return [f"{key} {each.number:.5g} ({'; '.join(each.fitted)})" for key, each in self.values.items()]


@dataclass(frozen=True)
class TargetArm:
    """Values of an arm for a target."""

    source: str  # what was measured
    joints: tuple[TargetJoint, ...]
    arm: Values  # values of the whole arm, see `OF_ARM`
    left_out: tuple[str, ...]  # what the target cannot express, one line each
    notes: tuple[str, ...] = ()  # how the measurement was read, in sentences


def express(
    joints: Sequence[FittedJoint],
    terms: Terms,
    source: str,
    names: Sequence[str] = (),
    rotors: Sequence[float] = (),
) -> TargetArm:
    """Look up what a target can express of fitted joints.

    Args:
        joints: with their fits.
        terms: those of the target, such as one of `TABLE`.
        source: description of the measurement.
        names: names of all joints of the arm in its file, from the base outwards; empty if unknown.
        rotors: inertia [kg m^2] of each joint's rotor that is in the base model; empty for none.
    """
    targets, left_out = list[TargetJoint](), list[str]()
    # half interval, value, and what is doubtful about it
    arm: dict[str, tuple[float, TermValue, list[str]]] = {}
    for joint in sorted(joints, key=lambda each: each.number):
        own: dict[str, TermValue] = {}
        lost = list[str]()
        rotor = rotors[joint.number - 1] if joint.number <= len(rotors) else 0.0
        if rotor and isinstance(terms.get("armature"), TargetTerm):
            own["armature"] = TermValue(rotor, (f"rotor inertia in the robot file: {rotor:.5g} kg m^2",))
        for effect, parameters in joint.by_effect.items():
            is_tilt = effect == "gravity_tilt" and {each.unit for each in parameters.values()} == {"rad"}
            key = TILT_OF_ARM if is_tilt else effect
            term = terms[key] if key in terms else _reason_left_out(effect)
            fitted = tuple(f"{effect}.{name} {_shown(each)}" for name, each in parameters.items())
            if isinstance(term, str):
                lost += ["; ".join([f"'{effect}' {term}", *fitted])] * bool(term)
                continue
            numbers = term.values({name: each.value for name, each in parameters.items()})
            doubts = [f"{effect}.{line}" for line in _doubts(term, parameters)]
            if not numbers:
                lost.append("; ".join([f"'{effect}' {term.none}", *fitted]))
            for key, number in numbers.items():
                if key not in OF_ARM:
                    before = own.get(key, TermValue(0.0, ()))
                    is_shape = key.rpartition("_")[2] in _SHAPES
                    total = max(number, before.number) if is_shape else number + before.number
                    own[key] = TermValue(total, before.fitted + fitted)
                    continue
                half = max(each.half_interval for each in parameters.values())
                rank = half if isfinite(half) else float("inf")
                once = f"'{effect}' has one value for the whole arm; it is taken from the channel with the "
                if key in arm and (once := f"{once}smallest interval") not in lost:
                    lost.append(once)
                if key not in arm or rank < arm[key][0]:
                    arm[key] = (rank, TermValue(number, fitted), [f"{joint.name}: {line}" for line in doubts])
            if term.lost:
                lost.append(f"'{effect}': {term.lost}")
            lost += doubts if OF_ARM.isdisjoint(numbers) else []
        if "asymmetric_friction" in joint.by_effect:  # its viscous part alone may be negative
            own |= {key: replace(own[key], number=max(own[key].number, 0.0)) for key in own.keys() & _PASSIVE}
        name = names[joint.number - 1] if joint.number <= len(names) else joint.name
        targets.append(TargetJoint(joint.name, name, own, tuple(lost)))
        left_out += [f"{joint.name}: {line}" for line in lost]
    left_out += dict.fromkeys(line for _, _, doubts in arm.values() for line in doubts)
    whole = {key: value for key, (_, value, _) in arm.items()}
    return TargetArm(source, tuple(targets), whole, tuple(left_out))


def _doubts(term: TargetTerm, parameters: Mapping[str, ParameterEstimate]) -> list[str]:
    """Return a line for each used parameter whose interval is unknown or includes zero."""
    known, lines = {name: each.value for name, each in parameters.items()}, list[str]()
    for name, each in parameters.items():
        low, high = each.interval
        is_known = isfinite(low) and isfinite(high)
        changed = known | {name: each.value * (1.0 + 1e-6) + 1e-12}
        is_used = name not in _SHAPES and term.values(changed) != term.values(known)
        if is_used and not (is_known and (low > 0.0 or high < 0.0)):
            doubt = (
                "its interval includes zero"
                if is_known
                else "the data determine it only in combination with other parameters"
            )
            lines.append(f"{name} {_shown(each)} is exported, but {doubt}")
    return lines


def _reason_left_out(effect: str) -> str:
    """Say why a target has no term for an effect; empty if nothing is missing."""
    if effect in _REASONS:
        return _REASONS[effect]
    if effect not in EFFECTS:
        return "is your own effect, for which the file has no term"
    kind = EFFECTS[effect].kind
    if kind in _OF_READING:
        return "is an error of the reading, not of the joint"
    if kind is Kind.RUN_DIFFERENCES:
        return "differs from run to run"
    return f"has no term in the file ({EFFECTS[effect].equation})"


def _shown(parameter: ParameterEstimate) -> str:
    low, high = parameter.interval
    known = f"95 %: {low:.4g} to {high:.4g}" if isfinite(low) and isfinite(high) else "no interval"
    return f"{text_with_unit(f'{parameter.value:.5g}', parameter.unit)} ({known})"


def as_comment(text: str) -> str:
    """Make text one line that cannot end a comment of Python or C, or a docstring.

    Args:
        text: any text, such as the name of a file; line breaks become blanks.
    """
    plain = json.dumps(" ".join(text.split()), ensure_ascii=True)[1:-1].replace("\\", "/")
    return plain.replace('/"', "'").replace("*/", "* /").replace("/*", "/ *")
