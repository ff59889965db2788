"""A dead band of the force sensor that the joints show, taken into the contact's own answer.

To a contact alone, what its sensor swallows is a surface that lies deeper, or nothing that it could name: no
reading is left of it. The joints carry it all the same. Where they show it for sure, the contact is judged
again under that sensor.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.common_cause import agreed
from estimation.diagnosis.judged import Judged
from estimation.fit.intervals import Value
from estimation.diagnosis.result import Accepted, ChannelDiagnosis, Fitted, ParameterValue, Verdict
from estimation.effect import Effect
from estimation.effects.deadband import SWALLOWED, Deadband
from estimation.effects.force_deadband import ForceDeadband
from estimation.model import Model

_NO_WORSE = 1.02  # times the error without it
RunOne = Callable[[int, ChannelData, Model], ChannelDiagnosis]


def swallowing(contact: ChannelData, width_n: float, std_err_n: float) -> ChannelData:
    """The contact whose sensor is known to swallow this force [N]; see `Deadband.suited_to`."""
    told = np.tile([width_n, std_err_n], (len(contact), 1))
    return replace(contact, context={**contact.context, SWALLOWED: told})


def with_dead_band(judged: Sequence[Judged], effects: Sequence[Effect], run: RunOne) -> list[Judged]:
    """The channels of one robot, with contacts judged under the dead band that their joints agree on.

    Left as they were: contacts that are insufficient, that surely name a fault of their sensor themselves, or
    that fit worse with a dead band of that width.

    Args:
        judged: as they were judged so far.
        effects: the library.
        run: judges one channel: its number, as it is to be judged, its base model.
    """
    contacts = [i for i, one in enumerate(judged) if one.data.kind is ChannelKind.CONTACT and _is_open(one)]
    shown = agreed(judged, ForceDeadband.name, effects) if contacts else None
    if shown is None or not any(effect.name == Deadband.name for effect in effects):
        return list(judged)
    width, joints = shown
    told = list(judged)
    for i in contacts:
        marked = swallowing(judged[i].data, width.value, width.std_err)
        base = judged[i].model.with_effect(Deadband().suited_to(marked))
        found = _merged(judged[i].found, run(i, marked, base), width, joints)
        if found is not None:
            told[i] = replace(judged[i], data=marked, found=found)
    return told


def _is_open(contact: Judged) -> bool:
    """Whether a contact can be judged, and has not named the dead band for sure already."""
    surely = contact.found.verdict is Verdict.MISSING
    named = any(entry.effect == Deadband.name for entry in contact.found.accepted)
    return contact.found.baseline is not None and not (surely and named)


def _merged(
    before: ChannelDiagnosis, again: ChannelDiagnosis, width: Value, joints: Sequence[Judged]
) -> ChannelDiagnosis | None:
    """The answer under the known sensor, told from the base model on; None where it speaks against it."""
    if before.baseline is None or again.baseline is None or again.final is None:
        return None
    explained = again.verdict is not Verdict.UNEXPLAINED
    if again.baseline.rmse > _NO_WORSE * before.baseline.rmse:
        return None
    if not explained and before.verdict is not Verdict.UNEXPLAINED:
        return None
    names = [joint.data.name for joint in joints]
    entries = [entry for joint in joints for entry in joint.found.accepted]
    known = ParameterValue(value=width.value, std_err=width.std_err, unit=width.unit)
    step = Accepted(
        effect=Deadband.name,
        parameters={"width": known},
        rmse_before=before.baseline.rmse,
        rmse_after=again.baseline.rmse,
        p_value=max(entry.p_value for entry in entries if entry.effect == ForceDeadband.name),
        confused_with=[],
        physics=Deadband.physics,
        equation=Deadband.equation,
        signature=Deadband.signature,
        told_by=names,
    )
    accepted = [step, *again.accepted]
    every = " and ".join(entry.effect for entry in accepted)
    reason = f"with {every}, nothing smooth is left in the error" if explained else again.reason
    parameters = again.final.parameters | {f"{Deadband.name}.width": known}
    changed = {
        "verdict": Verdict.MISSING if explained else again.verdict,
        "reason": f"{reason}; the dead band is that which {' and '.join(names)} carry",
        "baseline": before.baseline,
        "accepted": accepted,
        "ranking": before.ranking,
        "final": Fitted(rmse=again.final.rmse, parameters=parameters),
    }
    return again.model_copy(update=changed)
