"""Views and files of stories, as long as commands tell stories and no study."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from estimation.channel import ChannelData
from estimation.comparison import Comparison
from estimation.diagnosis import ChannelDiagnosis
from palpate import console
from palpate.files import write_text
from palpate.findings.estimation_run import Material
from palpate.findings.story import Story
from palpate.render.build import channel_view
from palpate.render.report import write_report
from palpate.render.sentences import compared
from palpate.render.view import ChannelView, StudyView
from palpate.words import count

REPORT, RECORDING = "report.html", "revisions.rrd"
NAMES = (REPORT, RECORDING)  # of what `write_outcome` may write


def story_view(story: Story, numbers: Sequence[int | None] = ()) -> ChannelView:
    """One channel; `numbers` are those of the kept revisions."""
    last = story.grown or story.comparison
    floors = [stage.noise_floor for stage in story.stages[-1:]]
    floors += [story.diagnosis.noise_floor or float("nan")] if story.diagnosis is not None else []
    return channel_view(
        story.subject.channel,
        story.stages,
        [f"+ {stage.added}" if stage.added else stage.model.name for stage in story.stages],
        floors[0] if floors else float("nan"),
        parts=last.parts if last is not None else None,
        words=last.words[1:] if last is not None else (),
        diagnosis=story.diagnosis,
        numbers=numbers,
        notes=(story.left_out,) if story.left_out else (),
    )


def diagnosis_view(data: ChannelData, found: ChannelDiagnosis) -> ChannelView:
    """A diagnosis whose stages were not refitted."""
    return channel_view(data, (), (), found.noise_floor or float("nan"), diagnosis=found)


def comparison_view(data: ChannelData, found: Comparison, notes: Sequence[str] = ()) -> ChannelView:
    """A comparison without the stages before it."""
    verdict = compared(data.name, found.model, found.rmse, found.floor.value, found.effort_unit)
    stage = _Stage(found)
    return channel_view(
        data,
        [stage],
        [found.model],
        found.floor.value,
        parts=found.parts,
        words=found.words[1:] if verdict.word == "misses" else (),
        notes=notes,
    )


class _Stage:
    """A comparison as a stage without a model that could be written out."""

    def __init__(self, found: Comparison) -> None:
        self.predicted, self.residual, self.rmse = found.predicted, found.residual, found.rmse
        self.parameters: dict[str, Any] = {}
        self.model: Any = type("Nothing", (), {"effects": ()})


def write_outcome(
    folder: Path, material: Material, stories: Sequence[Story], commands: Sequence[str]
) -> dict[str, Path]:
    """Write report, and recording where effects were added; returns the files by what they are.

    Raises:
        InputError: a file cannot be written.
    """
    view = StudyView(
        material.path.name, tuple(map(story_view, stories)), _facts(material, stories), tuple(commands)
    )
    written = {"report": write_report(view, folder / REPORT)}
    if any(len(channel.stages) > 1 for channel in view.channels):
        from palpate.render.recording.revisions import record_rerun  # noqa: PLC0415, takes long to import

        written["recording"] = folder / RECORDING
        record_rerun(view, written["recording"])
    return written


def write_json(data: Mapping[str, object], path: Path) -> Path:
    """Write plain data; returns the path.

    Raises:
        InputError: it cannot be written.
    """
    text = json.dumps(console.plain(data), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")
    return path


def as_data(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain data; the keys are stable."""
    return {
        "channel": comparison.channel,
        "model": comparison.model,
        "effort_unit": comparison.effort_unit,
        "rmse": comparison.rmse,
        "noise_floor": comparison.floor.value,
        "floor": vars(comparison.floor),
        "lack_of_fit": comparison.lack_of_fit,
        "parameters": dict(comparison.parameters),
        "parts": {by: [vars(part) for part in parts] for by, parts in comparison.parts.items()},
        "words": list(comparison.words),
    }


def _facts(material: Material, stories: Sequence[Story]) -> dict[str, str]:
    channels = [story.subject.channel for story in stories]
    facts = {
        "channels": ", ".join(channel.name for channel in channels),
        "data": f"{count(len(channels[0].runs), 'run')}, {count(len(channels[0]), 'sample')}",
        "base model": ", ".join(dict.fromkeys(story.subject.model.name for story in stories)),
    }
    if material.session is not None:
        metadata = material.session.metadata
        facts |= {"recorded": metadata.created_utc, "by": metadata.command_line}
    return {name: value for name, value in facts.items() if value}
