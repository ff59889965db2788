"""What a search comes to: the verdict, the effects with their evidence, and what is left."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimation.budget.budget import error_budget
from estimation.channel import ChannelData
from estimation.design.next_experiment import NextExperiment, exploring, separating, sufficient
from estimation.diagnosis.acceptance import indistinguishable_models, models_by_importance, similar_forms
from estimation.diagnosis.bootstrap import SMALL, encoder_step_error
from estimation.diagnosis.forms import Form, FormTest, NamedError, PartiallyLinear, closest_forms
from estimation.diagnosis.random_effects import run_standard_deviation
from estimation.diagnosis.residual_checks import ResidualFinding, periodic_component
from estimation.diagnosis.result import (
    Accepted,
    BudgetShare,
    ChannelDiagnosis,
    Fitted,
    Floor,
    ParameterValue,
    Ranked,
    Remaining,
    Rest,
    Verdict,
)
from estimation.diagnosis.search import Search
from estimation.effects.run_variation import RunVariation
from estimation.fit.fit_result import FitResult, final_solution
from estimation.fit.intervals import estimate_parameters
from estimation.fit.measurement_model import MeasurementModel
from estimation.fit.measurement_noise import MeasurementNoise, free_air_noise, measurement_noise
from estimation.kinds import Kind, separating_experiment

_PEAKED = 0.8  # of the square of an error, in its largest twentieth; of normal noise that is 0.28
_Rivals = Mapping[str, Mapping[str, FitResult]]  # models with another effect in the place of one, by both


@dataclass(frozen=True)
class Evidence:
    """Where a search ended."""

    search: Search  # the channel, the base model and all that was tried
    measurement: MeasurementModel  # how the motion was read
    end: FitResult  # the base model with the effects that are established
    complete: bool  # whether it leaves no more than noise
    objection: ResidualFinding | None  # what no signal of the data shows, and speaks against completeness
    tests: Sequence[FormTest] = ()  # of the effects' forms, where the model is not complete
    partial: PartiallyLinear | None = None  # the kinds that account for the error, where it is not complete
    coarse: PartiallyLinear | None = None  # the same on a coarse copy

    @cached_property
    def noise(self) -> MeasurementNoise:
        """The noise of the channel, which no model changes."""
        return measurement_noise(self.search.start)

    def form(self, effect: str) -> Form:
        """How well the form of an accepted effect is known."""
        is_closed = next((test.is_closed for test in self.tests if test.effect == effect), True)
        return Form.EXACT if self.complete and is_closed else Form.APPROXIMATE

    @property
    def signals(self) -> list[str]:
        """What the error that is left depends on."""
        if self.complete:
            return []
        return [self.objection.depends_on] if self.objection else self.end.depends_on


def insufficient_diagnosis(data: ChannelData, reason: str) -> ChannelDiagnosis:
    """That the channel cannot say, for this reason."""
    return ChannelDiagnosis(
        channel=data.name,
        verdict=Verdict.INSUFFICIENT,
        reason=reason,
        effort_unit=data.kind.effort_unit,
        next_experiment=sufficient(reason, data.kind),
    )


def decide_verdict(found: Evidence) -> ChannelDiagnosis:
    """The entry for one channel."""
    search, end = found.search, found.end
    path = models_by_importance(search, end)
    names = search.added_effects(end)
    if found.complete:
        others = {name: indistinguishable_models(search, end, name, found.measurement) for name in names}
    else:
        others = {name: similar_forms(search, end, name) for name in names}
    accepted = _accepted(found, path, others)
    verdict = Verdict.MISSING if accepted else Verdict.ADEQUATE if found.complete else Verdict.UNEXPLAINED
    noise = found.noise
    budget, rest = _budget(found)
    times = end.rmse / noise.value if noise.value > 0.0 else 1.0
    return ChannelDiagnosis(
        channel=search.data.name,
        verdict=verdict,
        reason=_reason(found, verdict, accepted),
        effort_unit=search.data.kind.effort_unit,
        noise_floor=noise.value,
        floor=Floor(
            value=noise.value,
            source=noise.source,
            at_most=noise.is_bound,
            free_air=free_air_noise(search.data),
            share_left=end.explainable_share(),
        ),
        budget=budget,
        rest=rest,
        baseline=Fitted(rmse=search.start.rmse, parameters=_parameters(search.start)),
        accepted=accepted,
        ranking=_ranking(search),
        final=Fitted(rmse=end.rmse, parameters=_parameters(end)),
        complete=found.complete,
        remaining=Remaining(rmse=end.rmse, times_floor=times, depends_on=found.signals),
        depends_on=found.signals,
        next_experiment=_next(found, accepted, others),
    )


def _budget(found: Evidence) -> tuple[list[BudgetShare], Rest]:
    """Shares of the base model's squared error on blocks, which add up to one.

    Returns:
        Shares of the accepted effects' kinds if nothing else is left, else of all kinds that count; and
        what they leave. Beside a complete model that is noise.
    """
    search, end = found.search, found.end
    named: dict[Kind, list[str]] = {}
    for effect in end.solution.model.effects:
        if effect.name in search.added_effects(end):
            named.setdefault(effect.kind, []).append(effect.name)
    if found.partial is None:
        if not named:
            return [], Rest(noise=float(search.start.rmse > 0.0), unexplained=0.0)
        budget = error_budget(NamedError(search, end), np.random.default_rng(0), frozenset(named))
    else:
        kinds = found.partial.kinds | frozenset(named)
        budget = error_budget(found.partial.error, np.random.default_rng(0), kinds)
    shares = []
    for entry in budget.entries:
        effects = named.get(entry.kind, [])
        form = max(map(found.form, effects), key=list(Form).index, default=Form.UNKNOWN)
        if not effects and found.coarse is not None:
            effects = closest_forms(found.coarse, entry.kind, frozenset(budget.kinds))
        replaceable = list(entry.replaceable_by)
        shares.append(
            BudgetShare(
                kind=entry.kind,
                share=entry.share,
                interval=entry.interval,
                necessary=entry.necessary,
                sufficient=entry.sufficient,
                form=form,
                effects=effects,
                replaceable_by=replaceable,
                experiment=separating_experiment(entry.kind, replaceable[0]) if replaceable else "",
            )
        )
    noise = budget.left
    if found.partial is not None:
        noise = min((found.noise.value / max(search.start.rmse, 1e-300)) ** 2, budget.left)
    return shares, Rest(noise=noise, unexplained=budget.left - noise)


def _parameters(fit: FitResult) -> dict[str, ParameterValue]:
    return {name: ParameterValue.of(one) for name, one in estimate_parameters(*final_solution(fit)).items()}


def _accepted(found: Evidence, path: Sequence[FitResult], others: _Rivals) -> list[Accepted]:
    search, before, accepted = found.search, found.search.start, []
    everything = _parameters(found.end) if path else {}
    by_name = {effect.name: effect for effect in search.effects}
    for after in path:
        (name,) = set(search.added_effects(after)) - set(search.added_effects(before))
        own = {key.split(".", 1)[1]: one for key, one in everything.items() if key.split(".")[0] == name}
        effect = by_name[name]
        if isinstance(effect, RunVariation):
            own["spread"] = run_standard_deviation(found.end, effect)
        accepted.append(
            Accepted(
                effect=name,
                form=found.form(name),
                parameters=own,
                rmse_before=before.rmse,
                rmse_after=after.rmse,
                p_value=search.p_value(search.without(found.end, name), found.end),
                confused_with=list(others[name]),
                physics=effect.physics,
                equation=effect.equation,
                signature=effect.signature,
            )
        )
        before = after
    return accepted


def _ranking(search: Search) -> list[Ranked]:
    """Errors sample by sample, from what each candidate takes away on blocks, or on a coarse copy's."""
    tried, rmse, ranked = search.coarse or search, search.start.rmse, []
    start = tried.start
    for candidate in (one for one in tried.screen(start) if one.possible):
        share = (start.solution.held_out - candidate.held_out) / max(start.solution.held_out, 1e-300)
        error = float(np.sqrt(max(rmse**2 - share * search.start.held_out_mean_square, 0.0)))
        score = float(1.0 - error / rmse) if rmse > 0.0 else 0.0
        ranked.append(Ranked(effect=candidate.effect.name, rmse_held_out=error, score=score))
    return ranked


