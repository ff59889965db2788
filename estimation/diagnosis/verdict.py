"""The verdict on a channel: accepted effects with their evidence, error budget, and remaining error."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from palpate.estimation.budget.budget import error_budget
from palpate.estimation.channel import ChannelData
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.design.next_experiment import (
    NO_VARIED_MOTION,
    can_vary,
    propose_exploring_experiment,
    propose_kind_separating_experiment,
    propose_known_experiment,
    propose_remedial_experiment,
    propose_repetition,
    propose_varied_motion,
)
from palpate.estimation.diagnosis.acceptance import (
    MIN_OF_UNEXPLAINED,
    FormCriteria,
    as_good_effects,
    indistinguishable_models,
    models_by_importance,
    similar_forms,
)
from palpate.estimation.diagnosis.bootstrap import encoder_step_error, is_mostly_smoothing, smoothing_error
from palpate.estimation.diagnosis.extension import fit_extended
from palpate.estimation.diagnosis.extrapolation import Extrapolation, extrapolation
from palpate.estimation.diagnosis.forms import (
    AS_GOOD,
    SLOW,
    Form,
    FormTest,
    NamedFormsError,
    PartiallyLinear,
    closest_forms,
    replacing_kinds,
)
from palpate.estimation.diagnosis.residual_checks import (
    ResidualFinding,
    differing_parameter,
    periodic_component,
)
from palpate.estimation.diagnosis.result import (
    AcceptedEffect,
    BudgetRest,
    BudgetShare,
    ChannelDiagnosis,
    FitSummary,
    NoiseFloor,
    ParameterValue,
    RankedEffect,
    RemainingError,
    Verdict,
    stage_numbers,
)
from palpate.estimation.diagnosis.search import Search
from palpate.estimation.effects.run_differences import RunGain, RunVariation
from palpate.estimation.estimate import rounded, with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import MeasurementModel
from palpate.estimation.fit.measurement_noise import MeasurementNoise, free_air_noise, measurement_noise
from palpate.estimation.kinds import Kind, separating_experiment
from palpate.estimation.model import own_parameters
from palpate.estimation.statistics.correlation import noise_between_samples

_MOST_RANKED = 3  # most candidates that are added alone to the base model
# If the share of a kind without an accepted effect exceeds this multiple of the error left by the accepted
# effects, the kind's law imitates these effects.
_IMITATION = 2.0
_NOISE_ERROR = 0.1  # relative uncertainty of a noise level


@dataclass(frozen=True)
class Evidence:
    """Result of a search, with the tests of the final model."""

    search: Search
    measurement: MeasurementModel  # how motion and effort were measured
    end: FitResult  # the base model with the accepted effects
    complete: bool  # whether this model leaves only noise
    residual_finding: ResidualFinding | None  # finding of the residual checks against completeness
    tests: Sequence[FormTest] = ()  # tests of the effects' forms
    partial: PartiallyLinear | None = None  # laws of the kinds that account for the error; None if complete
    coarse: PartiallyLinear | None = None  # the same on a coarse copy

    @cached_property
    def stages(self) -> list[FitResult]:
        """The base model, followed by one fit per effect by importance, each made by `extended`."""
        stages = [self.search.start]
        for fit in models_by_importance(self.search, self.end):
            present = {effect.name for effect in stages[-1].model.effects}
            (name,) = set(self.search.added_effects(fit)) - present
            stages.append(self.extended(stages[-1], name))
        return stages

    @cached_property
    def single_effects(self) -> dict[str, FitResult]:
        """Fits of the base model with one effect, for the most promising sound candidates, by name."""
        # Predict errors per sample from the improvement on blocks (of the coarse copy if there is one).
        start, coarse = self.search.start, self.search.coarse or self.search
        before, promising = coarse.start.solution.held_out, list[str]()
        for candidate in (option for option in coarse.screen(coarse.start) if option.possible):
            share = (before - candidate.held_out) / max(before, 1e-300)
            error = float(np.sqrt(max(start.rmse**2 - share * start.held_out_mean_square, 0.0)))
            if start.rmse > 0.0 and 1.0 - error / start.rmse >= SMALL:
                promising.append(candidate.effect.name)
        fits = {name: self.extended(start, name) for name in promising[:_MOST_RANKED]}
        return {name: fit for name, fit in fits.items() if self.search.is_sound(fit, name)}

    def extended(self, fit: FitResult, name: str) -> FitResult:
        """Fit a model with one more effect of the library.

        Args:
            fit: the model.
            name: the effect that is added.
        """
        known = self.search.extended
        if (fit, name) not in known:
            effect = next(effect for effect in self.search.effects if effect.name == name)
            known[fit, name] = fit_extended(self.search.data, fit, effect.suited_to(fit.training))
        return known[fit, name]

    @cached_property
    def noise(self) -> MeasurementNoise:
        """The noise level of the channel, independent of the model."""
        return measurement_noise(self.search.start)

    @cached_property
    def rivals(self) -> Mapping[str, Mapping[str, FitResult]]:
        """Fits of the effects that may replace each accepted effect, by both names."""
        search, end = self.search, self.end
        if self.complete:
            return {
                name: indistinguishable_models(search, end, name, self.measurement)
                for name in search.added_effects(end)
            }
        return {
            name: similar_forms(search, end, name) | as_good_effects(search, end, name)
            for name in search.added_effects(end)
        }

    @cached_property
    def replacing_kinds(self) -> Mapping[str, Mapping[Kind, float]]:
        """Kinds that may replace each effect of a complete model, with the mean square added [effort^2]."""
        search, end = self.search, self.end
        if not self.complete:
            return {name: {} for name in search.added_effects(end)}
        kind_of = {effect.name: effect.kind for effect in search.effects}
        kinds = replacing_kinds(search, end)
        for name, rivals in self.rivals.items():
            for rival, fit in rivals.items():
                added = max(fit.held_out_mean_square - end.held_out_mean_square, 0.0)
                kinds[name][kind_of[rival]] = min(added, kinds[name].get(kind_of[rival], np.inf))
        return kinds

    def form(self, effect: str) -> Form:
        """Rate the form of an accepted effect: not exact if an effect or a law may replace it.

        Args:
            effect: name of the effect.
        """
        is_closed = next((test.is_closed for test in self.tests if test.effect == effect), True)
        is_exact = self.leaves_only_noise and is_closed and self._is_resolved(effect)
        is_exact = is_exact and not self.rivals[effect] and not self.replacing_kinds[effect]
        return Form.EXACT if is_exact else Form.APPROXIMATE

    @cached_property
    def leaves_only_noise(self) -> bool:
        """Whether the model is complete and its error is noise, as measured or from neighboring residuals."""
        return self.complete and (self.end.is_exact or self.stages[-1].rmse <= SLOW * self._noise_level)

    @cached_property
    def _noise_level(self) -> float:
        """Noise level, or the noise of neighboring residuals if it is only bounded [effort]."""
        if not self.noise.is_bound:
            return self.noise.value
        last = self.stages[-1]  # a bound may contain more than noise
        residual = np.where(last.scored, last.residual, 0.0)
        return noise_between_samples(residual, last.data.run, last.scored)

    def _is_resolved(self, effect: str) -> bool:
        """Return whether the noise hides only deviations below `SMALL` of the effect's own contribution."""
        # A test that could not have found a deviation is no evidence for the law.
        if self.end.is_exact:
            return True
        without = self.search.without(self.end, effect)
        contribution = without.held_out_mean_square - self.end.held_out_mean_square
        hidden = (
            max(self.stages[-1].rmse, self._noise_level) ** 2
            - ((1.0 - _NOISE_ERROR) * self._noise_level) ** 2
        )
        return hidden <= SMALL**2 * contribution

    @cached_property
    def extrapolation(self) -> Extrapolation | None:
        """Error of an incomplete model beyond the motion of other runs; None if it is the smaller part."""
        return None if self.complete else extrapolation(self.stages[-1])

    @cached_property
    def confused_with_runs(self) -> Extrapolation | None:
        """Error of the base model beyond the motion of other runs, if differences between runs are named.

        If only one run contains a motion, the data cannot tell this difference from a law of this motion.
        """
        added = set(self.search.added_effects(self.end))
        differs = any(e.kind is Kind.RUN_DIFFERENCES for e in self.end.model.effects if e.name in added)
        return extrapolation(self.stages[0]) if differs else None

    @property
    def signals(self) -> list[str]:
        """Signals on which the remaining error depends."""
        if self.complete:
            return []
        return [self.residual_finding.depends_on] if self.residual_finding else self.end.depends_on


