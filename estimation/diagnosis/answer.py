"""What is answered of a channel: the verdict, the effects, the reason in words."""

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from estimation.channel import ChannelData
from estimation.fit.standing import Standing
from estimation.fit.unexplained import depends_on
from estimation.fit.intervals import Value, final, values
from estimation.diagnosis.judgement.left_over import left_over, small_rest
from estimation.diagnosis.judgement.next_experiment import exploring, separating, sufficient
from estimation.diagnosis.judgement.noise_floor import noise_floor
from estimation.diagnosis.judgement.objection import Objection
from estimation.diagnosis.judgement.unlike_noise import quiet_floor
from estimation.diagnosis.result import (
    SMALL_REST,
    Accepted,
    ChannelDiagnosis,
    Fitted,
    Floor,
    NextExperiment,
    ParameterValue,
    Ranked,
    Suspect,
    Verdict,
)
from estimation.diagnosis.search.chain import Chain
from estimation.diagnosis.search.in_place import in_place_of
from estimation.diagnosis.search.search import Search
from estimation.diagnosis.search.step import Step


def insufficient(data: ChannelData, reason: str) -> ChannelDiagnosis:
    """That the channel cannot say, for this reason."""
    return ChannelDiagnosis(
        channel=data.name,
        verdict=Verdict.INSUFFICIENT,
        reason=reason,
        effort_unit=data.kind.effort_unit,
        next_experiment=sufficient(reason, data.kind),
    )


def answer(search: Search, chain: Chain, objection: Objection | None) -> ChannelDiagnosis:
    """What a search comes to.

    Args:
        search: the channel, the base model and all that was tried.
        chain: what was accepted.
        objection: what speaks against it, if anything does.
    """
    named = chain.named
    standing = named[-1].standing if named else chain.start
    accepted, suspects = _accepted(search, chain, named), _suspects(search, chain)
    left = _signals(chain, objection)
    signals = left or ([] if chain.is_complete or named else depends_on(chain.start))
    verdict = _verdict(chain)
    floor = noise_floor(chain.end, chain.floor)
    known = objection.floor if objection else np.inf if chain.is_complete else quiet_floor(chain.end)
    floor = replace(floor, value=min(floor.value, known))
    reason = _reason(verdict, chain, floor.value, left, accepted, suspects)
    return ChannelDiagnosis(
        channel=search.data.name,
        verdict=verdict,
        reason=objection.reason if objection else reason,
        effort_unit=search.data.kind.effort_unit,
        noise_floor=floor.value,
        floor=Floor(**asdict(floor)),
        baseline=fitted(chain.start, complete=chain.is_complete and not named),
        accepted=accepted,
        suspects=suspects,
        ranking=_ranking(chain),
        final=fitted(standing, complete=chain.is_complete),
        depends_on=signals,
        next_experiment=_next(search, accepted, signals, chain.is_complete),
    )


def fitted(standing: Standing, *, complete: bool) -> Fitted:
    """A model's error and parameters; `complete` where nothing is missing in it, see `final`."""
    found = values(*final(standing, complete=complete))
    return Fitted(rmse=standing.rmse, parameters={name: _entry(value) for name, value in found.items()})


def _signals(chain: Chain, objection: Objection | None) -> list[str]:
    """What the error depends on that nothing named or suspected explains."""
    if chain.is_complete:
        return []
    if objection:
        return list(objection.depends_on)
    return depends_on(chain.start if chain.doubted else chain.end)


def _verdict(chain: Chain) -> Verdict:
    if not chain.is_complete:
        return Verdict.UNEXPLAINED
    return Verdict.MISSING if chain.steps else Verdict.ADEQUATE


def _entry(value: Value) -> ParameterValue:
    known = np.isfinite(value.std_err)
    return ParameterValue(value=value.value, std_err=value.std_err if known else None, unit=value.unit)


