"""Parameters of the final model, with intervals."""

from html import escape
from typing import ClassVar

import numpy as np

from estimation.revision import Revision
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.words import significant

SIGMAS_95 = 1.96


class ParametersSection(Section):
    """Parameters."""

    name: ClassVar[str] = "parameters"
    title: ClassVar[str] = "Parameters"
    place: ClassVar[int] = 50

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(
            pieces.channel_heading(report, story) + _table(story.stages[-1])
            for story in report.stories
            if story.stages
        )


def _table(stage: Revision) -> str:
    rows = []
    for name, found in stage.parameters.items():
        half = SIGMAS_95 * found.std_err
        known = bool(np.isfinite(half))
        value = significant(found.value, half if known else None)
        interval = f"± {significant(half, half)}" if known else "not determined"
        effect, _, parameter = name.partition(".")
        rows.append([escape(effect), escape(parameter), value, interval, escape(found.unit)])
    if not rows:
        return "<p class='quiet'>The model has no free parameter.</p>"
    remark = "95 % intervals, which allow for correlated noise; all in SI units."
    columns = ["effect", "parameter", "value", "95 % interval", "unit"]
    return pieces.table(columns, rows, (2, 3)) + f"<p class='quiet'>{remark}</p>"
