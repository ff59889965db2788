"""What the joints of one arm say about each other.

A load at the tip, a tilt of the base and a dead band of the force sensor are one cause with one value in all
joints. Where one joint cannot tell such a cause from another (a spring, a bias), the others often can: they
show it with the same value, or they show that it is not there.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from estimation.diagnosis.answer import fitted
from estimation.fit.standing import Standing, stand
from estimation.fit.unexplained import is_explained
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.judgement.gate import usable
from estimation.fit.intervals import Value, final, values
from estimation.diagnosis.judgement.next_experiment import separating
from estimation.diagnosis.judgement.noise_floor import noise_floor
from estimation.diagnosis.judgement.objection import objection_to
from estimation.diagnosis.result import Accepted, ChannelDiagnosis, Floor, Verdict
from estimation.diagnosis.search.credible import is_credible
from estimation.diagnosis.search.extend import extend
from estimation.diagnosis.search.possible import is_possible
from estimation.effect import Effect

# Effects with one value in all joints, and what that is; the signals that they need carry each joint's share.
ARM_WIDE = {"payload": "mass", "gravity_tilt": "tilt", "force_deadband": "width"}
# Standard errors that two values are apart by more than chance. Intervals held in 84 of 91 joints, so errors
# may be a tenth too small: 4 of them are 3.6 true ones, 1 in 3000; three causes in six joints are compared in
# 45 ways.
CLEARLY = 4.0
SHARE = 0.05  # of a value, that joints may disagree by: the usual tolerance of a drive's torque constant


@dataclass(frozen=True)
class _Witness:
    """What one joint says of a cause: its value in the place of what it is confused with, beside all else."""

    judged: Judged
    value: Value
    can_tell: bool

    @property
    def told(self) -> str:
        return f"{self.judged.data.name} ({self.value.value:.3g} {self.value.unit})"

    @property
    def shows_it(self) -> bool:
        return abs(self.value.value) > CLEARLY * self.value.std_err

    def agrees(self, other: "_Witness") -> bool:
        errors = float(np.hypot(self.value.std_err, other.value.std_err))
        most = max(abs(self.value.value), abs(other.value.value))
        # what the data do not determine agrees
        return not abs(self.value.value - other.value.value) > CLEARLY * errors + SHARE * most


def settle(judged: Sequence[Judged], effects: Sequence[Effect]) -> list[ChannelDiagnosis]:
    """Prefer a common cause where other joints agree on it; rule it out where one shows another value.

    Only a joint's own group of alike effects is decided on, and only a joint that can tell the cause from
    others rules it out. Contacts, joints that are insufficient or unexplained, and joints of an arm that is
    not known are left as they are and not asked.

    Args:
        judged: the channels of one robot.
        effects: the library.

    Returns:
        The answers, in the order given.
    """
    found = [one.found for one in judged]
    for cause in [effect for effect in effects if effect.name in ARM_WIDE]:
        now = [Judged(one.data, one.model, entry) for one, entry in zip(judged, found, strict=True)]
        doubtful = [i for i, one in enumerate(now) if _is_doubtful(one.found, cause.name)]
        asked = [i for i, one in enumerate(now) if _can_say(one, cause)]
        if len(asked) < 2 or not set(doubtful) & set(asked):
            continue
        witnesses = {i: _ask(now[i], cause.name, effects) for i in asked}
        for i in set(doubtful) & set(asked):
            others = [witness for k, witness in witnesses.items() if k != i]
            found[i] = _weigh(witnesses[i], others, cause.name, effects)
    return found


def agreed(
    judged: Sequence[Judged], cause: str, effects: Sequence[Effect]
) -> tuple[Value, list[Judged]] | None:
    """A common cause that joints named without rivals, one of them for sure, and that no joint denies.

    Joints that do not determine its value are not asked.

    Args:
        judged: the channels of one robot.
        cause: its name.
        effects: the library.

    Returns:
        Its value in the joint that knows it best, and the joints that named it; None where that is not so.
    """
    named = [one for one in judged if any(_is_surely(entry, cause) for entry in one.found.accepted)]
    known = [effect for effect in effects if effect.name == cause]
    if not known or not _any_complete(named):
        return None
    asked = [_ask(one, cause, effects) for one in judged if one in named or _can_say(one, known[0])]
    witnesses = [witness for witness in asked if np.isfinite(witness.value.std_err)]
    sure = [witness for witness in witnesses if witness.judged in named]
    if not _any_complete([witness.judged for witness in sure]):
        return None
    best = min(sure, key=lambda witness: witness.value.std_err)
    if not all(witness.agrees(best) for witness in witnesses):
        return None
    return best.value, [witness.judged for witness in sure]


def _any_complete(joints: Sequence[Judged]) -> bool:
    return any(one.found.verdict is Verdict.MISSING for one in joints)


def _is_surely(entry: Accepted, cause: str) -> bool:
    return entry.effect == cause and not entry.confused_with


def others_may_tell(one: Judged, effects: Sequence[Effect]) -> bool:
    """Whether a joint's group is of a kind that the robot's other joints can decide on."""
    causes = [effect for effect in effects if effect.name in ARM_WIDE]
    return any(_is_doubtful(one.found, cause.name) and _can_say(one, cause) for cause in causes)


def _can_say(one: Judged, cause: Effect) -> bool:
    """Whether a joint is of a known arm, so that values compare, and settled but for its group."""
    known = not one.model.gains and "payload_effort_per_kg" in one.data.context
    return known and cause.applies_to(one.data) and one.found.verdict in {Verdict.ADEQUATE, Verdict.MISSING}


def _is_doubtful(found: ChannelDiagnosis, cause: str) -> bool:
    """Whether all that was found is one effect that is not told from others, this one among them."""
    one_alone = len(found.accepted) == 1 and found.verdict is Verdict.MISSING
    return one_alone and _holds(found.accepted[0], cause)


def _holds(entry: Accepted, cause: str) -> bool:
    """Whether an effect is not told from others, this one among them."""
    return bool(entry.confused_with) and cause in {entry.effect, *entry.confused_with}


def _ask(one: Judged, cause: str, effects: Sequence[Effect]) -> _Witness:
    sure = [entry.effect for entry in one.found.accepted if not _holds(entry, cause)]
    standing = _stand(one, [*(name for name in sure if name != cause), cause], effects)
    value = values(*final(standing, complete=True))[f"{cause}.{ARM_WIDE[cause]}"]
    return _Witness(one, value, can_tell=len(sure) == len(one.found.accepted))


def _stand(one: Judged, names: Sequence[str], effects: Sequence[Effect]) -> Standing:
    """The base model with these effects, fitted one after the other."""
    by_name, good = {effect.name: effect for effect in effects}, usable(one.data)
    standing = stand(one.data, one.model, {}, good)
    for name in names:
        standing = extend(one.data, standing, by_name[name].suited_to(one.data), good)
    return standing


def _weigh(
    witness: _Witness, others: Sequence[_Witness], cause: str, effects: Sequence[Effect]
) -> ChannelDiagnosis:
    """The joint's answer, with what the other joints say of a cause that it cannot tell from others."""
    (entry,) = witness.judged.found.accepted
    rest = [name for name in (entry.effect, *entry.confused_with) if name != cause]
    same = [other for other in others if other.shows_it and witness.agrees(other)]
    known = any(other.can_tell for other in same)  # then who cannot tell has nothing to add
    differ = [other for other in others if not witness.agrees(other) and (other.can_tell or not known)]
    against = [other.told for other in differ if other.can_tell]
    if same and not differ:
        told = ", ".join(other.told for other in same)
        said = f"{cause} rather than {' or '.join(rest)}: the same is in {told}"
        return _named(witness.judged, [cause], said, effects)
    if against and not same:
        return _named(witness.judged, rest, f"no {cause}: that of {', '.join(against)} differs", effects)
    return witness.judged.found  # nobody can tell, or they contradict each other


