"""Table of how each simulator format represents each effect of a joint, or why it cannot."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import isfinite

from palpate.estimation.estimate import ParameterEstimate
from palpate.export.feedforward import SYMMETRIC, FittedJoint, mean_of_directions, reason_left_out


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
    units: Mapping[str, str] = field(default_factory=dict)  # limited to these parameters


def _named(lost: str = "", **names: str) -> TargetTerm:
    """Make values from fitted parameters: target's name = fitted name."""
    return TargetTerm(lambda p: {key: p[name] for key, name in names.items()}, lost)


_ONE_LEVEL = "dry friction has one level at all speeds: the rise at low speed is left out"
_AT_ONCE = "dry friction changes sign at once: the path over which it builds up is left out"
_NO_PLACE = "dry friction has one level everywhere: its variation with position is left out"
_OF_BODIES = "includes everything the joint carries: set masses and inertias of the bodies by hand"
_NO_BIAS = "may be a constant effort or the sensor's zero, which the motion cannot distinguish"
_NO_LOAD = "is left out: the target has no friction that grows with the load"
_LATE = "delays the reading; if it is negative, the motion is late: set a delay of the action by hand"
_GAIN = "scales the torque reading: on the real joint, divide the reading by this gain"

# Reasons for every target; `TABLE` takes precedence.
REASONS: Mapping[str, str] = {
    "bias": _NO_BIAS,
    "gravity_tilt": "is the weight of a single pendulum: to get a tilt angle, fit with the arm's URDF",
    "inertia": _OF_BODIES,
    "pendulum": _OF_BODIES,
    "rigid_body_fitted": _OF_BODIES,
    "weight": _OF_BODIES,
}
SILENT = frozenset({"rigid_body"})  # stated in the arm's own file
_TILT = dict.fromkeys(("tilt", "pitch", "roll"), "rad")


def _friction(dry: Sequence[str], viscous: str) -> dict[str, TargetTerm | str]:
    """Return the terms of dry and viscous friction for a target with these names for their levels."""

    def level(fitted: str, lost: str = "") -> TargetTerm:
        return _named(lost, **dict.fromkeys(dry, fitted))

    return {
        "asymmetric_friction": TargetTerm(
            lambda p: {
                **dict.fromkeys(dry, mean_of_directions(p)[0]),
                viscous: mean_of_directions(p)[1],
            },
            SYMMETRIC,
        ),
        "coulomb_friction": level("force"),
        "damping": _named(**{viscous: "c"}),
        "position_dependent_friction": level("level", _NO_PLACE),
        "presliding_friction": level("force", _AT_ONCE),
        "stribeck_friction": level("coulomb", _ONE_LEVEL),
        "viscous_friction": _named(**{viscous: "d"}),
    }


