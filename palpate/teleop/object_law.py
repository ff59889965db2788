"""An object as it travels over the line, and the force law that the operator feels of it.

Laws and effects are the simulator's own, so whatever a diagnosis can establish and `palpate export` can write
can be felt. Values are checked as those of a scenario file are.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from control.teleop.virtual_object import ForceLaw
from robot_io.errors import InputError
from robot_io.link import ContactModel, ObjectEstimate
from sim_backend.contact import ObjectResponse
from sim_backend.contact_law import describe_contact_law, parse_contact_law
from sim_backend.hidden import hidden_effects
from sim_backend.hooks import ContactState
from sim_backend.imperfection import Imperfection, describe_imperfection, parse_imperfection
from sim_backend.scenario import Scenario

_ONE_JOINT = 1  # contact effects ask for none


def terms_of(scenario: Scenario) -> tuple[ContactModel, ...]:
    """A scenario's object: its contact law, then the effects that act between it and the tip."""
    law = describe_contact_law(scenario.object.law)
    hidden = [describe_imperfection(entry) for entry in scenario.hidden if _is_felt(entry)]
    return (_term(law, "name"), *(_term(entry, "effect") for entry in hidden))


def force_law(terms: Sequence[ContactModel]) -> ForceLaw:
    """The law of an object, with a memory of its own; for `control.teleop.virtual_object.VirtualObject`.

    Raises:
        InputError: there is no such law or effect, or a value is out of its range.
    """
    if not terms:
        raise InputError("an object without a contact law")
    law, *entries = (dict(zip(term.keys, term.values, strict=True)) for term in terms)
    contact = parse_contact_law({"name": terms[0].name, **law})
    named = zip(terms[1:], entries, strict=True)
    hidden = [parse_imperfection({"effect": term.name, **entry}) for term, entry in named]
    if others := [entry.name for entry in hidden if not _is_felt(entry)]:
        raise InputError(f"effect '{others[0]}' does not act between object and tip")
    answer, time_s = ObjectResponse(hidden_effects(hidden, _ONE_JOINT)), 0.0

    def force_n(depth_m: float, rate_m_s: float, dt_s: float) -> float:
        nonlocal time_s
        time_s += dt_s
        return answer.force_n(contact, ContactState(time_s, dt_s, depth_m, rate_m_s))

    return force_n


def felt_data(estimate: ObjectEstimate) -> dict[str, object]:
    """An estimate as a session's event keeps it: enough to feel it again."""
    return {
        "revision": estimate.revision,
        "target": estimate.target,
        "surface_world_m": estimate.surface_world_m,
        "model": [[term.name, dict(zip(term.keys, term.values, strict=True))] for term in estimate.model],
        "parameters": {one.name: (one.value, one.lower, one.upper) for one in estimate.parameters},
        "verdict": estimate.verdict,
    }


def terms_in(data: Mapping[str, Any]) -> tuple[ContactModel, ...]:
    """The object's model in what `felt_data` made. InputError: it is none."""
    try:
        return tuple(
            ContactModel(name, tuple(values), tuple(map(float, values.values())))
            for name, values in data["model"]
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"an event '{data.get('revision')}' of the session holds no model: {error}"
        ) from error


def _is_felt(entry: Imperfection) -> bool:
    if entry.channels != ("contact",):
        return False
    effects = hidden_effects([entry], _ONE_JOINT)
    return bool(effects.contact or effects.tool)


def _term(entry: dict[str, object], name_key: str) -> ContactModel:
    numbers = {key: float(v) for key, v in entry.items() if isinstance(v, int | float) and v is not False}
    return ContactModel(str(entry[name_key]), tuple(numbers), tuple(numbers.values()))