def _accepted(search: Search, chain: Chain, named: Sequence[Step]) -> list[Accepted]:
    if not named:
        return []
    found = values(*final(named[-1].standing, complete=chain.is_complete))
    by_name = {effect.name: effect for effect in search.effects}
    accepted, before, p_value = [], chain.start, 0.0
    for step in named:
        effect = by_name[step.effect]
        p_value = max(p_value, step.evidence.p_value)
        own = {
            name.split(".", 1)[1]: _entry(v) for name, v in found.items() if name.split(".")[0] == effect.name
        }
        accepted.append(
            Accepted(
                effect=effect.name,
                parameters=own,
                rmse_before=before.rmse,
                rmse_after=step.standing.rmse,
                p_value=p_value,
                confused_with=in_place_of(search, chain, named, step.effect),
                physics=effect.physics,
                equation=effect.equation,
                signature=effect.signature,
            )
        )
        before = step.standing
    return accepted


def _suspects(search: Search, chain: Chain) -> list[Suspect]:
    names = {step.effect for step in chain.named}
    return [
        Suspect(
            effect=step.effect,
            rmse_after=step.standing.rmse,
            confused_with=in_place_of(search, chain, chain.steps, step.effect),
        )
        for step in chain.steps
        if step.effect not in names
    ]


def _ranking(chain: Chain) -> list[Ranked]:
    """Errors sample by sample, from what each candidate takes away on blocks."""
    count = int(chain.start.plain.kept.sum())
    before = chain.start.rmse
    ranked = []
    for candidate in chain.ranking:
        taken = (chain.start.trial.held_out - candidate.held_out) / count
        error = float(np.sqrt(max(before**2 - taken, 0.0)))
        score = float(1.0 - error / before) if before > 0.0 else 0.0
        ranked.append(Ranked(effect=candidate.effect.name, rmse_held_out=error, score=score))
    return ranked


def _reason(  # noqa: PLR0917
    verdict: Verdict,
    chain: Chain,
    floor: float,
    signals: Sequence[str],
    accepted: Sequence[Accepted],
    suspects: Sequence[Suspect],
) -> str:
    if verdict is Verdict.ADEQUATE:
        return "no effect of the library lowers the error in held-out runs, and nothing smooth is left in it"
    if verdict is Verdict.MISSING:
        names = " and ".join(_or_rivals(entry) for entry in accepted)
        return f"with {names}, nothing smooth is left in the error"
    standing = chain.dominant.standing if chain.dominant else chain.end
    unit = standing.data.kind.effort_unit
    fall = f"from {chain.start.rmse:.3g} to {standing.rmse:.3g} {unit}"
    little = standing.rmse < SMALL_REST * floor
    if little:
        fall = f"{fall}, {standing.rmse / floor:.2f} times the noise floor"
    rest = (small_rest if little else left_over)(standing, chain.floor, signals)
    if chain.dominant:
        how = "explains nearly all" if little else "is missing above all"
        return f"{chain.dominant.effect} {how}: the error falls {fall}; {rest}"
    if chain.doubted:
        names = " and ".join(step.effect for step in chain.steps) or "the model"
        told = ", ".join(signals) or "a mix of signals"
        return (
            f"{names} could draw all of the error, which depends on {told}, but only by parameters with "
            "which it is another thing than its name says, or may be nothing, or in a roundabout way, or not "
            "as well as a law without a name"
        )
    if chain.steps:
        names = " and ".join(_or_rivals(entry) for entry in suspects)
        return f"the error would fall {fall} with {names}; {rest}"
    return f"the error is {standing.rmse:.3g} {unit}; {rest}"


def _or_rivals(entry: Accepted | Suspect) -> str:
    """An effect and those that the data cannot tell it from."""
    rivals = " or ".join(entry.confused_with)
    return f"{entry.effect} (or {rivals} instead)" if rivals else entry.effect


def _next(
    search: Search, accepted: Sequence[Accepted], signals: Sequence[str], explained: bool
) -> NextExperiment | None:
    by_name = {effect.name: effect for effect in search.effects}
    for entry in accepted:
        if entry.confused_with:
            return separating(by_name[entry.effect], entry.confused_with, search.data.kind)
    return None if explained else exploring(signals, search.data.kind)
