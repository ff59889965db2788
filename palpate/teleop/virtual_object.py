"""Virtual object: force law, estimates so far, and a summary line.

Laws and effects come from the simulator, so every effect that a diagnosis can accept and `palpate export` can
write can be rendered. Values are checked like those of a scenario file.
"""

from collections.abc import Mapping, Sequence
from math import dist, inf, isfinite
from typing import Any

import numpy as np

from palpate.common.console import count, plus_minus, significant
from palpate.control.loop.task import IN_CONTACT, Phase
from palpate.control.teleop.force_mismatch import MismatchMonitor
from palpate.control.teleop.virtual_object import ForceLaw
from palpate.robot_io.errors import InputError
from palpate.robot_io.link.messages import MOST_TARGETS, ContactModel, ObjectEstimate, Report, short_number
from palpate.sim_backend.contact import ObjectResponse
from palpate.sim_backend.contact_laws import parse_contact_law
from palpate.sim_backend.hidden import hidden_effects
from palpate.sim_backend.hooks import ContactState
from palpate.sim_backend.imperfection import Imperfection, parse_imperfection
from palpate.sim_backend.scenario import Scenario

_ONE_JOINT = 1  # contact effects use no joints


def terms_of(scenario: Scenario) -> tuple[ContactModel, ...]:
    """Return a scenario's contact law and the effects between object and tip.

    Args:
        scenario: a simulated world.
    """
    law = scenario.object.law.describe()
    hidden = [entry.describe() for entry in scenario.hidden if _is_rendered(entry)]
    return (_term(law, "name"), *(_term(entry, "effect") for entry in hidden))


def force_law(terms: Sequence[ContactModel]) -> ForceLaw:
    """Make an object's force law, with its own memory, for a `VirtualObject` of `palpate.control.teleop`.

    Args:
        terms: contact law first, then effects.

    Raises:
        InputError: a law or effect does not exist, or a value is out of its range.
    """
    if not terms:
        raise InputError("the object has no contact law")
    law, *entries = (dict(zip(term.keys, term.values, strict=True)) for term in terms)
    contact = parse_contact_law({"name": terms[0].name, **law})
    named = zip(terms[1:], entries, strict=True)
    hidden = [parse_imperfection({"effect": term.name, **entry}) for term, entry in named]
    if others := [entry.name for entry in hidden if not _is_rendered(entry)]:
        raise InputError(f"effect '{others[0]}' does not act between object and tip")
    response, time_s = ObjectResponse(hidden_effects(hidden, _ONE_JOINT)), 0.0

    def force_n(depth_m: float, rate_m_s: float, dt_s: float) -> float:
        nonlocal time_s
        time_s += dt_s
        return response.force_n(contact, ContactState(time_s, dt_s, depth_m, rate_m_s))

    return force_n


def estimate_data(estimate: ObjectEstimate) -> dict[str, object]:
    """Convert an estimate to an event's data, from which it can be rendered again."""
    return {
        "revision": estimate.revision,
        "target": estimate.target,
        "surface_world_m": estimate.surface_world_m,
        "model": [[term.name, dict(zip(term.keys, term.values, strict=True))] for term in estimate.model],
        "parameters": {
            parameter.name: (parameter.value, parameter.lower, parameter.upper)
            for parameter in estimate.parameters
        },
        "verdict": estimate.verdict,
    }


def terms_in(data: Mapping[str, Any]) -> tuple[ContactModel, ...]:
    """Read the object's model from data of `estimate_data`; raise `InputError` if they are invalid.

    Args:
        data: data of the session's event.
    """
    try:
        return tuple(
            ContactModel(name, tuple(values), tuple(map(float, values.values())))
            for name, values in data["model"]
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"an event '{data.get('revision')}' of the session has no model: {error}") from error


def _is_rendered(entry: Imperfection) -> bool:
    if entry.channels != ("contact",):
        return False
    effects = hidden_effects([entry], _ONE_JOINT)
    return bool(effects.contact or effects.tool)


def _term(entry: dict[str, object], name_key: str) -> ContactModel:
    numbers = {key: float(v) for key, v in entry.items() if isinstance(v, int | float) and v is not False}
    return ContactModel(str(entry[name_key]), tuple(numbers), tuple(numbers.values()))


_SHORT = {"stiffness.k": "k", "damping.c": "c"}
GEOMETRY = ("contact_offset.offset",)


def summarize_estimate(estimate: ObjectEstimate) -> str:
    """Describe an estimate: parameters with 95 % intervals, remaining error, and verdict."""
    parameters = []
    for each in estimate.parameters:
        half = 0.5 * (each.upper - each.lower)
        value = plus_minus(each.value, half) if half > 0.0 else significant(each.value, half)
        if each.name not in GEOMETRY:
            parameters.append(f"{_SHORT.get(each.name, each.name)} {value} {each.unit}")
    verdict = f"; {estimate.verdict}" if estimate.verdict else ""
    return f"{', '.join(parameters)}; {estimate.rmse_n:.3g} N left, {count(estimate.runs, 'run')}{verdict}"


