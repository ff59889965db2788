"""What the joints of one arm say about each other.

A load at the tip and a tilt of the base are one cause with one value in all joints. Where one joint cannot
tell such a cause from another (a spring, a bias), the others often can: they show it with the same value, or
they show that it is not there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelKind
from estimation.diagnosis.bench.standing import Standing, stand
from estimation.diagnosis.judged import Judged
from estimation.diagnosis.judgement.gate import usable
from estimation.diagnosis.judgement.intervals import Value, final, values
from estimation.diagnosis.judgement.next_experiment import separating
from estimation.diagnosis.result import ChannelDiagnosis, Fitted, ParameterValue, Verdict
from estimation.diagnosis.search.screening import screen
from estimation.effect import Effect

ARM_WIDE = {"payload": "mass", "gravity_tilt": "tilt"}  # effects with one value in all joints; what that is
CLEARLY = 4.0  # standard errors
SHARE = 0.05  # of a value, that models of several joints may disagree by


@dataclass(frozen=True)
class _Witness:
    """What one joint says of a cause: its value in the place of what it is confused with, beside all else."""

    judged: Judged
    value: Value

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

    Only a joint's own group of alike effects is decided on. Contacts, joints that are insufficient or
    unexplained, and joints of an arm that is not known are left as they are and not asked.

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


def _can_say(one: Judged, cause: Effect) -> bool:
    """Whether a joint is of a known arm, so that values compare, and settled but for its group."""
    known = not one.model.gains and "payload_effort_per_kg" in one.data.context and cause.applies_to(one.data)
    settled = one.found.verdict in {Verdict.ADEQUATE, Verdict.MISSING}
    return known and settled and one.data.kind is ChannelKind.REVOLUTE


def _is_doubtful(found: ChannelDiagnosis, cause: str) -> bool:
    """Whether all that was found is one effect that is not told from others, this one among them."""
    if len(found.accepted) != 1 or found.verdict is not Verdict.MISSING:
        return False
    (entry,) = found.accepted
    return bool(entry.confused_with) and cause in {entry.effect, *entry.confused_with}


def _ask(one: Judged, cause: str, effects: Sequence[Effect]) -> _Witness:
    kept = [] if _is_doubtful(one.found, cause) else [entry.effect for entry in one.found.accepted]
    standing = _stand(one, [*(name for name in kept if name != cause), cause], effects)
    return _Witness(one, values(*final(standing, complete=True))[f"{cause}.{ARM_WIDE[cause]}"])


def _stand(one: Judged, names: Sequence[str], effects: Sequence[Effect]) -> Standing:
    """The base model with these effects, fitted one after the other."""
    by_name, good = {effect.name: effect for effect in effects}, usable(one.data)
    standing = stand(one.data, one.model, {}, good)
    for name in names:
        effect = by_name[name].suited_to(one.data)
        tried = screen(standing, [effect])
        start = tried[0].search.best if tried else standing.trial
        model = start.model if tried else start.model.with_effect(effect)
        standing = stand(one.data, model, start.parameters, good)
    return standing


def _weigh(
    witness: _Witness, others: Sequence[_Witness], cause: str, effects: Sequence[Effect]
) -> ChannelDiagnosis:
    """The joint's answer, with what the other joints say of a cause that it cannot tell from others."""
    (entry,) = witness.judged.found.accepted
    rest = [name for name in (entry.effect, *entry.confused_with) if name != cause]
    against = [other.told for other in others if not witness.agrees(other)]
    if against:
        return _named(witness.judged, rest, f"no {cause}: that of {', '.join(against)} differs", effects)
    same = [other.told for other in others if other.shows_it]
    if not same:
        return witness.judged.found
    said = f"{cause} rather than {' or '.join(rest)}: the same is in {', '.join(same)}"
    return _named(witness.judged, [cause], said, effects)


def _named(one: Judged, group: Sequence[str], said: str, effects: Sequence[Effect]) -> ChannelDiagnosis:
    """The answer with the first of a group in the place of what was named, and the others as its rivals."""
    name, *rivals = group
    effect = next(e for e in effects if e.name == name)
    standing = _stand(one, [name], effects)
    found = {key: _entry(value) for key, value in values(*final(standing, complete=True)).items()}
    entry = one.found.accepted[0].model_copy(
        update={
            "effect": name,
            "parameters": {k.split(".", 1)[1]: v for k, v in found.items() if k.startswith(f"{name}.")},
            "rmse_after": standing.rmse,
            "confused_with": rivals,
            "physics": effect.physics,
            "equation": effect.equation,
            "signature": effect.signature,
        }
    )
    changed = {
        "reason": f"with {name}, nothing smooth is left in the error; {said}",
        "accepted": [entry],
        "final": Fitted(rmse=standing.rmse, parameters=found),
        "next_experiment": separating(effect, rivals, one.data.kind) if rivals else None,
    }
    return one.found.model_copy(update=changed)


def _entry(value: Value) -> ParameterValue:
    known = np.isfinite(value.std_err)
    return ParameterValue(value=value.value, std_err=value.std_err if known else None, unit=value.unit)