def _reason(found: Evidence, verdict: Verdict, accepted: Sequence[Accepted]) -> str:
    end, unit = found.end, found.search.data.kind.effort_unit
    if verdict is Verdict.ADEQUATE:
        return (
            "no effect of the library lowers the error in held-out runs by more than chance, and a smooth "
            f"law explains no more of it than of draws from the model{_steps(found)}{_hum(end)}{_peaks(end)}"
        )
    left = _left(found)
    if verdict is Verdict.MISSING:
        names = " and ".join(_or_rivals(entry) for entry in accepted)
        before = f"{found.search.start.rmse:.3g} {unit}"
        fall = f"the error falls from {before} to {end.rmse:.3g} {unit} with {names}"
        nothing = f"no more than noise is left{_steps(found)}{_hum(end)}{_peaks(end)}"
        return f"{fall}, and {nothing}" if found.complete else f"{fall}; {left}"
    return f"the error is {end.rmse:.3g} {unit}; {left}"


def _steps(found: Evidence) -> str:
    """What a smooth law takes away beside a complete model where the position's steps may make it."""
    end, unit, off = (
        found.end,
        found.search.data.kind.effort_unit,
        encoder_step_error(found.end, found.measurement),
    )
    left = np.sqrt(max(end.flexible.explained, 0.0) / max(end.problem.used.sum(), 1))
    if end.explainable_share() <= SMALL or left > off:
        return ""
    return f" or of encoders half a step off: {left:.3g} {unit}, where these make up to {off:.3g} {unit}"


