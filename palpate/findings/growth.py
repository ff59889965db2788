"""Adds effects to what a model has already, and keeps each stage."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.findings.effect_library import EffectLibrary
from palpate.findings.estimation_run import Arm, Material
from palpate.findings.kept_diagnosis import KeptDiagnosis
from palpate.findings.revisions import KeptRevision, RevisionShelf
from palpate.findings.same_data import SameData
from palpate.findings.story import Story, channel_for, tell_story
from palpate.findings.subject import Subject, only_channel, subject_of, subjects_of, usual_model
from robot_io.errors import InputError


@dataclass(frozen=True)
class Growth:
    """What was added.

    Attributes:
        story: all stages from the base model on.
        parent: the revision that was continued; None for a new beginning.
        kept: the new revisions.
    """

    story: Story
    parent: KeptRevision | None
    kept: list[KeptRevision]

    @property
    def numbers(self) -> list[int | None]:
        """Number of the revision of each stage; None where an earlier one has it."""
        missing = len(self.story.stages) - len(self.kept)
        return [None] * missing + [revision.number for revision in self.kept]


@dataclass(frozen=True)
class Wish:
    """What the user asks for.

    Attributes:
        effects: to add, in order.
        model: base model; None for that of the revision, or what suits the channel.
        channel: its name; None for the one that the effects suit.
        start: revision to continue; None for the newest of the same data, if any.
        fresh: begin with the base model again.
    """

    effects: Sequence[str]
    model: str | None = None
    channel: str | None = None
    start: int | None = None
    fresh: bool = False


def grow(  # noqa: PLR0917, what it grows from
    material: Material,
    arm: Arm,
    shelf: RevisionShelf,
    library: EffectLibrary,
    wish: Wish,
    kept: KeptDiagnosis | None = None,
) -> Growth:
    """Add effects, refitting everything at each stage.

    Args:
        material: the data.
        arm: what its channels belong to.
        shelf: earlier revisions, and where the new ones go.
        library: where effects are found.
        wish: what the user asks for.
        kept: what was found earlier: a joint is refitted by the force by which it was judged.

    Raises:
        InputError: a name is unknown, an effect is there already or does not apply, or options contradict.
    """
    start = shelf.get(wish.start) if wish.start is not None else None
    same = SameData(material, arm, shelf, kept, library.effects)
    if start is not None:
        subject = _continued(same, wish, start)
    else:
        chosen = [library.get(name) for name in wish.effects]
        subject = channel_for(only_channel(_begun(same, wish), wish.channel), chosen)
    parent = start
    if parent is None and not wish.fresh:
        parent = same.latest(subject.channel.name, subject.model.name)
    before = [] if parent is None else parent.effects
    if parent is not None:
        library.check_own(parent)
    _check_new(parent, wish)
    library.rehearse([subject.channel])
    if kept is not None:
        subject = kept.as_judged(subject)
    story = tell_story(subject, None, [*before, *wish.effects], library.effects, kept)
    unit = subject.channel.kind.effort_unit
    new = shelf.keep(subject.channel.name, unit, story.stages, parent=parent, user_effects=library.own)
    return Growth(story, parent, new)


def _continued(same: SameData, wish: Wish, start: KeptRevision) -> Subject:
    """The channel of a revision with its base model."""
    contradictions = {"--fresh": wish.fresh, "--model": wish.model, "--channel": wish.channel}
    given = [option for option, value in contradictions.items() if value]
    if given:
        raise InputError(f"--from {start.number} says channel and model already: leave out {given[0]}")
    subject = only_channel(subjects_of(same.material, start.model, same.arm), start.channel)[0]
    same.check(start)
    return subject


def _begun(same: SameData, wish: Wish) -> tuple[Subject, ...]:
    """The channels, each with the base model that the user names, else that of its newest revision."""
    material, arm = same.material, same.arm
    if wish.model is not None or wish.fresh:
        return subjects_of(material, wish.model, arm)
    wanted = [channel for channel in material.channels if wish.channel in {None, channel.name}]
    newest = [same.latest(channel.name) for channel in wanted]
    begun = tuple(
        subject_of(channel, kept.model if kept else usual_model(channel, arm), arm)
        for channel, kept in zip(wanted, newest, strict=True)
    )
    return begun or subjects_of(material, None, arm)


def _check_new(parent: KeptRevision | None, wish: Wish) -> None:
    """What the revision has already cannot be added once more."""
    there = [name for name in wish.effects if parent is not None and name in parent.effects]
    if parent is not None and there:
        raise InputError(
            f"revision {parent.number} has {', '.join(there)} already: go on from one without it "
            "(--from, see palpate revisions), or begin anew (--fresh)"
        )
