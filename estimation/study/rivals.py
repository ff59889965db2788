"""The models among which a diagnosis has not decided."""

from estimation.diagnosis import ChannelDiagnosis, Verdict
from estimation.fit.standing import Standing
from estimation.study.channels import StudyChannel
from estimation.study.fits import Fits
from robot_io.errors import InputError

MOST = 4  # rivals that are compared with each other


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
    """These models by their effects in words, fitted; one that cannot be fitted is left out."""
    fitted = {}
    for effects in rival_effects(found) if is_undecided(found) else ():
        try:
            fitted[" + ".join(effects) or channel.model.name] = study.fit(channel, effects).standing
        except InputError:
            continue
    return dict(sorted(fitted.items(), key=lambda item: item[1].rmse))