def _named(one: Judged, group: Sequence[str], said: str, effects: Sequence[Effect]) -> ChannelDiagnosis:
    """The answer with the first of a group in the place of what was named, and the others as its rivals.

    It stays as it was where the first does not complete the model, by the same rules as in the search. The
    p-value is still that of what was named, whose curve this is.
    """
    name, *rivals = group
    effect = next(e for e in effects if e.name == name)
    (entry,) = one.found.accepted
    start, before, standing = (_stand(one, names, effects) for names in ([], [entry.effect], [name]))
    energy = min(float(each.flexible.held_out.sum()) for each in (start, before, standing))
    if not _is_complete(start, standing, energy, effect.suited_to(one.data)):
        return one.found
    now, floor = fitted(standing, complete=True), noise_floor(standing, energy)
    own = {key.split(".", 1)[1]: v for key, v in now.parameters.items() if key.startswith(f"{name}.")}
    accepted = entry.model_copy(
        update={
            "effect": name,
            "parameters": own,
            "rmse_after": standing.rmse,
            "confused_with": rivals,
            "physics": effect.physics,
            "equation": effect.equation,
            "signature": effect.signature,
        }
    )
    changed = {
        "reason": f"with {name}, nothing smooth is left in the error; {said}",
        "noise_floor": floor.value,
        "floor": Floor(**asdict(floor)),
        "accepted": [accepted],
        "final": now,
        "next_experiment": separating(effect, rivals, one.data.kind) if rivals else None,
    }
    return one.found.model_copy(update=changed)


def _is_complete(start: Standing, standing: Standing, energy: float, added: Effect) -> bool:
    """Whether a model with one effect added leaves noise alone, and is what its names say."""
    sensible = is_possible(added, standing.trial, standing.plain) and is_credible(start, standing)
    return (
        sensible
        and is_explained(standing, energy)
        and objection_to(standing, energy, is_complete=True) is None
    )
