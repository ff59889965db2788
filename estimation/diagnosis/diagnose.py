"""Diagnose channels: search for missing effects, test the models, and state the verdict."""

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from itertools import repeat
from zlib import crc32

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.data_quality import reject_reason, usable
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.design.next_experiment import FEW_READINGS
from palpate.estimation.diagnosis.acceptance import (
    accept_effects,
    accept_forms,
    is_smoothing,
    most_parsimonious,
    smallest_sufficient_model,
)
from palpate.estimation.diagnosis.agreement import contradicted_effect, is_shared, replaceable_effects
from palpate.estimation.diagnosis.bootstrap import encoder_step_error, improvement_test
from palpate.estimation.diagnosis.candidates import effect_library
from palpate.estimation.diagnosis.completeness import Completeness
from palpate.estimation.diagnosis.forms import (
    AS_MUCH,
    FormTest,
    PartiallyLinear,
    analyze_kinds,
    form_tests,
    imitating_effect,
    named_forms,
)
from palpate.estimation.diagnosis.residual_checks import exceeds_noise
from palpate.estimation.diagnosis.result import ChannelDiagnosis, Diagnosis
from palpate.estimation.diagnosis.search import (
    MOST_EFFECTS,
    Progress,
    Search,
    prepare_search,
    select_effects,
)
from palpate.estimation.diagnosis.verdict import (
    Evidence,
    decide_verdict,
    insufficient_diagnosis,
    unreached_effect,
)
from palpate.estimation.effect import Effect
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import MeasurementModel
from palpate.estimation.kinds import PHYSICAL_KINDS
from palpate.estimation.model import Model
from palpate.estimation.shared_gains import with_shared_gains
from palpate.estimation.signals.motion import FEW_LEVELS, is_stepwise_command
from palpate.estimation.workers import single_threaded, worker_pool
from palpate.robot_io.errors import InputError

_EXTENSIONS = 3  # best candidates that are tried beside accepted effects
_MIN_ADEQUATE = 100  # samples below which a model is not called adequate


def diagnose(
    data: ChannelData | Sequence[ChannelData],
    model: Model | Sequence[Model],
    effects: Iterable[Effect] | None = None,
    *,
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
    file: str = "",
    processes: int = 1,
) -> Diagnosis:
    """Diagnose each channel; the result has one entry for each, in the order given.

    If a channel cannot distinguish its effect from one of the arm that another channel shows, such as a
    payload, it is diagnosed again without this effect. It is also diagnosed again without an effect of the
    arm that another joint excludes, such as a tilt of the base.

    Args:
        data: one channel or several.
        model: one base model for all channels, or one for each.
        effects: the library of candidate effects; by default all effects of palpate.
        rng: random generator for bootstrap samples and permutations.
        progress: callback that receives the current step and its completed share, from 0 to 1.
        file: name of the data's source, which the result states.
        processes: number of processes for the channels.

    Raises:
        InputError: the number of models is not that of the channels.
    """
    channels = [data] if isinstance(data, ChannelData) else list(data)
    models = [model] * len(channels) if isinstance(model, Model) else list(model)
    if len(models) != len(channels):
        raise InputError(
            f"{len(channels)} channels, but {len(models)} base models: give one, or one per channel"
        )
    library = effect_library() if effects is None else tuple(effects)
    channels = with_shared_gains(channels, models)
    seed = int(rng.integers(2**32))  # makes the random numbers of a channel independent of the other channels

    def seeded(channel: ChannelData) -> np.random.Generator:
        return np.random.default_rng([seed, crc32(channel.name.encode())])

    jobs = channels, models, repeat(library), map(seeded, channels)
    with single_threaded():
        if processes == 1 or len(channels) == 1:
            diagnoses = list(map(diagnose_channel, *jobs, repeat(progress)))
        else:
            with worker_pool(min(processes, len(channels))) as pool:
                results, diagnoses = pool.map(diagnose_channel, *jobs), []
                for channel in channels:
                    progress(f"{channel.name}: judging", 0.0)
                for diagnosis in results:
                    progress(f"{diagnosis.channel}: {diagnosis.verdict.value}", 1.0)
                    diagnoses.append(diagnosis)
        numbers = {channel.name: number for number, channel in enumerate(channels)}

        def without(name: str, *effects: str) -> ChannelDiagnosis:
            channel, base = channels[numbers[name]], models[numbers[name]]
            others = tuple(effect for effect in library if effect.name not in effects)
            return diagnose_channel(channel, base, others, seeded(channel), progress)

        for name, left_out, shared in replaceable_effects(diagnoses):
            first, again = diagnoses[numbers[name]], without(name, left_out)
            if is_shared(shared, again, diagnoses) and (again.complete or not first.complete):
                diagnoses[numbers[name]] = again
        for number, first in enumerate(diagnoses):
            again, excluded = first, list[str]()
            while effect := contradicted_effect(again, diagnoses, channels, models, library):
                excluded.append(effect)
                again = without(first.channel, *excluded)
            if again.complete:
                diagnoses[number] = again
    name = "+".join(dict.fromkeys(model.name for model in models))
    return Diagnosis(file=file, model=name, channels=diagnoses)


