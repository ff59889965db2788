"""Everything that is written about a study: result, report and recording, all from the same view."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from estimation.study import ChannelResult, Study
from palpate import console
from palpate.files import write_text
from palpate.study_view import view_of

REPORT = "report.html"
RECORDING = "revisions.rrd"
NAMES = (REPORT, RECORDING)  # of what `write_outcome` may write


def write_outcome(
    folder: Path, study: Study, results: Sequence[ChannelResult], commands: Sequence[str]
) -> dict[str, Path]:
    """Write a report, and where effects were added a recording; returns the files, by what they are.

    Args:
        folder: where to; it is there already.
        study: what was measured.
        results: what is known about it.
        commands: that lead to the same outcome.

    Raises:
        InputError: a file cannot be written.
    """
    # what draws takes longer to import than all else, and a verdict should not wait for it
    from palpate.render.recording.revisions import record_rerun  # noqa: PLC0415
    from palpate.render.report import write_report  # noqa: PLC0415

    view = view_of(study, results, commands)
    written = {"report": write_report(view, folder / REPORT)}
    grown = [result for result in results if result.added]
    if grown:
        written["recording"] = folder / RECORDING
        record_rerun(view_of(study, grown), written["recording"])
    return written


def write_json(data: Mapping[str, object], path: Path) -> Path:
    """Write plain data; returns the path.

    Raises:
        InputError: it cannot be written.
    """
    text = json.dumps(console.plain(data), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")
    return path
