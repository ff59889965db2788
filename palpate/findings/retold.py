"""All that is known of the channels of a file, where one of them has grown."""

from dataclasses import replace

from palpate.findings.effect_library import EffectLibrary
from palpate.findings.estimation_run import Arm, Material
from palpate.findings.kept_diagnosis import KeptDiagnosis
from palpate.findings.revisions import KeptRevision, RevisionShelf
from palpate.findings.story import Story, tell_story
from palpate.findings.subject import subject_of
from robot_io.errors import InputError


def retold(  # noqa: PLR0917, where what is known lies
    grown: Story,
    material: Material,
    arm: Arm,
    shelf: RevisionShelf,
    library: EffectLibrary,
    kept: KeptDiagnosis,
) -> list[Story]:
    """The story that grew among those of all other channels that were diagnosed, each at its newest revision.

    Args:
        grown: of the channel to which something was added.
        material: the data.
        arm: what its channels belong to.
        shelf: the revisions.
        library: where effects are found.
        kept: the diagnosis.
    """
    name = grown.subject.channel.name
    order = [*kept.found] if name in kept.found else [name, *kept.found]
    told = (grown if other == name else _of(other, material, arm, shelf, library, kept) for other in order)
    return [story for story in told if story is not None]


def _of(  # noqa: PLR0917, as `retold`
    name: str,
    material: Material,
    arm: Arm,
    shelf: RevisionShelf,
    library: EffectLibrary,
    kept: KeptDiagnosis,
) -> Story | None:
    """What is known of another channel; None where the diagnosis was about other data than these."""
    channel = next((one for one in material.channels if one.name == name), None)
    newest = shelf.latest(name)
    if channel is None or (model := newest.model if newest else kept.model_of(channel.kind)) is None:
        return None
    subject = kept.as_judged(subject_of(channel, model, arm))
    added, left_out = _added(newest, library)
    try:
        story = tell_story(subject, None, added, library.effects, kept)
    except InputError:  # it cannot be judged, as the diagnosis said then
        found = kept.found[name]
        return Story(subject, found, None, ()) if found.baseline is None else None
    story = replace(story, left_out=left_out)
    return story if story.diagnosis is not None or story.added or left_out else None


def _added(newest: KeptRevision | None, library: EffectLibrary) -> tuple[list[str], str]:
    """Effects of a channel's newest revision; none, and why, where one of the user's was not given now."""
    if newest is None:
        return [], ""
    try:
        library.check_own(newest)
        return [library.get(name).name for name in newest.effects], ""
    except InputError as error:
        return [], f"{newest.channel} is told without what was added to it: {error}"
