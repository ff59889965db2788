"""The view of stories, as long as commands tell stories and no study."""

from collections.abc import Mapping, Sequence

from palpate.findings.story import Story
from palpate.render.build import channel_view
from palpate.render.view import ChannelView, StudyView


def story_view(story: Story, numbers: Sequence[int | None] = ()) -> ChannelView:
    """One channel; `numbers` are those of the kept revisions."""
    compared = story.grown or story.comparison
    floors = [stage.noise_floor for stage in story.stages[-1:]]
    floors += [story.diagnosis.noise_floor or float("nan")] if story.diagnosis is not None else []
    return channel_view(
        story.subject.channel,
        story.stages,
        [f"+ {stage.added}" if stage.added else stage.model.name for stage in story.stages],
        floors[0] if floors else float("nan"),
        parts=compared.parts if compared is not None else None,
        words=compared.words[1:] if compared is not None else (),
        diagnosis=story.diagnosis,
        numbers=numbers,
        notes=(story.left_out,) if story.left_out else (),
    )


def study_view(
    file: str, stories: Sequence[Story], facts: Mapping[str, str] | None = None, commands: Sequence[str] = ()
) -> StudyView:
    """All channels."""
    return StudyView(file, tuple(map(story_view, stories)), facts or {}, tuple(commands))