def unreached_effect(evidence: Evidence) -> str | None:
    """Return an effect to drop because the reported steps do not reproduce the joint fit; None if they do.

    The last effect, added to the others, then does not lower the held-out error, or the parameters of an
    effect become impossible or contradict its name.

    Args:
        evidence: result of the search, with the tests of the final model.
    """
    search, shown = evidence.search, evidence.stages[-1]
    if len(evidence.stages) > 1 and shown.rmse >= evidence.stages[-2].rmse:
        before, after = ({effect.name for effect in fit.model.effects} for fit in evidence.stages[-2:])
        return (after - before).pop()
    return next((name for name in search.added_effects(shown) if not search.is_sound(shown, name)), None)


def insufficient_diagnosis(data: ChannelData, reason: str) -> ChannelDiagnosis:
    """Return the diagnosis of a channel whose data are insufficient.

    Args:
        data: the channel.
        reason: reason in one sentence.
    """
    return ChannelDiagnosis(
        channel=data.name,
        verdict=Verdict.INSUFFICIENT,
        reason=reason,
        effort_unit=data.effort_unit,
        next_experiment=propose_remedial_experiment(reason, data.kind),
    )


def decide_verdict(evidence: Evidence) -> ChannelDiagnosis:
    """Determine the verdict on one channel, with the fits that all commands share attached (`take_fits`).

    Args:
        evidence: result of the search.
    """
    search, end, noise = evidence.search, evidence.end, evidence.noise
    accepted = _accepted(evidence)
    verdict = Verdict.MISSING if accepted else Verdict.ADEQUATE if evidence.complete else Verdict.UNEXPLAINED
    budget, rest = _budget(evidence)
    base, last = evidence.stages[0], evidence.stages[-1]
    shows_effect = bool(budget or evidence.signals)
    if evidence.residual_finding is None and last.rmse <= (1.0 + SMALL) * noise.value:
        # A flexible regression explains nothing. The laws of kinds always fit a small part of the noise, so
        # only a large share counts.
        explained, left = sum(entry.share for entry in budget), rest.noise + rest.unexplained
        shows_effect = explained >= MIN_OF_UNEXPLAINED * left
    within_bound = noise.is_bound and last.rmse <= SLOW * noise.value
    if verdict is Verdict.UNEXPLAINED and within_bound and not shows_effect:
        unit = search.data.effort_unit
        reason = (
            f"{_explained_variance(evidence)}, and its whole error of {with_unit(last.rmse, unit)} may be "
            f"noise, because only an upper bound of the noise is known ({with_unit(noise.value, unit)}); "
            "record several runs with larger efforts"
        )
        return insufficient_diagnosis(search.data, reason)
    noise, start = noise.below(last.rmse), search.start.rmse
    ranking = sorted(  # the most promising candidates, each added alone to the base model
        (
            RankedEffect(
                effect=name, rmse_held_out=fit.rmse, score=1.0 - fit.rmse / start if start > 0.0 else 0.0
            )
            for name, fit in evidence.single_effects.items()
        ),
        key=lambda entry: entry.rmse_held_out,
    )
    times = last.rmse / noise.value if noise.value > 0.0 else 1.0
    following = None if evidence.complete else propose_exploring_experiment(evidence.signals, search.data)
    if beyond := evidence.confused_with_runs:
        purpose = (
            "tell differences between runs from a law of the motion: "
            f"{beyond.describe('squared error of the base model')}"
        )
        following = propose_repetition(beyond.run, purpose)
    elif beyond := evidence.extrapolation:
        following = propose_repetition(beyond.run, "predict each run from another one with the same motion")
    confused, no_experiment = [entry for entry in accepted if entry.confused_with], ""
    if confused:
        varied = (
            propose_varied_motion({entry.effect: evidence.end, **evidence.rivals[entry.effect]}, search.data)
            for entry in confused
        )
        following = next(filter(None, varied), None)
        if following is None:
            effect = next(known for known in search.effects if known.name == confused[0].effect)
            names = [effect.name, *confused[0].confused_with]
            following = propose_known_experiment(effect, names, search.data)
            no_experiment = NO_VARIED_MOTION if can_vary(search.data) else ""
    elif replaced := [(name, kinds) for name, kinds in evidence.replacing_kinds.items() if kinds]:
        name, others = replaced[0]
        closest = min(others, key=others.__getitem__)
        following = propose_kind_separating_experiment(end.solution.model.effect(name), closest, search.data)
    diagnosis = ChannelDiagnosis(
        channel=search.data.name,
        verdict=verdict,
        reason=_reason(evidence, verdict, accepted, ranking),
        effort_unit=search.data.effort_unit,
        noise_floor=noise.value,
        floor=NoiseFloor(
            value=noise.value,
            source=noise.source,
            at_most=noise.is_bound,
            motion=noise.includes_motion,
            free_air=free_air_noise(search.data),
            share_left=end.explainable_share(),
        ),
        budget=budget,
        rest=rest,
        baseline=FitSummary.of(base),
        accepted=accepted,
        ranking=ranking,
        final=FitSummary.of(last),
        complete=evidence.complete,
        remaining=RemainingError(rmse=last.rmse, times_floor=times, depends_on=evidence.signals),
        depends_on=evidence.signals,
        differs_between_runs=_differing_parameter(evidence),
        next_experiment=following,
        no_experiment=no_experiment,
    )
    added = [entry.effect for entry in accepted]
    chains = {tuple(added[:count]): fit for count, fit in enumerate(evidence.stages)}
    alone = {(name,): fit for name, fit in evidence.single_effects.items()}
    return diagnosis.with_fits({chain: fit for chain, fit in (alone | chains).items() if chain}, noise)


