"""Says what is missing in a model, with evidence; or that nothing is, or that nobody has named it."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.bench.standing import Standing
from estimation.diagnosis.bench.unexplained import depends_on
from estimation.diagnosis.common_cause import settle
from estimation.diagnosis.judgement.below_a_step import below_a_step
from estimation.diagnosis.judgement.gate import refuse, usable
from estimation.diagnosis.judgement.intervals import Value, final, values
from estimation.diagnosis.judgement.left_over import left_over
from estimation.diagnosis.judgement.next_experiment import exploring, separating, sufficient
from estimation.diagnosis.judgement.noise_floor import noise_floor
from estimation.diagnosis.judgement.objection import Objection, objection_to
from estimation.diagnosis.judgement.unlike_noise import quiet_floor
from estimation.diagnosis.result import (
    Accepted,
    ChannelDiagnosis,
    Diagnosis,
    Fitted,
    Floor,
    NextExperiment,
    ParameterValue,
    Ranked,
    Suspect,
    Verdict,
)
from estimation.diagnosis.search.chain import Chain, build
from estimation.diagnosis.search.confusion import SAME, likeness, rivals
from estimation.diagnosis.search.library import library
from estimation.diagnosis.search.possible import LEAST_GAIN
from estimation.diagnosis.search.search import Progress, Search
from estimation.diagnosis.search.step import Step
from estimation.diagnosis.true_force import Judged, with_true_force
from estimation.effect import Effect
from estimation.model import Model
from estimation.signals.runwise import sample_time


def diagnose(
    data: ChannelData | Sequence[ChannelData],
    model: Model | Sequence[Model],
    effects: Iterable[Effect] | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress | None = None,
    file: str = "",
) -> Diagnosis:
    """Diagnose each channel; those of one robot then tell on each other, see `with_true_force` and `settle`.

    Args:
        data: one channel or several.
        model: the base model of all, or one for each channel.
        effects: the library of hypotheses; by default all that palpate knows.
        rng: for surrogates.
        progress: told what is being done and which share of that is done.
        file: what the data came from, for the record.

    Returns:
        One entry for each channel, in the order given.
    """
    channels = [data] if isinstance(data, ChannelData) else list(data)
    models = [model] * len(channels) if isinstance(model, Model) else list(model)
    known = library() if effects is None else tuple(effects)
    told = progress or (lambda what, share: None)
    judged: dict[int, Judged] = {}
    for number in sorted(range(len(channels)), key=lambda i: channels[i].kind is not ChannelKind.CONTACT):
        channel, base = with_true_force(channels[number], list(judged.values()), known), models[number]
        judged[number] = Judged(channel, base, diagnose_channel(channel, base, known, rng, told))
    found = settle([judged[number] for number in range(len(channels))], known)
    return Diagnosis(file=file, model=models[0].name if models else "", channels=found)


def diagnose_channel(
    data: ChannelData, model: Model, effects: tuple[Effect, ...], rng: np.random.Generator, progress: Progress
) -> ChannelDiagnosis:
    """Diagnose one channel; see `diagnose`."""
    good = usable(data)
    reason = refuse(data.select(good), model)
    if reason:
        return _insufficient(data, reason)
    search = Search(data, model, good, effects, rng, progress)
    chain = build(search)
    objection = objection_to(chain.end, chain.floor, is_complete=chain.is_complete)
    if objection:
        chain = replace(chain, is_complete=False, dominant=None)
    reason = _too_coarse(search, chain)
    return _insufficient(data, reason) if reason else _report(search, chain, objection)


def _too_coarse(search: Search, chain: Chain) -> str | None:
    """Why what is left, and has no name, may be the reader's steps; what these do by themselves was tried."""
    tried = any(effect.name == "quantisation" for effect in search.effects)
    if chain.is_complete or chain.named or not tried:
        return None
    return below_a_step(chain.start)


def _insufficient(data: ChannelData, reason: str) -> ChannelDiagnosis:
    return ChannelDiagnosis(
        channel=data.name,
        verdict=Verdict.INSUFFICIENT,
        reason=reason,
        effort_unit=data.kind.effort_unit,
        next_experiment=sufficient(reason, data.kind),
    )


