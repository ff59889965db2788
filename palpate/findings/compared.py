"""Models beside the measurement: base models, or what became of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.comparison import Comparison, compare_standing
from estimation.effect import Effect
from estimation.revision import standings
from palpate.findings.effect_library import EffectLibrary
from palpate.findings.estimation_run import Arm, Material
from palpate.findings.kept_diagnosis import KeptDiagnosis, is_same
from palpate.findings.revisions import KeptRevision, RevisionShelf
from palpate.findings.story import model_name
from palpate.findings.subject import Subject, subject_of
from robot_io.errors import InputError


@dataclass(frozen=True)
class Wanted:
    """What is to be compared.

    Attributes:
        subject: the channel and its base model.
        revision: what was added to that; None for the base model alone.
    """

    subject: Subject
    revision: KeptRevision | None = None

    @property
    def added(self) -> list[str]:
        """Effects that were added to the base model."""
        return self.revision.effects if self.revision is not None else []


def of_revisions(
    material: Material, arm: Arm, shelf: RevisionShelf, library: EffectLibrary, numbers: Sequence[int]
) -> list[Wanted]:
    """The channels of these revisions.

    Raises:
        InputError: there is no such revision or channel, two are of one channel, or one has an effect of the
            user's own that is not in the library.
    """
    chosen = [shelf.get(number) for number in dict.fromkeys(numbers)]
    names = [revision.channel for revision in chosen]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f"--revision: several of channel '{min(twice)}'; compare one after the other")
    there = {channel.name: channel for channel in material.channels}
    for revision in chosen:
        library.check_own(revision)
        if revision.channel not in there:
            raise InputError(
                f"revision {revision.number} is of channel '{revision.channel}', which is not there"
            )
    return [Wanted(subject_of(there[one.channel], one.model, arm), one) for one in chosen]


def compare_wanted(
    wanted: Wanted, kept: KeptDiagnosis, shelf: RevisionShelf, effects: Sequence[Effect]
) -> Comparison:
    """Fit what is wanted, and compare; the floor is the lowest that was ever found for this channel.

    Args:
        wanted: the model.
        kept: what was found earlier in the same data.
        shelf: its revisions.
        effects: where those that were added are found.

    Raises:
        InputError: the channel cannot be judged, or an effect is not among those known.
    """
    subject = wanted.subject
    fitted = standings(subject.channel, subject.model, wanted.added, effects)
    base = last = next(fitted)
    floor = _known_floor(subject, base.rmse, kept, shelf)
    for last in fitted:  # noqa: B007, it is used after the loop
        pass
    return replace(compare_standing(last, floor), model=model_name(subject.model.name, wanted.added))


def _known_floor(subject: Subject, base_rmse: float, kept: KeptDiagnosis, shelf: RevisionShelf) -> float:
    """The lowest noise floor that diagnosis and revisions of the same data found; infinite without any."""
    found = kept.of(subject.channel.name, base_rmse)
    floors = [found.noise_floor] if found is not None and found.noise_floor is not None else []
    own = [one for one in shelf.all() if one.channel == subject.channel.name]
    floors += [one.noise_floor for one in _grown_from(base_rmse, own)]
    return min(floors, default=float("inf"))


def _grown_from(base_rmse: float, revisions: Sequence[KeptRevision]) -> list[KeptRevision]:
    """Those that began with a base model of this error, out of all of a channel, oldest first."""
    grown: dict[int, KeptRevision] = {}
    for one in revisions:
        begins = not one.effects and is_same(one.rmse, base_rmse)
        if begins or (one.parent is not None and one.parent in grown):
            grown[one.number] = one
    return list(grown.values())