def _differing_parameter(evidence: Evidence) -> str:
    """Describe the only parameter that differs between runs, if runs differ; empty otherwise."""
    search, end = evidence.search, evidence.end
    effects = end.solution.model.effects
    varying = [effect.name for effect in effects if isinstance(effect, RunVariation)]
    if not varying and evidence.signals != ["run"]:
        return ""
    for name in varying:
        end = search.without(end, name)
    return differing_parameter(end) or ""


def _budget(evidence: Evidence) -> tuple[list[BudgetShare], BudgetRest]:
    """Divide the base model's squared error on blocks into shares of kinds and a rest, together one."""
    # The kinds are those of the accepted effects if these leave no more error than the laws of all relevant
    # kinds, or if a kind without an accepted effect only imitates them; otherwise all relevant kinds.
    search, end, partial = evidence.search, evidence.end, evidence.partial
    effects = [end.solution.model.effect(name) for name in search.added_effects(end)]
    kinds = {effect.name: partial.kind_of(effect) if partial else effect.kind for effect in effects}
    if partial is None and not kinds:
        return [], BudgetRest(noise=float(search.start.rmse > 0.0), unexplained=0.0)
    rng = np.random.default_rng(0)
    budget = error_budget(NamedFormsError(end, kinds), rng, frozenset(kinds.values()))
    replaceable: dict[Kind, tuple[Kind, ...]] = {}
    lost = dict[Kind, float]()  # share that is lost if another kind replaces the effects of a kind
    if partial is None:
        for kind in set(kinds.values()):
            each = [evidence.replacing_kinds[name] for name in kinds if kinds[name] is kind]
            others = set[Kind].intersection(*map(set, each)) - set(kinds.values())
            added = {other: sum(errors[other] for errors in each) for other in others}
            replaceable[kind] = tuple(sorted(others, key=lambda other: (added[other], other)))
            lost[kind] = min(added.values(), default=np.inf) / search.start.held_out_mean_square
    else:
        by_laws = partial.budget_with(frozenset(kinds.values()))
        without_name = (entry.share for entry in by_laws.entries if entry.kind not in kinds.values())
        imitates = max(without_name, default=0.0) > _IMITATION * budget.unexplained
        # Effects that fit clearly better than the laws, or that a law imitates, are not replaceable.
        if budget.unexplained > AS_GOOD * by_laws.unexplained and not imitates:
            replaceable = {entry.kind: entry.replaceable_by for entry in by_laws.entries}
        budget = budget if budget.unexplained <= by_laws.unexplained or imitates else by_laws
    shares = []
    for entry in budget.entries:
        names = [name for name, kind in kinds.items() if kind is entry.kind]
        form = max(map(evidence.form, names), key=list(Form).index, default=Form.UNKNOWN)
        if not names and evidence.coarse is not None:
            names = closest_forms(evidence.coarse, entry.kind, frozenset(budget.kinds))
        instead = list(replaceable.get(entry.kind, ()))
        shares.append(
            BudgetShare(
                kind=entry.kind,
                share=entry.share,
                interval=entry.interval,
                necessary=min(entry.necessary, lost.get(entry.kind, np.inf)),
                sufficient=entry.sufficient,
                form=form,
                effects=names,
                replaceable_by=instead,
                experiment=separating_experiment(entry.kind, instead[0]) if instead else "",
            )
        )
    noise = budget.unexplained
    if partial is not None or not evidence.leaves_only_noise:
        noise = min((evidence.noise.value / max(search.start.rmse, 1e-300)) ** 2, budget.unexplained)
    return shares, BudgetRest(noise=noise, unexplained=budget.unexplained - noise)


