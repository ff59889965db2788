"""Adds effects to what a model has already, and keeps each stage."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.findings.effect_library import EffectLibrary
from palpate.findings.estimation_run import Arm, Material
from palpate.findings.revisions import KeptRevision, RevisionShelf
from palpate.findings.story import Story, channel_for, tell_story
from palpate.findings.subject import Subject, only_channel, subjects_of
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
        start: revision to continue; None for the newest.
        fresh: begin with the base model again.
    """

    effects: Sequence[str]
    model: str | None = None
    channel: str | None = None
    start: int | None = None
    fresh: bool = False


def grow(material: Material, arm: Arm, shelf: RevisionShelf, library: EffectLibrary, wish: Wish) -> Growth:
    """Add effects, refitting everything at each stage.

    Raises:
        InputError: a name is unknown, an effect is there already or does not apply, or options contradict.
    """
    start = shelf.get(wish.start) if wish.start is not None else None
    subject = _subject(material, arm, library, wish, start)
    parent = start
    if parent is None and not wish.fresh:
        parent = shelf.latest(subject.channel.name, subject.model.name)
    before = [] if parent is None else parent.effects
    _check_own(parent, library)
    library.rehearse([subject.channel])
    story = tell_story(subject, None, [*before, *wish.effects], library.effects)
    unit = subject.channel.kind.effort_unit
    kept = shelf.keep(subject.channel.name, unit, story.stages, parent=parent, user_effects=library.own)
    return Growth(story, parent, kept)


def _subject(
    material: Material, arm: Arm, library: EffectLibrary, wish: Wish, start: KeptRevision | None
) -> Subject:
    """The channel in question with its base model."""
    if start is None:
        chosen = [library.get(name) for name in wish.effects]
        return channel_for(only_channel(subjects_of(material, wish.model, arm), wish.channel), chosen)
    contradictions = {"--fresh": wish.fresh, "--model": wish.model, "--channel": wish.channel}
    given = [option for option, value in contradictions.items() if value]
    if given:
        raise InputError(f"--from {start.number} says channel and model already: leave out {given[0]}")
    return only_channel(subjects_of(material, start.model, arm), start.channel)[0]


def _check_own(parent: KeptRevision | None, library: EffectLibrary) -> None:
    """A revision names the user's effects, but their code is run only when the user says so now."""
    if parent is None:
        return
    for text in parent.user_effects:
        if text not in library.own.values():
            raise InputError(f"revision {parent.number} has an effect of your own: add --effect {text}")
