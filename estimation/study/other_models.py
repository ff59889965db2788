"""Other models: undecided rivals, and base models or independent runs that fit a measurement better."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

from palpate.estimation.design.discrimination import SMALL, separated_pairs
from palpate.estimation.design.next_experiment import (
    NO_PROBE,
    NO_VARIED_MOTION,
    propose_known_experiment,
    varied_motions,
)
from palpate.estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.estimation.diagnosis.candidates import applicable_effects, is_misnamed, screen_effects
from palpate.estimation.diagnosis.result import AcceptedEffect, FitSummary, stage_numbers
from palpate.estimation.diagnosis.verdict import error_decrease
from palpate.estimation.effect import Effect
from palpate.estimation.fit.blocks import decimate, with_load
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.model import Model
from palpate.estimation.models import MODELS
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.estimation.study.channels import ARM_MODEL, FITTED_ARM_MODEL, StudyChannel
from palpate.estimation.study.comparison import FAR, Comparison
from palpate.estimation.study.fits import StudyFits
from palpate.robot_io.errors import InputError

MAX_RIVALS = 6  # largest number of rivals that are compared
_MAX_SINGLE = 4  # the same, including the accepted model, if the missing effect is unknown
_MAX_REST = 1e-3  # largest relative residual of a law's contribution if another law contains it
_NEGLIGIBLE = (1.0 + SMALL) ** 2 - 1.0  # largest difference of equal decisions, relative to the noise energy


def is_undecided(diagnosis: ChannelDiagnosis) -> bool:
    """Return whether several explanations remain, or none explains everything.

    Args:
        diagnosis: the diagnosis.
    """
    if diagnosis.verdict in {Verdict.INSUFFICIENT, Verdict.ADEQUATE}:
        return False
    return not diagnosis.complete or any(entry.confused_with for entry in diagnosis.accepted)


def rival_effects(diagnosis: ChannelDiagnosis, effects: Iterable[Effect]) -> list[list[list[str]]]:
    """Return, for each open question, the added effects of all plausible models, the best first.

    Each accepted effect that is indistinguishable from others raises one question, in which each alternative
    replaces it. Otherwise, if part of the error remains unexplained, the rivals are the accepted effects (or
    the base model) and each of the best candidates alone.

    Args:
        diagnosis: the diagnosis.
        effects: the library; a composite effect replaces all its parts.
    """
    names = [entry.effect for entry in diagnosis.accepted]
    parts = {effect.name: effect.parts for effect in effects}
    questions = [
        [_replace_effect(names, entry.effect, rival, parts.get(rival, ())) for rival in _candidates(entry)]
        for entry in diagnosis.accepted
        if entry.confused_with
    ]
    alone = [
        [ranked.effect] for ranked in diagnosis.ranking if ranked.score > 0.0 and ranked.effect not in names
    ]
    return [models[:MAX_RIVALS] for models in questions] or [[names, *alone][:_MAX_SINGLE]]


def _candidates(entry: AcceptedEffect) -> list[str]:
    return [entry.effect, *entry.confused_with]


def _replace_effect(names: Sequence[str], place: str, rival: str, parts: Sequence[str]) -> list[str]:
    """Append the rival, and remove the effect `place` and the effects that the rival combines."""
    return [*(name for name in names if name != place and name not in parts), rival]


def rivals_of(
    study: StudyFits, channel: StudyChannel, diagnosis: ChannelDiagnosis
) -> list[dict[str, FitResult]]:
    """Fit the rival models of each open question, by the names of their effects, the best first.

    Models that cannot be fitted are omitted. If part of the error remains and no candidate is significant,
    the candidates that reduce the error most are compared.

    Args:
        study: the measurement and its fits.
        channel: the channel with its base model.
        diagnosis: the diagnosis of that channel.
    """
    if not is_undecided(diagnosis):
        return []
    effects_of_questions = rival_effects(diagnosis, study.effects)
    if len(effects_of_questions[0]) == 1:
        base = study.fit(channel).training_fit
        ranked = screen_effects(base, applicable_effects(base.data, base.model, study.effects))  # best first
        effects_of_questions = [
            [*effects_of_questions[0], *([candidate.effect.name] for candidate in ranked[: _MAX_SINGLE - 1])]
        ]
    questions = []
    for models in effects_of_questions:
        fitted = {}
        for effects in models:
            with suppress(InputError):
                fitted[" + ".join(effects) or channel.model.name] = study.fit(channel, effects).training_fit
        if len(fitted) > 1:
            questions.append(dict(sorted(fitted.items(), key=lambda item: item[1].rmse)))
    return questions


def state_inseparable(
    study: StudyFits, channel: StudyChannel, diagnosis: ChannelDiagnosis, *, is_arm: bool
) -> ChannelDiagnosis:
    """Drop explanations that contain a simpler one, and state that no experiment separates the others.

    Explanations of recorded data that are still left keep the experiment that the library states for them.

    Args:
        study: the measurement and its fits.
        channel: the channel with its base model.
        diagnosis: the diagnosis of that channel.
        is_arm: whether the experiments of an arm were examined, not changes of the recorded motion.
    """
    settled = keep_simplest_rivals(study, channel, diagnosis)
    statement = NO_PROBE if is_arm else NO_VARIED_MOTION
    statement = _describe_dropped(diagnosis, settled, statement) or statement
    open_entry = next((entry for entry in settled.accepted if entry.confused_with), None)
    following = None
    if open_entry is not None and not is_arm:
        effect = next(effect for effect in study.effects if effect.name == open_entry.effect)
        following = propose_known_experiment(effect, _candidates(open_entry), channel.data)
    return settled.model_copy(update={"next_experiment": following, "no_experiment": statement})


def _describe_dropped(before: ChannelDiagnosis, after: ChannelDiagnosis, reason: str) -> str:
    """State the explanations that were dropped; empty if there are none."""
    names, left = (
        [name for entry in item.accepted for name in _candidates(entry)] for item in (before, after)
    )
    dropped = dict.fromkeys(name for name in names if name not in left)
    words = f"laws that contain a simpler law are left out ({', '.join(dropped)}), because {reason}"
    return words if dropped else ""


def drop_inseparable(
    study: StudyFits,
    channel: StudyChannel,
    diagnosis: ChannelDiagnosis,
    separated: Collection[frozenset[str]] | None = None,
) -> ChannelDiagnosis:
    """Drop explanations that no experiment separates from a simpler one that they contain.

    The proposed experiment is kept, because it separates other explanations.

    Args:
        study: the measurement and its fits.
        channel: the channel with its base model.
        diagnosis: the diagnosis of that channel, with an experiment for other explanations.
        separated: pairs of models that an experiment of the arm separates; None to compare changes of the
            recorded motion.
    """
    reason = NO_PROBE
    if separated is None:
        separated, reason = set(), NO_VARIED_MOTION
        for models in rivals_of(study, channel, diagnosis):
            leads = (experiment.leads[0] for experiment in varied_motions(models, channel.data))
            separated |= separated_pairs([*models], leads)
    settled = keep_simplest_rivals(study, channel, diagnosis, separated)
    reason = f"{reason.removesuffix('the explanations')}the two"  # other explanations can be separated
    return settled.model_copy(update={"no_experiment": _describe_dropped(diagnosis, settled, reason)})


def keep_simplest_rivals(
    study: StudyFits,
    channel: StudyChannel,
    diagnosis: ChannelDiagnosis,
    separated: Collection[frozenset[str]] = (),
) -> ChannelDiagnosis:
    """Remove rivals that contain a simpler one.

    It applies to rivals that no feasible experiment separates, so that a law cannot be distinguished from a
    simpler law of the same kind that it contains. Other rivals remain undecided. A law is simpler if it has
    fewer parameters, or equally many and depends on fewer signals; for example, Coulomb friction is simpler
    than presliding friction. A composite effect and its parts are the same law, so that neither is simpler.

    Args:
        study: the measurement and its fits.
        channel: the channel with its base model.
        diagnosis: the diagnosis of that channel.
        separated: pairs of models that an experiment separates, by the names of their effects.
    """
    known = {effect.name: effect for effect in study.effects}
    for place in range(len(diagnosis.accepted)):
        accepted, names = list(diagnosis.accepted), [entry.effect for entry in diagnosis.accepted]
        entry = accepted[place]
        if not entry.confused_with:
            continue
        rivals = {
            rival: _replace_effect(names, entry.effect, rival, known[rival].parts)
            for rival in _candidates(entry)
        }
        models: dict[str, FitResult] = {}
        for rival, effects in rivals.items():
            with suppress(InputError):  # one that cannot be fitted beside the other effects remains undecided
                models[rival] = study.fit(channel, effects).training_fit
        kept: list[str] = []
        for name in sorted(models, key=lambda name: (_size(models[name].model), len(known[name].signals))):
            simpler = [
                rival
                for rival in kept
                if _is_simpler(models, rival, name)
                and frozenset(" + ".join(rivals[each]) for each in (rival, name)) not in separated
            ]
            effect, fit = models[name].model.effect(name), models[name]
            is_other = bool(simpler) and is_misnamed(effect, fit.solution, fit.problem)
            if not is_other and not any(_contains(models, rival, name) for rival in simpler):
                kept.append(name)
        first, *rest = [name for name in rivals if name in kept or name not in models]
        accepted[place] = entry.model_copy(update={"effect": first, "confused_with": rest})
        diagnosis = _with_accepted(study, channel, diagnosis, accepted)
    return diagnosis


def _with_accepted(
    study: StudyFits,
    channel: StudyChannel,
    diagnosis: ChannelDiagnosis,
    accepted: Sequence[AcceptedEffect],
) -> ChannelDiagnosis:
    """Replace the accepted effects, and update their descriptions and the numbers of their fits."""
    renamed = {old.effect: new.effect for old, new in zip(diagnosis.accepted, accepted, strict=True)}
    budget = [
        share.model_copy(update={"effects": [renamed.get(name, name) for name in share.effects]})
        for share in diagnosis.budget
    ]
    changed = diagnosis.model_copy(update={"accepted": list(accepted), "budget": budget})
    if diagnosis.baseline is None or diagnosis.final is None or diagnosis.noise_floor is None:
        return changed
    names = [entry.effect for entry in accepted]
    stages = [study.fit(channel, names[:count]).training_fit for count in range(len(names) + 1)]
    entries = [
        entry.model_copy(
            update=stage_numbers(entry.effect, before, after, stages[-1], entry.parameters.get("spread"))
        )
        for entry, (before, after) in zip(accepted, pairwise(stages), strict=True)
    ]
    base, last, unit = diagnosis.baseline.rmse, stages[-1].rmse, diagnosis.effort_unit
    before = error_decrease(diagnosis.accepted, base, diagnosis.final.rmse, unit)
    reason = error_decrease(entries, base, last, unit) + diagnosis.reason.removeprefix(before)
    times = last / diagnosis.noise_floor if diagnosis.noise_floor > 0.0 else 1.0
    numbers = {"rmse": last, "times_floor": times}
    remaining = diagnosis.remaining and diagnosis.remaining.model_copy(update=numbers)
    new = {"reason": reason, "remaining": remaining, "final": FitSummary.of(stages[-1]), "accepted": entries}
    return changed.model_copy(update=new)


def _is_simpler(models: Mapping[str, FitResult], rival: str, name: str) -> bool:
    """Return whether the model with a rival is simpler than the one with the effect `name` in its place."""
    smaller, larger = models[rival].model, models[name].model
    few, many = smaller.effect(rival), larger.effect(name)
    kinds = [{effect.kind} | effect.also for effect in (few, many)]
    if kinds[0].isdisjoint(kinds[1]):
        return False  # laws of different kinds are different explanations of the error
    if many.parts and {effect.name for effect in smaller.effects} >= set(many.parts):
        return False
    size, most = _size(smaller), _size(larger)
    return size < most or (size == most and set(few.signals) < set(many.signals))


def _contains(models: Mapping[str, FitResult], rival: str, name: str) -> bool:
    """Return whether the effect `name` can reproduce the prediction of a simpler rival, except for noise."""
    smaller = models[rival]
    blocked, model, known = smaller.problem.blocked, smaller.solution.model, smaller.solution.parameters
    motion, cache = decimate(blocked), FitCache()
    simulated = replace(motion, effort=model.predict(with_load(motion, model, known), known))
    without = fit_model(simulated, model.without(rival), known, blocked.trusted, cache)
    extended = screen_effects(without, [models[name].model.effect(name)])[0].search.best
    refitted = fit_model(simulated, extended.model, extended.parameters, blocked.trusted, cache)
    return refitted.solution.sse < max(_MAX_REST * without.solution.sse, _NEGLIGIBLE * smaller.solution.sse)


def _size(model: Model) -> int:
    return len(model.gains) + len(model.inner)


_FAR_RATIO = 0.5  # ratio of held-out errors below which another base model is suggested
_CLEAR_RATIO = 0.9  # ratio of held-out errors below which fitted masses of an arm's links are suggested
_EQUAL_RATIO = 1.02  # largest ratio to the error of a complete model at which another model fits equally well


def better_model(
    study: StudyFits, channel: StudyChannel, max_error: float, parameters: int | None = None
) -> tuple[str, float] | None:
    """Return the base model that fits a channel best and its held-out error; None if the error is too large.

    Args:
        study: the measurement and its fits.
        channel: the channel with its present base model, which is excluded.
        max_error: upper limit of the held-out error [effort].
        parameters: largest number of parameters; None for any number.
    """
    suitable = []
    for name in MODELS:
        if name == channel.model.name or channel.kind not in MODELS[name].channels:
            continue
        try:
            variant = study.with_model(channel.name, name)
            error = study.fit(variant).rmse
        except InputError:  # the model lacks information, such as a URDF
            continue
        count = len(variant.model.gains) + len(variant.model.inner)
        if error < max_error and count <= (parameters or count):
            suitable.append((name, error))
    return min(suitable, key=lambda model_and_error: model_and_error[1], default=None)


def far_better_model(
    study: StudyFits, channel: StudyChannel, usual: Comparison | None
) -> tuple[str, float] | None:
    """Return a base model that fits far better than the usual one, and its held-out error.

    The result is None unless the error of the usual model is far above the noise.

    Args:
        study: the measurement and its fits.
        channel: the channel with the usual base model.
        usual: comparison of the usual model; None if the channel cannot be fitted.
    """
    if usual is None or usual.lack_of_fit < FAR:
        return None
    return better_model(study, channel, _FAR_RATIO * usual.rmse)


def better_explanation(
    study: StudyFits, channel: StudyChannel, diagnosis: ChannelDiagnosis
) -> tuple[str, float] | None:
    """Return a base model that explains the channel far better than the usual one, and its held-out error.

    It must fit far better than the usual model with accepted effects. If these effects complete the usual
    model, this is impossible: the other model must then fit far better than the usual model alone, and as
    well as the complete model with no more parameters.

    Args:
        study: the measurement and its fits.
        channel: the channel with the usual base model.
        diagnosis: the diagnosis of this channel.
    """
    base, final = diagnosis.baseline, diagnosis.final
    if base is None or final is None or diagnosis.verdict is Verdict.ADEQUATE:
        return None
    if diagnosis.verdict is Verdict.UNEXPLAINED or diagnosis.complete is False:
        return better_model(study, channel, _FAR_RATIO * final.rmse)
    max_error = min(_FAR_RATIO * base.rmse, _EQUAL_RATIO * final.rmse)
    return better_model(study, channel, max_error, len(final.parameters))


def error_with_fitted_masses(
    study: StudyFits, channel: StudyChannel, diagnosis: ChannelDiagnosis
) -> float | None:
    """Return the held-out error with fitted masses of the arm's links [effort]; None unless clearly lower.

    Args:
        study: the measurement and its fits.
        channel: the channel with its base model.
        diagnosis: the diagnosis of this channel.
    """
    final = diagnosis.final
    if channel.model.name != ARM_MODEL or final is None or diagnosis.verdict is Verdict.ADEQUATE:
        return None
    with suppress(InputError):
        error = study.fit(study.with_model(channel.name, FITTED_ARM_MODEL)).rmse
        return error if error < _CLEAR_RATIO * final.rmse else None
    return None