def _accepted(evidence: Evidence) -> list[AcceptedEffect]:
    search, accepted, data = evidence.search, [], evidence.end.data
    model, known = evidence.end.solution.model, evidence.end.solution.parameters
    by_name = {effect.name: effect for effect in search.effects}
    for before, after in pairwise(evidence.stages):
        (name,) = {part.name for part in after.model.effects} - {part.name for part in before.model.effects}
        effect = by_name[name]
        spread = None
        if isinstance(effect, RunVariation):  # standard deviation between runs, with its standard error
            predicted, inner = model.without(name).predict(data, known), own_parameters(effect, known)
            value = float(effect.spread(predicted, data, inner)[0])
            error = value / float(np.sqrt(2.0 * (len(data.runs) - 1)))
            unit = "1" if isinstance(effect, RunGain) else data.effort_unit
            spread = ParameterValue(value=value, std_err=error, unit=unit, at_bound=False)
        p_value = search.p_value(search.without(evidence.end, effect.name), evidence.end)
        accepted.append(
            AcceptedEffect(
                effect=effect.name,
                form=evidence.form(effect.name),
                **stage_numbers(effect.name, before, after, evidence.stages[-1], spread),
                p_value=p_value,
                confused_with=list(evidence.rivals[effect.name]),
            )
        )
    return accepted