def diagnose_channel(
    data: ChannelData,
    model: Model,
    effects: tuple[Effect, ...],
    rng: np.random.Generator,
    progress: Progress = lambda what, share: None,
) -> ChannelDiagnosis:
    """Diagnose one channel; see `diagnose`.

    Args:
        data: the channel, with its motion.
        model: the base model.
        effects: the library of candidate effects.
        rng: random generator for bootstrap samples and permutations.
        progress: callback that receives the current step and its completed share, from 0 to 1.
    """
    if reason := reject_reason(data):
        return insufficient_diagnosis(data, reason)
    search = prepare_search(data, model, usable(data), effects, rng, progress)
    checks = Completeness(search.start, search.rng)
    evidence = _search_evidence(search, checks)
    names = search.added_effects(evidence.end)
    may_be_rounding = "quantisation" not in names if names else not evidence.complete
    if may_be_rounding and (reason := _too_few_levels(search.start)):
        return insufficient_diagnosis(data, reason)
    if evidence.complete and not names and len(data) < _MIN_ADEQUATE:
        reason = f"no missing effect was found, but {len(data)} samples would show only a large effect"
        return insufficient_diagnosis(data, f"{reason}; record at least {_MIN_ADEQUATE}")
    return decide_verdict(evidence)


def _search_evidence(search: Search, checks: Completeness) -> Evidence:
    """Search for missing effects and return what supports them.

    If an effect of a complete model only imitates another kind, the other effects of the library are tried
    without it.
    """
    kinds = cache(lambda: analyze_kinds(search))
    coarse_kinds = cache(partial(analyze_kinds, search.coarse)) if search.coarse else kinds

    def evidence_of(end: FitResult, tests: list[FormTest]) -> Evidence:
        complete = checks.is_complete(end)
        if not complete and not search.added_effects(end):
            complete = checks.leaves_smoothing(end)
        partials = (None, None) if complete else (kinds(), coarse_kinds())
        return Evidence(
            search, checks.measurement, end, complete, checks.residual_finding(end), tests, *partials
        )

    end, tests = _find_effects(search, checks, kinds, coarse_kinds)
    evidence = evidence_of(end, tests)
    if evidence.complete and not _is_reached(evidence, checks):
        checks.incomplete.add(end)
        evidence = evidence_of(*accept_forms(search, kinds(), end, checks.measurement))
        end = evidence.end
    while name := (unreached := unreached_effect(evidence)) or imitating_effect(search, end):
        if evidence.complete and not unreached:
            others = _search_evidence(search.excluding(name), checks)
            if others.complete and search.added_effects(others.end):
                return others
        end = search.without(end, name)
        evidence = evidence_of(end, form_tests(kinds(), end))
    return evidence


def _find_effects(
    search: Search,
    checks: Completeness,
    kinds: Callable[[], PartiallyLinear],
    coarse_kinds: Callable[[], PartiallyLinear],
) -> tuple[FitResult, list[FormTest]]:
    """Search for missing effects; return the base model with the accepted ones, and the test of each form."""
    fit = search.start
    if not fit.is_exact:
        sufficient = partial(smallest_sufficient_model, search, measurement=checks.measurement)

        @cache
        def forms() -> FitResult:
            search.progress(f"{search.data.name}: comparing effects of the same kind", 0.0)
            return named_forms(coarse_kinds())

        fit = select_effects(search, checks.is_complete, sufficient, forms)
    end, tests = _accept(search, fit, checks, kinds)
    if not fit.is_exact and not checks.is_complete(end):
        coarse_forms = forms()
        forms_fit = search.fitted(coarse_forms.solution.model, coarse_forms.solution.parameters)
        rival, rival_tests = accept_forms(search, kinds(), forms_fit, checks.measurement)
        if search.is_better(rival, end) and not _is_likelier(search, end, rival):
            end, tests = rival, rival_tests
        end, tests = _extend_accepted(search, end, tests, checks, kinds)
    return end, tests


