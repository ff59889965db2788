"""Write fitted models of an object and of joints as one simulated world.

Estimation and simulation are independent code; this is the one place that maps effects of the one to effects
of the other. An effect that is not here, or whose values the simulator refuses, is reported to the user.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import atan2, hypot

from palpate.estimation.channel import Surface
from palpate.export.target_terms import mean_of_directions
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import validate
from palpate.sim_backend.imperfection import Imperfection, parse_imperfection
from palpate.sim_backend.scenario import Scenario

Values = Mapping[str, float]  # fitted parameters of one effect, by their own names
Entry = dict[str, object]  # entry of a scenario's section `hidden`, without the place
# Entries by the values of an effect; without the key "effect", an entry is of the same effect.
Term = Callable[[Values], list[Entry]]

_GONE_BY_NEXT_RUN_S = 0.1
# A stiffer bristle, force over slip, would swing within a step of the simulator's physics.
SHORTEST_SLIP_M = 1e-6


def _renamed(**names: str) -> Term:
    """Make a term of the same effect with renamed parameters: scenario's name = fitted name."""
    return lambda p: [{key: p[name] for key, name in names.items()}]


CONTACT: Mapping[str, Term] = {
    # a neck that thins out linearly takes as much work as an exponential one of half the length
    "adhesion": lambda p: [{"pull_off_n": p["force"], "neck_m": 2.0 * p["reach"]}],
    # fitted: how much deeper the surface lies; simulated: how much higher
    "contact_offset": lambda p: [{"offset_m": -p["offset"]}],
    "cubic_stiffness": _renamed(cubic_n_m3="k3"),
    "dry_friction": lambda p: [{"friction_n": p["force"], "slip_m": max(p["presliding"], SHORTEST_SLIP_M)}],
    "hunt_crossley": _renamed(stiffness="k", damping="b", exponent="n"),
    "layered_stiffness": _renamed(stiffness_n_m="k2", depth_m="depth"),
    # fitted: what is left by the next run; simulated: how fast it goes, where zero is never
    "plastic_set": lambda p: [
        {"share": p["share"], "recovery_s": 0.0 if p["kept"] > 0.5 else _GONE_BY_NEXT_RUN_S}
    ],
    "quadratic_damping": _renamed(damping_n_s2_m2="c2"),
    "stress_relaxation": _renamed(stiffness_n_m="k1", time_s="tau"),
    "tool_compliance": _renamed(compliance_m_n="compliance"),
}

JOINT: Mapping[str, Term] = {
    "armature": _renamed(inertia_kg_m2="inertia"),
    "asymmetric_friction": _renamed(positive_nm="forward", negative_nm="backward"),
    "backlash": _renamed(gap_rad="gap"),
    "coulomb_friction": _renamed(coulomb_nm="force"),
    "joint_elasticity": _renamed(compliance_rad_nm="compliance"),
    "joint_spring": lambda p: [
        {"stiffness_nm_rad": p["k"], "rest_rad": -p["preload"] / p["k"] if p["k"] else 0.0}
    ],
    "load_dependent_friction": _renamed(load_share="mu"),
    "quadratic_friction": _renamed(quadratic_nms2_rad2="d2"),
    "stribeck_friction": _renamed(coulomb_nm="coulomb", stiction_nm="rise", speed_rad_s="speed"),
    # fitted: reading over true torque; simulated: true torque over reading
    "torque_gain": lambda p: [{"gain": 1.0 / p["gain"]}],
    # one entry for each multiple of the cycles: sine, sine_2 ... with their cosines
    "torque_ripple": lambda p: [
        {
            "amplitude_nm": hypot(sine, p[f"co{name}"]),
            "cycles": int(name.partition("_")[2] or 1) * p["cycles"],
            "phase_rad": atan2(p[f"co{name}"], sine),
        }
        for name, sine in p.items()
        if name.startswith("sine")
    ],
    "viscous_friction": _renamed(viscous_nms_rad="d"),
}

