"""The models among which a diagnosis has not decided, and the simplest of those that nothing sets apart."""

from collections.abc import Mapping
from dataclasses import replace

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.diagnosis.candidates import candidates, try_all
from estimation.diagnosis.doubt import SMALL
from estimation.fit.frame import coarse_copy
from estimation.fit.load import with_load
from estimation.fit.memory import Memory
from estimation.fit.standing import Standing, fit
from estimation.model import Model
from estimation.study.channels import StudyChannel
from estimation.study.fits import Fits
from estimation.study.reconcile import reconcile
from robot_io.errors import InputError

MOST = 4  # rivals that are compared with each other
_CONTAINED = 1e-3  # of the energy of what a law adds, that is left where another contains it
_UNSEEN = (1.0 + SMALL) ** 2 - 1.0  # of the energy of the noise: it raises the error by what decides nothing


def is_undecided(found: ChannelDiagnosis) -> bool:
    """Whether several explanations are left, or none that explains all."""
    if found.verdict in {Verdict.INSUFFICIENT, Verdict.ADEQUATE}:
        return False
    return not found.complete or any(entry.confused_with for entry in found.accepted)


def rival_effects(found: ChannelDiagnosis) -> list[list[str]]:
    """Effects of each model that may be the right one, beside the base model's; the best first.

    Where an effect is not told from others, each in its place. Where something is left: what is established
    (the base model, where nothing is), and each of the best candidates alone.
    """
    names = [entry.effect for entry in found.accepted]
    for entry in found.accepted:
        if entry.confused_with:
            others = [name for name in names if name != entry.effect]
            return [[*others, one] for one in (entry.effect, *entry.confused_with)][:MOST]
    alone = [[one.effect] for one in found.ranking if one.score > 0.0 and one.effect not in names]
    return [names, *alone][:MOST]


def rivals_of(study: Fits, channel: StudyChannel, found: ChannelDiagnosis) -> dict[str, Standing]:
    """These models by their effects in words, fitted; one that cannot be fitted is left out.

    Where something is left and no candidate is any good, those that take most away are compared, good or not:
    an experiment that would show them is one in which there is more to see.
    """
    if not is_undecided(found):
        return {}
    fitted, wanted = {}, rival_effects(found)
    if len(wanted) == 1:
        wanted += [[name] for name in _telling_most(study, channel)]
    for effects in wanted:
        try:
            fitted[" + ".join(effects) or channel.model.name] = study.fit(channel, effects).standing
        except InputError:
            continue
    return dict(sorted(fitted.items(), key=lambda item: item[1].rmse))


def _telling_most(study: Fits, channel: StudyChannel) -> list[str]:
    base = study.fit(channel)
    tried = try_all(base.standing, candidates(base.data, base.model, study.effects))  # the best first
    return [one.effect.name for one in tried[: MOST - 1]]


def with_the_simplest(study: Fits, channel: StudyChannel, found: ChannelDiagnosis) -> ChannelDiagnosis:
    """The diagnosis without rivals that are less simple than another and contain it.

    To be asked where no experiment that can be made tells them apart: what a law has beyond a simpler one is
    then nothing that anybody could see. What remains undecided stays so. Of two laws the simpler has fewer
    parameters, or as many and depends on less: friction, beside friction that remembers its path.
    """
    place = next((n for n, entry in enumerate(found.accepted) if entry.confused_with), None)
    if place is None:
        return found
    entry, accepted = found.accepted[place], list(found.accepted)
    others = [one.effect for one in accepted if one is not entry]
    names = [entry.effect, *entry.confused_with]
    models = {name: study.fit(channel, [*others, name]).standing for name in names}
    first, *rest = [name for name in names if not _contains_another(models[name], models)]
    effect = next(one for one in study.effects if one.name == first)
    about = {"physics": effect.physics, "equation": effect.equation, "signature": effect.signature}
    accepted[place] = entry.model_copy(update={"effect": first, "confused_with": rest, **about})
    return reconcile(study, channel, found.model_copy(update={"accepted": accepted}))


def _contains_another(larger: Standing, models: Mapping[str, Standing]) -> bool:
    return any(_is_simpler(one, larger) and _contains(larger, one) for one in models.values())


def _is_simpler(one: Standing, other: Standing) -> bool:
    """Whether a model is simpler than another that differs from it in the last effect."""
    sizes = [_size(each.trial.model) for each in (one, other)]
    few, many = (set(each.trial.model.effects[-1].signals) for each in (one, other))
    return sizes[0] < sizes[1] or (sizes[0] == sizes[1] and few < many)


def _contains(larger: Standing, smaller: Standing) -> bool:
    """Whether a model, fitted anew, draws what a smaller one expects, but for noise."""
    frame, model, known = smaller.plain.frame, smaller.trial.model, smaller.trial.parameters
    motion, memory = coarse_copy(frame), Memory()
    drawn = replace(motion, effort=model.predict(with_load(motion, model, known), known))
    without = fit(drawn, model.without(model.effects[-1].name), known, frame.trusted, memory)
    tried = try_all(without, larger.trial.model.effects[-1:])[0].search.best
    again = fit(drawn, tried.model, tried.parameters, frame.trusted, memory)
    return again.trial.sse < max(_CONTAINED * without.trial.sse, _UNSEEN * smaller.trial.sse)


def _size(model: Model) -> int:
    return len(model.gains) + len(model.inner)
