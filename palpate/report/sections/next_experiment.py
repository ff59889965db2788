"""What to record next."""

from html import escape
from typing import ClassVar

import yaml

from estimation.diagnosis import Verdict
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section


class NextExperimentSection(Section):
    """The next experiment."""

    name: ClassVar[str] = "next_experiment"
    title: ClassVar[str] = "Next experiment"
    place: ClassVar[int] = 70

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        told = ""
        for story in report.stories:
            found = story.diagnosis
            if found is None or found.next_experiment is None or found.verdict is Verdict.ADEQUATE:
                continue
            plan = found.next_experiment
            told += pieces.channel_heading(report, story)
            told += f"<p>{escape(plan.instruction)}, to {escape(plan.purpose)}.</p>"
            if plan.probe:
                told += f"<pre>{escape(yaml.safe_dump(dict(plan.probe), sort_keys=False))}</pre>"
        return told