ARM: Mapping[str, Term] = {  # effects of the whole arm
    "encoder_zero": lambda p: [
        {"effect": "bias", "channel": joint.replace("joint", "encoder"), "bias": offset}
        for joint, offset in p.items()
    ],
    "gravity_tilt": lambda p: [
        {"pitch_rad": p["tilt"]} if "tilt" in p else {"pitch_rad": p["pitch"], "roll_rad": p["roll"]}
    ],
    "force_deadband": lambda p: [{"effect": "deadband", "half_width": p["width"], "channel": "contact"}],
    "payload": _renamed(mass_kg="mass"),
}

SENSOR: Mapping[str, Term] = {
    "bias": _renamed(bias="offset"),
    "deadband": _renamed(half_width="width"),
    "delay": _renamed(delay_s="time"),
    "drift": lambda p: [{"rate_1_s": p["rate"]}, {"effect": "bias", "bias": p["offset"]}],
    "hysteresis": _renamed(half_width="width"),
    "lag": _renamed(time_s="tau"),
    "quantisation": _renamed(step="step"),
    "saturation": _renamed(limit="limit"),
}


Effects = dict[str, dict[str, float]]  # parameters by effect, by their own names
SILENT = frozenset({"rigid_body"})  # effects that the simulated arm has anyway


@dataclass(frozen=True)
class FittedChannel:
    """A channel's fitted model with its surface."""

    name: str  # name of the channel
    values: Values  # fitted parameters by "effect.parameter"
    # Where the channel's depth counts from, along the downward press direction; None if given.
    surface: Surface | None
    joint_count: int  # number of joints of the arm; 0 for a contact that came without one

    @property
    def is_contact(self) -> bool:
        """Whether the channel is a contact."""
        return self.name.startswith("contact")


@dataclass(frozen=True)
class Export:
    """A simulated world."""

    scenario: Scenario  # the world
    used: tuple[str, ...]  # what went into it, one line each
    left_out: tuple[str, ...]  # what the simulator cannot do, with the reason, one line each


def export_scenario(base: Scenario, fitted: Sequence[FittedChannel], description: str) -> Export:
    """Make a simulated world that behaves like the fitted models.

    Args:
        base: sensors, arm and physics, which the models do not include. Its hidden effects are dropped.
        fitted: fitted model of each channel.
        description: one line for people.

    Raises:
        InputError: a fitted object cannot be simulated.
    """
    scenario = base.with_hidden(()).model_copy(update={"description": description})
    hidden: list[Imperfection] = []
    used: list[str] = []
    left_out: list[str] = []
    # A dead band found in the joints is the one in the contact's model.
    by_channel: list[tuple[FittedChannel, Effects]] = []
    for channel in fitted:
        values_of: Effects = defaultdict(dict)
        for name, value in channel.values.items():
            effect, _, own = name.partition(".")
            values_of[effect][own] = value
        if "asymmetric_friction" in values_of:  # the simulator has one viscosity for both directions
            _, viscous = mean_of_directions(values_of["asymmetric_friction"])
            total = values_of["viscous_friction"].get("d", 0.0) + viscous
            values_of["viscous_friction"]["d"] = max(total, 0.0)
            if total < 0.0:
                falling = f"friction that falls with speed ({total:.3g} N m s/rad)"
                left_out.append(f"{channel.name}: {falling} is simulated as constant")
        by_channel.append((channel, dict(values_of)))
    contacts = [fit.name for fit, effects in by_channel if fit.is_contact and "deadband" in effects]
    # effects of the whole arm, and the channel in which each was found first
    taken = {"force_deadband": contacts[0]} if contacts else {}
    # Forces below which the sensor reads zero [N], from joints; the contact fit moved the surface instead.
    deadbands = [effects["force_deadband"] for _, effects in by_channel if "force_deadband" in effects]
    deadband_n = deadbands[0]["width"] if deadbands and not taken else 0.0
    for channel, effects in by_channel:
        where = channel.name
        if channel.is_contact:
            scenario, lines = _with_object(scenario, effects, channel.surface, deadband_n)
            used += lines
        for name, values in effects.items():
            if name in ARM and taken.setdefault(name, where) != where:
                left_out.append(f"{where}: '{name}' applies to the whole arm and is taken from {taken[name]}")
                continue
            made, lines = _entries(name, values, channel)
            hidden += made
            (used if made else left_out).extend(f"{where}: {line}" for line in lines)
            if name == "dry_friction" and values["presliding"] < SHORTEST_SLIP_M:
                left_out.append(
                    f"{where}: simulated dry_friction cannot change sign over less than "
                    f"{SHORTEST_SLIP_M:.0e} m, so its presliding of {values['presliding']:.2g} m and "
                    f"transition of {values['transition']:.2g} m/s are left out"
                )
    if "encoder_zero" in taken and any(channel.surface for channel in fitted):
        left_out.append(
            "object: surface_height_m is as the wrong encoders show it; the simulated zeros shift it again"
        )
    return Export(scenario.with_hidden(hidden), tuple(used), tuple(left_out))