_NO_LOADS = dict.fromkeys(("load_dependent_friction", "load_dependent_presliding"), _NO_LOAD)
TABLE: Mapping[SimulatorFormat, Mapping[str, TargetTerm | str]] = {
    SimulatorFormat.MJCF: {
        **_friction(("frictionloss",), "damping"),
        **_NO_LOADS,
        "armature": _named(armature="inertia"),
        "backlash": _named("the motor's share of inertia and friction stays with the first joint", gap="gap"),
        "cubic_stiffness": _named(cubic="k3"),
        "delay": TargetTerm(
            lambda p: {"sensor_delay_s": p["time"]} if p["time"] > 0.0 else {},
            "if it is negative, the motion is late: set a delay of the actuator by hand",
        ),
        "gravity_tilt": TargetTerm(lambda p: {f"{key}_rad": angle for key, angle in p.items()}, units=_TILT),
        "joint_elasticity": "needs a second body behind a spring",
        "joint_spring": _named(stiffness="k", preload="preload"),
        "payload": _named(payload_kg="mass"),
        "quadratic_friction": _named(damping_quadratic="d2"),
        "stiffness": _named(stiffness="k"),
        "torque_gain": TargetTerm(lambda p: {"gear": 1.0 / p["gain"]}),
        "torque_ripple": "only a <dcmotor> has cogging",
    },
    SimulatorFormat.URDF: {
        **_friction(("friction",), "damping"),
        **_NO_LOADS,
        "armature": "a URDF has no inertia of a rotor",
        "gravity_tilt": "a URDF has no gravity: tilt the base where the arm is placed in the world",
        "payload": _named(payload_kg="mass"),
        "torque_gain": _GAIN,
    },
    SimulatorFormat.ISAACLAB: {
        **_friction(("friction", "dynamic_friction"), "viscous_friction"),
        **_NO_LOADS,
        "armature": _named(armature="inertia"),
        "backlash": "needs a second joint in the USD",
        "delay": _LATE,
        "gravity_tilt": "is set in the scene: SimulationCfg(gravity=...)",
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
        "armature": _named(armature="inertia"),
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
OF_ARM = frozenset({"tilt_rad", "pitch_rad", "roll_rad", "payload_kg"})  # values of the whole arm


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


def express(
    joints: Sequence[FittedJoint],
    target: SimulatorFormat,
    source: str,
    names: Sequence[str] = (),
    rotors: Sequence[float] = (),
) -> TargetArm:
    """Look up in `TABLE` what a target can express of fitted joints.

    Args:
        joints: with their fits.
        target: the simulator.
        source: description of the measurement.
        names: names of all joints of the arm in its file, from the base outwards; empty if unknown.
        rotors: inertia [kg m^2] of each joint's rotor that is in the base model; empty for none.
    """
    targets, left_out = list[TargetJoint](), list[str]()
    arm: dict[str, tuple[float, TermValue, str]] = {}  # half interval, value, channel
    for joint in sorted(joints, key=lambda each: each.number):
        own: dict[str, TermValue] = {}
        lost = list[str]()
        rotor = rotors[joint.number - 1] if joint.number <= len(rotors) else 0.0
        if rotor and isinstance(TABLE[target].get("armature"), TargetTerm):
            own["armature"] = TermValue(rotor, (f"rotor of the robot file {rotor:.5g} kg m^2",))
        for effect, parameters in joint.by_effect.items():
            term = TABLE[target].get(effect, reason_left_out(effect, REASONS, "file"))
            fitted = tuple(f"{effect}.{name} {_shown(each)}" for name, each in parameters.items())
            units = {} if isinstance(term, str) else term.units
            if isinstance(term, str) or any(units.get(p, e.unit) != e.unit for p, e in parameters.items()):
                if effect not in SILENT:
                    reason = term if isinstance(term, str) else REASONS[effect]
                    lost.append("; ".join([f"'{effect}' {reason}", *fitted]))
                continue
            numbers = term.values({name: each.value for name, each in parameters.items()})
            for key, number in numbers.items():
                if key not in OF_ARM:
                    before = own.get(key, TermValue(0.0, ()))
                    own[key] = TermValue(before.number + number, before.fitted + fitted)
                    continue
                half = max(each.half_interval for each in parameters.values())
                rank = half if isfinite(half) else float("inf")
                once = f"'{effect}' has one value for the whole arm; it is taken from the channel with the "
                if key in arm and (once := f"{once}smallest interval") not in lost:
                    lost.append(once)
                if key not in arm or rank < arm[key][0]:
                    arm[key] = (rank, TermValue(number, fitted), joint.name)
            if term.lost:
                lost.append(f"'{effect}': {term.lost}")
            lost += [
                f"{effect}.{name} {_shown(each)} is exported, but its interval includes zero"
                for name, each in parameters.items()
                if each.interval[0] <= 0.0 <= each.interval[1]
            ]
        if "asymmetric_friction" in joint.by_effect:  # its viscous part alone may be negative
            own = {key: replace(value, number=max(value.number, 0.0)) for key, value in own.items()}
        name = names[joint.number - 1] if joint.number <= len(names) else joint.name
        targets.append(TargetJoint(joint.name, name, own, tuple(lost)))
        left_out += [f"{joint.name}: {line}" for line in lost]
    whole = {key: value for key, (_, value, _) in arm.items()}
    return TargetArm(source, tuple(targets), whole, tuple(left_out))


def _shown(parameter: ParameterEstimate) -> str:
    low, high = parameter.interval
    known = f"95 %: {low:.4g} to {high:.4g}" if isfinite(low) and isfinite(high) else "no interval"
    return f"{parameter.value:.5g} {parameter.unit} ({known})"
