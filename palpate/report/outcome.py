"""Writes what can be looked at afterwards: result, report, picture and recording."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from palpate import console
from palpate.files import write_text
from palpate.findings.estimation_run import Material
from palpate.findings.story import Story
from palpate.report import Report, write_report
from palpate.words import count

REPORT = "report.html"
RECORDING = "revisions.rrd"
NAMES = (REPORT, "waterfall.png", "waterfall-*.png", RECORDING)  # of what `write_outcome` may write


def write_outcome(
    folder: Path, material: Material, stories: Sequence[Story], commands: Sequence[str]
) -> dict[str, Path]:
    """Write report, waterfalls and recording; the latter two only where effects were added.

    Args:
        folder: where to; it is there already.
        material: what was measured.
        stories: one for each channel.
        commands: that lead to the same outcome.

    Returns:
        The files, by what they are.

    Raises:
        InputError: a file cannot be written.
    """
    report = Report(material.path.name, _facts(material, stories), tuple(stories), tuple(commands))
    written = {"report": write_report(report, folder / REPORT)}
    grown = [story for story in stories if len(story.stages) > 1]
    return written | _pictures(folder, material.path.stem, grown) if grown else written


def _pictures(folder: Path, name: str, grown: Sequence[Story]) -> dict[str, Path]:
    # what draws takes longer to import than all else, and a verdict should not wait for it
    from palpate.views.plots.waterfall import save_waterfall  # noqa: PLC0415
    from palpate.views.recording.revisions import write_revisions  # noqa: PLC0415

    written: dict[str, Path] = {}
    for story in grown:
        channel = story.subject.channel
        what = "waterfall" if len(grown) == 1 else f"waterfall-{channel.name}"
        written[what] = folder / f"{what}.png"
        save_waterfall(channel.name, channel.kind.effort_unit, story.stages, written[what])
    written["recording"] = folder / RECORDING
    write_revisions(name, grown, written["recording"])
    return written


def write_json(data: Mapping[str, object], path: Path) -> Path:
    """Write plain data; returns the path.

    Raises:
        InputError: it cannot be written.
    """
    text = json.dumps(console.plain(data), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")
    return path


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