def error_decrease(accepted: Sequence[AcceptedEffect], base_rmse: float, last_rmse: float, unit: str) -> str:
    """Describe by how much the accepted effects lower the held-out error, without a full stop.

    Args:
        accepted: the accepted effects, each with its indistinguishable alternatives.
        base_rmse: held-out error of the base model [unit].
        last_rmse: held-out error with all accepted effects [unit].
        unit: unit of the effort.
    """
    names = " and ".join(
        f"{entry.effect} (indistinguishable from {' or '.join(entry.confused_with)})"
        if entry.confused_with
        else entry.effect
        for entry in accepted
    )
    return f"the error falls from {with_unit(base_rmse, unit)} to {with_unit(last_rmse, unit)} with {names}"


def _reason(
    evidence: Evidence, verdict: Verdict, accepted: Sequence[AcceptedEffect], ranking: Sequence[RankedEffect]
) -> str:
    unit, last = evidence.search.data.effort_unit, evidence.stages[-1].rmse
    if verdict is Verdict.ADEQUATE:
        explained = (
            ", and a flexible regression explains no more of this error than of the error in data simulated "
            "from the model"
        )
        return (
            "no effect of the library lowers the error in held-out runs by more than chance"
            f"{_describe_motion_error(evidence) or explained}{_describe_oscillation(evidence.end)}"
        )
    signals, noise = ", ".join(evidence.signals) or "a mix of signals", evidence.noise.value
    left = f"the residual depends on {signals}"
    if last > noise > 0.0:
        times = f"{'at least ' * evidence.noise.is_bound}{rounded(last / noise, 2)}"
        left = f"the residual is {times} times the noise, and depends on {signals}"
    if evidence.residual_finding:
        left = evidence.residual_finding.reason
    elif not evidence.signals and evidence.noise.is_bound:
        left = f"{_explained_variance(evidence)}, and only an upper bound of the noise is known"
    error = "remaining squared error" if accepted else "squared error"
    beyond = f"; {evidence.extrapolation.describe(error)}" if evidence.extrapolation else ""
    if evidence.confused_with_runs is not None:
        base = evidence.confused_with_runs.describe("squared error of the base model")
        beyond = f"; {base}, and a law of the motion may look like this difference between runs"
    if verdict is Verdict.MISSING:
        decrease = error_decrease(accepted, evidence.stages[0].rmse, last, unit)
        if evidence.leaves_only_noise:
            nothing = "only noise is left"
        elif evidence.noise.is_bound:
            nothing = "the remaining error may be noise, because only an upper bound of the noise is known"
        else:
            times = f", {rounded(last / noise, 2)} times the noise," if noise > 0.0 else ""
            nothing = f"the remaining error{times} depends on no recorded signal"
        if evidence.complete:
            motion_error = "" if evidence.leaves_only_noise else _describe_motion_error(evidence)
            return f"{decrease}, and {nothing}{motion_error}{_describe_oscillation(evidence.end)}{beyond}"
        return f"{decrease}{beyond}; {left}"
    reason = f"the error is {with_unit(last, unit)}{beyond}; {left}"
    if not ranking or ranking[0].score < SMALL:
        return reason
    best = f"{ranking[0].effect}, removes {100 * ranking[0].score:.0f} % of the error"
    failed = ""
    if evidence.partial is not None:
        criteria = FormCriteria(evidence.search, evidence.partial, evidence.single_effects[ranking[0].effect])
        failed = criteria.failed_by(next(test for test in criteria.tests if test.effect == ranking[0].effect))
    why_not = failed or "does not meet the criteria for naming it"
    return f"{reason}; the best single effect, {best}, but {why_not}"


