"""How each effect of a fitted model is called in a scenario, and what becomes of its parameters.

Estimation and simulation were written apart from each other on purpose; this is the one place where their
words meet. An effect that is not here, or whose values the simulator refuses, is reported to the user.
"""

from collections.abc import Callable, Iterator, Mapping
from math import atan2, hypot

Values = Mapping[str, float]  # fitted parameters of one effect, by their own names
Entry = dict[str, object]  # of a scenario's section `hidden`, without the place
Term = Callable[[Values], list[Entry]]

_GONE_BY_NEXT_RUN_S = 0.1
# A stiffer bristle, force over slip, would swing within a step of the simulator's physics.
SHORTEST_SLIP_M = 1e-6


def _one(effect: str, **names: str) -> Term:
    """The effect of the same name, its parameters renamed: scenario's name = fitted name."""
    return lambda p: [{"effect": effect} | {key: p[name] for key, name in names.items()}]


def _drift(p: Values) -> list[Entry]:
    return [{"effect": "drift", "rate_1_s": p["rate"]}, {"effect": "bias", "bias": p["offset"]}]


def _adhesion(p: Values) -> list[Entry]:
    # a neck that thins out linearly takes as much work as an exponential one of half the length
    return [{"effect": "adhesion", "pull_off_n": p["force"], "neck_m": 2.0 * p["reach"]}]


def _viscous(p: Values) -> float:
    return 0.5 * (p["viscous_forward"] + p["viscous_backward"])


def _asymmetric(p: Values) -> list[Entry]:
    friction: Entry = {
        "effect": "asymmetric_friction",
        "positive_nm": p["forward"],
        "negative_nm": p["backward"],
    }
    return [friction, {"effect": "viscous_friction", "viscous_nms_rad": max(_viscous(p), 0.0)}]


def _ripple(p: Values) -> list[Entry]:
    multiples = [int(name.partition("_")[2] or 1) for name in p if name.startswith("sine")]
    waves: list[Entry] = []
    for m in multiples:
        end = f"_{m}" if m > 1 else ""
        sine, cosine = p[f"sine{end}"], p[f"cosine{end}"]
        waves.append(
            {
                "effect": "torque_ripple",
                "amplitude_nm": hypot(sine, cosine),
                "cycles": m * p["cycles"],
                "phase_rad": atan2(cosine, sine),
            }
        )
    return waves


def _torque_gain(p: Values) -> list[Entry]:
    # fitted: reading over true torque; simulated: true torque over reading
    return [{"effect": "torque_gain", "gain": 1.0 / p["gain"]}]


def _offset(p: Values) -> list[Entry]:
    # fitted: how much deeper the surface lies; simulated: how much higher
    return [{"effect": "contact_offset", "offset_m": -p["offset"]}]


def _joint_spring(p: Values) -> list[Entry]:
    rest_rad = -p["preload"] / p["k"] if p["k"] else 0.0
    return [{"effect": "joint_spring", "stiffness_nm_rad": p["k"], "rest_rad": rest_rad}]


def _plastic_set(p: Values) -> list[Entry]:
    # fitted: what is left by the next run; simulated: how fast it goes, where zero is never
    recovery_s = 0.0 if p["kept"] > 0.5 else _GONE_BY_NEXT_RUN_S
    return [{"effect": "plastic_set", "share": p["share"], "recovery_s": recovery_s}]


def _dry_friction(p: Values) -> list[Entry]:
    slip_m = max(p["presliding"], SHORTEST_SLIP_M)
    return [{"effect": "dry_friction", "friction_n": p["force"], "slip_m": slip_m}]


def lost(effect: str, p: Values) -> Iterator[str]:
    """What of a fitted effect is simulated otherwise, in a sentence."""
    if effect == "asymmetric_friction" and _viscous(p) < 0.0:
        yield f"asymmetric_friction that falls by {-_viscous(p):.3g} N m s/rad is simulated as level"
    if effect == "dry_friction" and p["presliding"] < SHORTEST_SLIP_M:
        yield (
            f"dry_friction turns round over {SHORTEST_SLIP_M:.0e} m, the shortest way that is simulated: its "
            f"presliding of {p['presliding']:.2g} m and transition of {p['transition']:.2g} m/s are left out"
        )


CONTACT: Mapping[str, Term] = {
    "adhesion": _adhesion,
    "contact_offset": _offset,
    "cubic_stiffness": _one("cubic_stiffness", cubic_n_m3="k3"),
    "dry_friction": _dry_friction,
    "hunt_crossley": _one("hunt_crossley", stiffness="k", damping="b", exponent="n"),
    "layered_stiffness": _one("layered_stiffness", stiffness_n_m="k2", depth_m="depth"),
    "plastic_set": _plastic_set,
    "quadratic_damping": _one("quadratic_damping", damping_n_s2_m2="c2"),
    "stress_relaxation": _one("stress_relaxation", stiffness_n_m="k1", time_s="tau"),
    "tool_compliance": _one("tool_compliance", compliance_m_n="compliance"),
}

JOINT: Mapping[str, Term] = {
    "armature": _one("armature", inertia_kg_m2="inertia"),
    "asymmetric_friction": _asymmetric,
    "backlash": _one("backlash", gap_rad="gap"),
    "coulomb_friction": _one("coulomb_friction", coulomb_nm="force"),
    "joint_elasticity": _one("joint_elasticity", compliance_rad_nm="compliance"),
    "joint_spring": _joint_spring,
    "load_dependent_friction": _one("load_dependent_friction", load_share="mu"),
    "quadratic_friction": _one("quadratic_friction", quadratic_nms2_rad2="d2"),
    "stribeck_friction": _one(
        "stribeck_friction", coulomb_nm="coulomb", stiction_nm="rise", speed_rad_s="speed"
    ),
    "torque_gain": _torque_gain,
    "torque_ripple": _ripple,
    "viscous_friction": _one("viscous_friction", viscous_nms_rad="d"),
}

ARM: Mapping[str, Term] = {  # effects that belong to no single joint
    "gravity_tilt": _one("gravity_tilt", pitch_rad="tilt"),
    "force_deadband": lambda p: [{"effect": "deadband", "half_width": p["width"], "channel": "contact"}],
    "payload": _one("payload", mass_kg="mass"),
}

SENSOR: Mapping[str, Term] = {
    "bias": _one("bias", bias="offset"),
    "deadband": _one("deadband", half_width="width"),
    "delay": _one("delay", delay_s="time"),
    "drift": _drift,
    "hysteresis": _one("hysteresis", half_width="width"),
    "lag": _one("lag", time_s="tau"),
    "quantisation": _one("quantisation", step="step"),
    "saturation": _one("saturation", limit="limit"),
}