def _report(search: Search, chain: Chain, objection: Objection | None) -> ChannelDiagnosis:
    named = chain.named
    standing = named[-1].standing if named else chain.start
    accepted = _accepted(search, chain, named)
    signals = _signals(chain, objection)
    verdict = _verdict(chain)
    floor = noise_floor(chain.end, chain.floor)
    known = objection.floor if objection else np.inf if chain.is_complete else quiet_floor(chain.end)
    floor = replace(floor, value=min(floor.value, known))
    return ChannelDiagnosis(
        channel=search.data.name,
        verdict=verdict,
        reason=objection.reason if objection else _reason(verdict, chain, signals, accepted),
        effort_unit=search.data.kind.effort_unit,
        noise_floor=floor.value,
        floor=Floor(**asdict(floor)),
        baseline=_fitted(chain.start, complete=chain.is_complete and not named),
        accepted=accepted,
        suspects=_suspects(chain),
        ranking=_ranking(chain),
        final=_fitted(standing, complete=chain.is_complete),
        depends_on=signals,
        next_experiment=_next(search, accepted, signals, chain.is_complete),
    )


def _signals(chain: Chain, objection: Objection | None) -> list[str]:
    """What the error depends on that nothing named explains."""
    if chain.is_complete:
        return []
    if objection:
        return list(objection.depends_on)
    return depends_on(chain.start if chain.doubted else chain.end)


def _verdict(chain: Chain) -> Verdict:
    if not chain.is_complete:
        return Verdict.UNEXPLAINED
    return Verdict.MISSING if chain.steps else Verdict.ADEQUATE


def _fitted(standing: Standing, *, complete: bool) -> Fitted:
    found = values(*final(standing, complete=complete))
    return Fitted(rmse=standing.rmse, parameters={name: _entry(value) for name, value in found.items()})


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
                confused_with=_rivals(search, chain, named, step.effect),
                physics=effect.physics,
                equation=effect.equation,
                signature=effect.signature,
            )
        )
        before = step.standing
    return accepted


def _rivals(search: Search, chain: Chain, named: Sequence[Step], name: str) -> list[str]:
    """Effects that would do as well in the place of `name`, all others kept, or in the place of all."""
    others = [step.effect for step in named if step.effect != name]
    if others:
        without = search.without(named[-1].standing, name)
        found = search.screen(without)
        alone = _in_place_of_all(search, chain, named)
    else:
        without, found, alone = chain.start, list(chain.ranking), []
    if name not in [candidate.effect.name for candidate in found]:
        return alone
    step_s = sample_time(search.data.time_s, search.data.run)
    return list(dict.fromkeys([*rivals(found, name, without, step_s, search.together), *alone]))


def _suspects(chain: Chain) -> list[Suspect]:
    names = {step.effect for step in chain.named}
    return [
        Suspect(effect=s.effect, rmse_after=s.standing.rmse) for s in chain.steps if s.effect not in names
    ]


def _in_place_of_all(search: Search, chain: Chain, named: Sequence[Step]) -> list[str]:
    """Single effects that explain what several do together: one cause is as likely as two."""
    end, names = named[-1].standing, {step.effect for step in named}
    found = []
    for candidate in chain.ranking:
        like = likeness(chain.start.trial, end.trial, candidate.search.best) > SAME
        if candidate.effect.name in names or not like:
            continue
        if search.with_candidate(candidate).rmse <= (1.0 + LEAST_GAIN) * end.rmse:
            found.append(candidate.effect.name)
    return found


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


def _reason(verdict: Verdict, chain: Chain, signals: Sequence[str], accepted: Sequence[Accepted]) -> str:
    if verdict is Verdict.ADEQUATE:
        return "no effect of the library lowers the error in held-out runs, and nothing smooth is left in it"
    if verdict is Verdict.MISSING:
        names = " and ".join(_or_rivals(entry) for entry in accepted)
        return f"with {names}, nothing smooth is left in the error"
    standing = chain.dominant.standing if chain.dominant else chain.end
    unit = standing.data.kind.effort_unit
    fall = f"from {chain.start.rmse:.3g} to {standing.rmse:.3g} {unit}"
    rest = left_over(standing, chain.floor, signals)
    if chain.dominant:
        return f"{chain.dominant.effect} is missing above all: the error falls {fall}; {rest}"
    if chain.doubted:
        names = " and ".join(step.effect for step in chain.steps) or "the model"
        told = ", ".join(signals) or "a mix of signals"
        return (
            f"{names} could draw all of the error, which depends on {told}, but only "
            "by parameters with which it is another thing than its name says, or in a roundabout way"
        )
    if chain.steps:
        names = " and ".join(step.effect for step in chain.steps)
        return f"the error would fall {fall} with {names}; {rest}"
    return f"the error is {standing.rmse:.3g} {unit}; {rest}"


def _or_rivals(entry: Accepted) -> str:
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