def _extend_accepted(
    search: Search,
    end: FitResult,
    tests: list[FormTest],
    checks: Completeness,
    kinds: Callable[[], PartiallyLinear],
) -> tuple[FitResult, list[FormTest]]:
    """Add effects to an incomplete model as long as more of them are accepted; one may replace another.

    The search selects the effects that fit best jointly. If some of them are not accepted, it may have missed
    the effects that explain their part of the error.
    """
    while not checks.is_complete(end) and len(accepted := search.added_effects(end)) < MOST_EFFECTS:
        possible = [candidate for candidate in search.screen(end) if candidate.possible][:_EXTENSIONS]
        needed = (each for each in map(search.with_candidate, possible) if search.is_needed(end, each))
        plausible, fewest = map(search.replace_implausible, needed), len(accepted) + 1
        tried = (accept_forms(search, kinds(), each, checks.measurement, fewest) for each in plausible)
        longer = next((pair for pair in tried if len(search.added_effects(pair[0])) >= fewest), None)
        if longer is None:
            break
        end, tests = longer
    return end, tests


def _is_likelier(search: Search, end: FitResult, rival: FitResult) -> bool:
    """Return whether a model, unlike its rival, has a physical effect, and explains about as much."""
    # Differences between runs, sensor faults and drifts can imitate what is constant in each run.
    has_physical, rival_has = (
        any(fit.solution.model.effect(name).kind in PHYSICAL_KINDS for name in search.added_effects(fit))
        for fit in (end, rival)
    )
    base = search.start.solution.held_out
    explains_as_much = base - end.solution.held_out >= AS_MUCH * (base - rival.solution.held_out)
    return has_physical and not rival_has and explains_as_much


def _is_reached(evidence: Evidence, checks: Completeness) -> bool:
    """Return whether a complete model is also complete if its effects are added one by one, as users do."""
    shown = evidence.stages[-1]
    return shown.rmse <= (1.0 + SMALL) * evidence.end.rmse or checks.is_complete(shown)


def _accept(
    search: Search, fit: FitResult, checks: Completeness, kinds: Callable[[], PartiallyLinear]
) -> tuple[FitResult, list[FormTest]]:
    """Reduce a model to its accepted effects, and return it with their form tests."""
    # If only gains differ between runs, a model still explains each run, and significance tests apply.
    is_complete, is_explained = checks.is_complete(fit), checks.explains_each_run(fit)
    if is_explained:
        is_as_complete = checks.is_complete if is_complete else checks.explains_each_run
        end = accept_effects(search, fit, checks.measurement, is_as_complete)
        if end is not search.start:
            checks.incomplete.add(search.start)
            end = most_parsimonious(search, end, checks.measurement, is_as_complete)
            if checks.explains_each_run(end):
                return end, form_tests(kinds(), end)
            fit = end
        elif (
            is_complete
            and checks.leaves_noise(end)
            and search.added_effects(fit)
            and search.is_sensible(fit)
            and exceeds_noise(end, checks.measurement, search.rng) is None
        ):  # the complete model improves bootstrap samples of the base model as much as the data
            checks.cleared.add(end)
    if checks.is_complete(search.start):
        # The error of the base model may hide what makes a better model incomplete, such as runs that differ.
        if is_explained or not _improves(search, fit, checks.measurement):
            return search.start, []  # improvements come from noise or from smoothing of the motion
        checks.incomplete.add(search.start)
    return accept_forms(search, kinds(), fit, checks.measurement)


def _improves(search: Search, fit: FitResult, measurement: MeasurementModel) -> bool:
    """Return whether effects improve the base model more than chance, encoder steps and smoothing do."""
    base = search.start
    if base.is_exact or not search.added_effects(fit) or not search.is_sensible(fit):
        return False
    explained = base.held_out_mean_square - fit.held_out_mean_square
    if explained <= encoder_step_error(base, measurement) ** 2 or is_smoothing(base, fit):
        return False
    return improvement_test(base, fit, measurement, search.rng).is_significant


def _too_few_levels(start: FitResult) -> str | None:
    """Explain why an effort with few distinct readings does not allow a diagnosis; None if it does."""
    # Quantization errors repeat with the motion (B. Widrow, I. Kollar, 2008); a stepwise command is exact.
    data = start.data
    levels = np.unique(data.effort)
    if not 1 < len(levels) <= FEW_LEVELS or is_stepwise_command(data):
        return None
    step, unit = float(np.median(np.diff(levels))), data.effort_unit
    if start.rmse >= step:
        return None
    return (
        f"the effort has only {len(levels)} {FEW_READINGS}, {with_unit(step, unit)} apart. The model error "
        f"of {with_unit(start.rmse, unit)} is less than one such step, so the residual may be rounding; use "
        "a finer sensor, or a motion with larger efforts"
    )
