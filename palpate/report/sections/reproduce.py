"""How to come to the same result again."""

from html import escape
from typing import ClassVar

from palpate.report.report import Report
from palpate.report.section import Section


class ReproduceSection(Section):
    """How to reproduce."""

    name: ClassVar[str] = "reproduce"
    title: ClassVar[str] = "How to reproduce"
    place: ClassVar[int] = 90

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        commands = escape("\n".join(report.commands))
        remark = (
            "The same file, version and commands give the same numbers: all random choices have fixed seeds."
        )
        return f"<pre>{commands}</pre><p class='quiet'>{remark}</p>"