def _hum(end: FitResult) -> str:
    """What of the noise swings, in words: mains, a fan or a drive that the sensor picks up."""
    found = periodic_component(end) if free_air_noise(end.data) else None
    if found is None:
        return ""
    size = f"{np.sqrt(found[1]) * end.rmse:.3g} {end.data.kind.effort_unit}"
    return f"; {size} of the noise swings at {found[0]:.3g} Hz, in free air too"


def _peaks(end: FitResult) -> str:
    """That what passes for noise is hardly anywhere but in a few moments, such as those of breaking away."""
    squares = np.sort(end.solution.residual[end.problem.used] ** 2)
    share = float(squares[int(0.95 * len(squares)) :].sum() / max(squares.sum(), 1e-300))
    return f"; {100 * share:.0f} % of its square is in a twentieth of the samples" if share > _PEAKED else ""


def _left(found: Evidence) -> str:
    if found.objection:
        return found.objection.reason
    told, noise = ", ".join(found.signals) or "a mix of signals", found.noise
    if found.end.rmse <= noise.value or not noise.value > 0.0:
        return f"what is left depends on {told}"
    return f"what is left is {found.end.rmse / noise.value:.2g} times the noise, and depends on {told}"


def _or_rivals(entry: Accepted) -> str:
    others = " or ".join(entry.confused_with)
    return f"{entry.effect} (indistinguishable from {others})" if others else entry.effect


def _next(found: Evidence, accepted: Sequence[Accepted], others: _Rivals) -> NextExperiment | None:
    search = found.search
    for entry in accepted:
        if entry.confused_with:
            effect = next(one for one in search.effects if one.name == entry.effect)
            return separating(effect, {entry.effect: found.end, **others[entry.effect]}, search.data)
    return None if found.complete else exploring(found.signals, search.data)
