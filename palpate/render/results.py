"""Everything that is written about a study: result, report and recording, all from the same view."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from estimation.study import ChannelResult, Study
from palpate.common import console
from palpate.common.files import whole_set
from palpate.render.build import view_of

REPORT = "report.html"
RECORDING = "revisions.rrd"
NAMES = (REPORT, RECORDING)  # of what `write_outcome` may write


def write_outcome(
    folder: Path,
    study: Study,
    results: Sequence[ChannelResult],
    commands: Sequence[str],
    texts: Mapping[str, str] | None = None,
) -> dict[str, Path]:
    """Write a report, and a recording of what was diagnosed or added; returns the files, by what they are.

    All files appear together, or none of them.

    Args:
        folder: where to; it is there already.
        study: what was measured.
        results: what is known about it.
        commands: that lead to the same outcome.
        texts: of further files, by name.

    Raises:
        InputError: a file cannot be written.
    """
    # what draws takes longer to import than all else, and a verdict should not wait for it
    from palpate.render.recording.revisions import record_rerun  # noqa: PLC0415
    from palpate.render.report import document  # noqa: PLC0415

    texts = {**(texts or {}), REPORT: document(view_of(study, results, commands))}
    grown = [result for result in results if result.added or _has_budget(result)]
    with whole_set({folder / name: text for name, text in texts.items()}):
        if grown:
            record_rerun(view_of(study, grown), folder / RECORDING)
    return {"report": folder / REPORT} | ({"recording": folder / RECORDING} if grown else {})


def _has_budget(result: ChannelResult) -> bool:
    return result.diagnosis is not None and result.diagnosis.rest is not None


def as_json(data: Mapping[str, object]) -> str:
    """Plain data as the text of a file."""
    return json.dumps(console.plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
