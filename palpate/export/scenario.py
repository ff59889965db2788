"""Writes fitted models of an object and of joints as one simulated world."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.study import Revision
from estimation.surface import Surface
from palpate.export.terms import ARM, CONTACT, JOINT, SENSOR, Entry, lost
from robot_io.errors import InputError
from robot_io.files.file_model import validate
from sim_backend.imperfection import Imperfection, parse_imperfection
from sim_backend.scenario import Scenario

Effects = dict[str, dict[str, float]]  # parameters by effect, by their own names
SILENT = frozenset({"rigid_body"})  # what the simulated arm is anyway


@dataclass(frozen=True)
class FittedChannel:
    """What is known of one channel."""

    revision: Revision  # the fitted model
    # Where the channel's depth counts from, along the downward press direction; None if given.
    surface: Surface | None
    joint_count: int  # of the arm; 0 for a contact that came without one

    @property
    def is_contact(self) -> bool:
        """Whether it is the object's."""
        return self.revision.channel.startswith("contact")


@dataclass(frozen=True)
class Export:
    """A simulated world."""

    scenario: Scenario  # the world
    used: tuple[str, ...]  # what went into it, one line each
    left_out: tuple[str, ...]  # what the simulator cannot do, with the reason, one line each


def export_scenario(base: Scenario, fitted: Sequence[FittedChannel], description: str) -> Export:
    """The world that behaves as the fitted models say.

    Args:
        base: what the models say nothing of: sensors, arm, physics. What is hidden in it is dropped.
        fitted: one for each channel.
        description: one line for people.

    Raises:
        InputError: a fitted object makes no sense as a simulated one.
    """
    scenario = base.with_hidden(()).model_copy(update={"description": description})
    hidden: list[Imperfection] = []
    used: list[str] = []
    left_out: list[str] = []
    taken = _told_by_the_contact(
        fitted
    )  # effects that belong to no single joint, and where they were found first
    swallowed_n = 0.0 if taken else _swallowed_n(fitted)
    for channel in fitted:
        effects = _by_effect(channel.revision)
        where = channel.revision.channel
        if channel.is_contact:
            scenario, lines = _with_object(scenario, effects, channel.surface, swallowed_n)
            used += lines
        for name, values in effects.items():
            if name in ARM and taken.setdefault(name, where) != where:
                left_out.append(f"{where}: '{name}' is one for the whole arm, and taken from {taken[name]}")
                continue
            made, lines = _entries(name, values, channel)
            hidden += made
            (used if made else left_out).extend(f"{where}: {line}" for line in lines)
            left_out += [f"{where}: {line}" for line in lost(name, values)]
    return Export(scenario.with_hidden(hidden), tuple(used), tuple(left_out))


def _told_by_the_contact(fitted: Sequence[FittedChannel]) -> dict[str, str]:
    """What the contact's own model says already: a dead band that the joints found is the same one."""
    contacts = [
        one.revision.channel for one in fitted if one.is_contact and "deadband" in _by_effect(one.revision)
    ]
    return {"force_deadband": contacts[0]} if contacts else {}


def _swallowed_n(fitted: Sequence[FittedChannel]) -> float:
    """Force [N] that the sensor swallows, as the joints tell; the contact took it for a deeper surface."""
    found = (_by_effect(one.revision).get("force_deadband") for one in fitted)
    return next((effect["width"] for effect in found if effect), 0.0)


def _by_effect(revision: Revision) -> Effects:
    found: Effects = defaultdict(dict)
    for name, parameter in revision.parameters.items():
        effect, _, own = name.partition(".")
        found[effect][own] = parameter.value
    return dict(found)


def _with_object(
    scenario: Scenario, effects: Effects, surface: Surface | None, swallowed_n: float
) -> tuple[Scenario, list[str]]:
    """Put spring, damper and surface into the object itself, and take them off the list."""
    spring, damper = effects.pop("stiffness", None), effects.pop("damping", None)
    law: dict[str, object] | None = None
    if spring is not None or damper is not None:
        stiffness, damping = (spring or {}).get("k", 0.0), (damper or {}).get("c", 0.0)
        law = {"name": "kelvin_voigt", "stiffness_n_m": stiffness, "damping_n_s_m": max(damping, 0.0)}
    elif "hunt_crossley" in effects:
        power = effects.pop("hunt_crossley")
        law = {
            "name": "hunt_crossley",
            "stiffness": power["k"],
            "damping": power["b"],
            "exponent": power["n"],
        }
    if law is None:
        raise InputError("the contact's model has neither a spring nor a Hunt-Crossley law to simulate")
    changed: dict[str, object] = {"law": law}
    lines = ["object: " + ", ".join(f"{key} {_shown(value)}" for key, value in law.items())]
    if damper and damper["c"] < 0.0:
        lines.append(
            f"object: a damping of {damper['c']:.3g} N s/m would feed energy in, and is simulated as 0"
        )
    if surface is not None:
        deeper = effects.pop("contact_offset", {"offset": 0.0})["offset"]
        unseen_m = swallowed_n / spring["k"] if spring and spring["k"] > 0.0 else 0.0
        changed["surface_height_m"] = -(surface.position_m + deeper - unseen_m)
        lines.append(f"object: surface_height_m {_shown(changed['surface_height_m'])}")
    data = scenario.model_dump()
    return validate(Scenario, data | {"object": data["object"] | changed}), lines


def _entries(
    name: str, values: Mapping[str, float], channel: FittedChannel
) -> tuple[list[Imperfection], list[str]]:
    """One effect as entries of the scenario, or the reason why that cannot be."""
    if name in SILENT:
        return [], []
    terms = {**SENSOR, **(CONTACT if channel.is_contact else {**JOINT, **ARM})}
    if name not in terms:
        return [], [f"the simulator has no effect '{name}'"]
    try:
        placed = [_place(str(entry["effect"]), channel) | entry for entry in terms[name](values)]
        made = [parse_imperfection(entry) for entry in placed]
    except (InputError, ZeroDivisionError) as error:
        return [], [f"the simulator cannot do '{name}' with these values: {error}"]
    return made, [_words(entry) for entry in placed]


def _place(effect: str, channel: FittedChannel) -> Entry:
    where = channel.revision.channel
    if effect in SENSOR:
        return {"channel": "contact" if channel.is_contact else where}
    if channel.is_contact or effect == "gravity_tilt":
        return {}
    if effect == "payload":
        return {"joint": channel.joint_count}
    return {"joint": int(where.removeprefix("joint_"))}


def _words(entry: Entry) -> str:
    return f"{entry['effect']} " + ", ".join(f"{k} {_shown(v)}" for k, v in entry.items() if k != "effect")


def _shown(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