DOWN = (0.0, 0.0, -1.0)  # the only direction in which the virtual object can be pressed


class TargetStates:
    """Estimates by target; the nearest one is rendered, or the scene's object before the first estimate.

    Attributes:
        received: number of estimates.
        rendered: the rendered estimate; None for the guess.
    """

    def __init__(self, scene: Scenario) -> None:
        self.received = 0
        self.rendered: ObjectEstimate | None = None
        self._estimates: dict[int, ObjectEstimate] = {}
        # Newest revision by target, including estimates that cannot be rendered.
        self._revisions: dict[int, int] = {}
        self._law: ForceLaw = force_law(terms_of(scene))
        self._surface_m = np.array((0.0, 0.0, scene.object.surface_height_m))
        self._mismatch, self._reported = MismatchMonitor(), set[object]()
        self._report_s = -inf

    @property
    def seen(self) -> tuple[int, ...]:
        """Revision of the newest estimate of each target, shape (n,) with n at most `MOST_TARGETS`."""
        return tuple(self._revisions.values())[-MOST_TARGETS:]

    def on_new_peer(self) -> None:
        """Reset the revisions for another follower."""
        self._revisions.clear()

    def take(self, estimate: ObjectEstimate) -> bool:
        """Store an estimate and return whether it is new.

        Args:
            estimate: estimate of one target; one with an older or equal revision is ignored.

        Raises:
            InputError: it cannot be rendered, as an object that is not pressed downwards.
        """
        known = self._revisions.pop(estimate.target, -1)
        self._revisions[estimate.target] = max(known, estimate.revision)
        if estimate.revision <= known:
            return False
        self.received += 1
        if dist(estimate.direction_world, DOWN) > 1e-3:
            raise InputError(
                "the press direction of an estimate is not downward; the virtual object requires a downward "
                "press"
            )
        force_law(estimate.model)
        self._estimates[estimate.target] = estimate
        return True

    def choose(self, tip_world_m: tuple[float, ...]) -> ObjectEstimate | None:
        """Return the estimate to render at this place; None if it does not change.

        Args:
            tip_world_m: tip position of the virtual arm, shape (3,) [m].
        """
        if not self._estimates:
            return None
        nearest = min(self._estimates.values(), key=lambda estimate: _distance_m(estimate, tip_world_m))
        if nearest is self.rendered:
            return None
        self.rendered = nearest
        self._law, self._surface_m = force_law(nearest.model), np.array(nearest.surface_world_m)
        self._mismatch, self._reported = MismatchMonitor(max(nearest.noise_n, 0.0)), set()
        return nearest

    def compare(self, report: Report, sent_s: float) -> list[str]:
        """Compare the follower's force with the virtual object's at the same place.

        Args:
            report: report of the follower.
            sent_s: time of sending, on the follower's clock [s].

        Returns:
            Description of a disagreement that was not reported yet; empty otherwise.
        """
        direction = np.array(report.direction_world)
        depth_m = float((np.array(report.tip_world_m) - self._surface_m).dot(direction))
        dt_s = min(max(sent_s - self._report_s, 1e-3), 1.0)
        self._report_s = sent_s
        predicted_n = self._law(depth_m, report.speed_m_s, dt_s)
        if report.phase not in IN_CONTACT:
            return []
        place = (short_number(report.target), Phase(report.phase).name.lower())
        self._mismatch.add(place, depth_m, report.force_n, predicted_n)
        mismatches = [
            mismatch for mismatch in self._mismatch.mismatches() if mismatch.place not in self._reported
        ]
        self._reported.update(mismatch.place for mismatch in mismatches)
        return [f"target {place[0]}, {place[1]}: {mismatch.summary()}" for mismatch in mismatches]

    def summary(self, tip_world_m: tuple[float, ...], age_s: float) -> str:
        """Describe the reliability of the rendered object.

        Args:
            tip_world_m: tip position of the virtual arm, shape (3,) [m].
            age_s: age of the underlying measurement [s]; NaN if unknown.
        """
        estimate = self.rendered
        if estimate is None:
            return "virtual object: a guess, because nothing has been probed yet"
        age = f", {age_s:.0f} s old" if isfinite(age_s) else ""
        away_m = _distance_m(estimate, tip_world_m)  # from the measured place, across the press direction
        away = f", {1e3 * away_m:.0f} mm away" if isfinite(away_m) else ""
        verdict = "" if estimate.verdict else "; not diagnosed"
        return f"target {short_number(estimate.target)}{away}{age}: {summarize_estimate(estimate)}{verdict}"


def _distance_m(estimate: ObjectEstimate, tip_world_m: tuple[float, ...]) -> float:
    """Return the distance from the estimate's place, across the press direction [m]."""
    return dist(estimate.surface_world_m[:2], tip_world_m[:2])