def _explained_variance(evidence: Evidence) -> str:
    """State how much of the effort's variance the model explains."""
    problem = evidence.end.problem
    variance = float(np.var(problem.blocked.effort[problem.used]))
    percent = 100.0 * max(1.0 - evidence.end.held_out_mean_square / variance, 0.0)
    return f"the model explains {percent:.0f} % of the variance of the effort"


def _describe_motion_error(evidence: Evidence) -> str:
    """Describe how much of a complete model's error may come from errors in the motion."""
    end, unit = evidence.end, evidence.search.data.effort_unit
    if is_mostly_smoothing(end, evidence.measurement):
        smoothing = with_unit(smoothing_error(end, evidence.measurement), unit)
        return f"; smoothing of the motion causes errors of up to {smoothing}, which may be most of the error"
    causes = {"rounding of the encoders": encoder_step_error, "smoothing of the motion": smoothing_error}
    left = np.sqrt(max(end.flexible.explained, 0.0) / max(end.problem.used.sum(), 1))
    if end.explainable_share() > SMALL:
        for cause, error_of in causes.items():
            if left <= (most := error_of(end, evidence.measurement)):
                explained = f"the {with_unit(left, unit)} that a flexible regression explains"
                return (
                    f"; {cause} causes errors of up to {with_unit(most, unit)}, enough to account for "
                    f"{explained}"
                )
    return ""


def _describe_oscillation(end: FitResult) -> str:
    """Describe an oscillation within the noise, such as mains hum, a fan or a drive."""
    line = periodic_component(end) if free_air_noise(end.data) else None
    if line is None:
        return ""
    size = with_unit(np.sqrt(line[1]) * end.rmse, end.data.effort_unit)
    return f"; a part of the noise ({size} rms) oscillates at {line[0]:.3g} Hz, also in free air"