def _with_object(
    scenario: Scenario, effects: Effects, surface: Surface | None, deadband_n: float
) -> tuple[Scenario, list[str]]:
    """Move spring, damper and surface into the object itself, and out of the list of effects."""
    spring, damper = effects.pop("stiffness", None), effects.pop("damping", None)
    law: dict[str, object] | None = None
    if spring is not None or damper is not None:
        stiffness, damping = (spring or {}).get("k", 0.0), (damper or {}).get("c", 0.0)
        law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness, "damping_n_s_m": max(damping, 0.0)}
    elif "hunt_crossley" in effects:
        law = {"name": "hunt_crossley", **CONTACT["hunt_crossley"](effects.pop("hunt_crossley"))[0]}
    if law is None:
        raise InputError("the contact's model has neither a spring nor a Hunt-Crossley law to simulate")
    changed: dict[str, object] = {"law": law}
    lines = ["object: " + ", ".join(f"{key} {_shown(value)}" for key, value in law.items())]
    if damper and damper["c"] < 0.0:
        lines.append(
            f"object: a damping of {damper['c']:.3g} N s/m would add energy, so it is simulated as 0"
        )
    if surface is not None:
        deeper = effects.pop("contact_offset", {"offset": 0.0})["offset"]
        unseen_m = deadband_n / spring["k"] if spring and spring["k"] > 0.0 else 0.0
        changed["surface_height_m"] = -(surface.position_m + deeper - unseen_m)
        lines.append(f"object: surface_height_m {_shown(changed['surface_height_m'])}")
    data = scenario.model_dump()
    return validate(Scenario, data | {"object": data["object"] | changed}), lines


def _entries(
    name: str, values: Mapping[str, float], channel: FittedChannel
) -> tuple[list[Imperfection], list[str]]:
    """Convert one effect to entries of the scenario, or return the reason why not."""
    if name in SILENT:
        return [], []
    terms = {**SENSOR, **(CONTACT if channel.is_contact else {**JOINT, **ARM})}
    if name not in terms:
        return [], [f"the simulator has no effect '{name}'"]
    where, placed = channel.name, []
    try:
        for own in terms[name](values):
            entry: Entry = {"effect": name, **own}
            place: Entry = {}
            if entry["effect"] in SENSOR:
                place = {"channel": "contact" if channel.is_contact else where}
            elif entry["effect"] == "payload" and not channel.is_contact:
                place = {"joint": channel.joint_count}
            elif entry["effect"] != "gravity_tilt" and not channel.is_contact:
                place = {"joint": int(where.removeprefix("joint_"))}
            placed.append(place | entry)
        made = [parse_imperfection(entry) for entry in placed]
    except (InputError, ZeroDivisionError) as error:
        return [], [f"the simulator cannot represent '{name}' with these values: {error}"]
    lines = [
        f"{entry['effect']} " + ", ".join(f"{k} {_shown(v)}" for k, v in entry.items() if k != "effect")
        for entry in placed
    ]
    return made, lines


def _shown(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
