"""The answer, in one sentence for each channel."""

from html import escape
from typing import ClassVar

from rich.text import Text

from palpate.findings.story import Story
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.text import diagnosis as diagnosis_text
from palpate.text.comparison import headline


class VerdictSection(Section):
    """What is missing, and what to do about it."""

    name: ClassVar[str] = "verdict"
    title: ClassVar[str] = "Verdict"
    place: ClassVar[int] = 10

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(_diagnosed(story) or _compared(story) for story in report.stories)


def _diagnosed(story: Story) -> str:
    found = story.diagnosis
    if found is None:
        return ""
    sentence = _plain(diagnosis_text.sentence(found))
    told = [f"<p><span class='tag'>{found.verdict.upper()}</span> &nbsp;{sentence}</p>"]
    told += [
        f"<p class='quiet'><b>{escape(entry.effect)}</b>: {escape(entry.physics)} "
        f"Seen as: {escape(entry.signature)}.{_rivals(entry.confused_with)}</p>"
        for entry in found.accepted
    ]
    told += [f"<p class='quiet'>{escape(text)}</p>" for text in diagnosis_text.evidence_against(found)]
    return f"<div class='verdict {found.verdict}'>{''.join(told)}</div>"


def _compared(story: Story) -> str:
    if story.comparison is None:
        return ""
    words = "".join(f"<p class='quiet'>{escape(text)}</p>" for text in story.comparison.words)
    return f"<div class='verdict'><p>{_plain(headline(story.comparison))}</p>{words}</div>"


def _rivals(names: list[str]) -> str:
    return f" This data cannot tell it from {escape(', '.join(names))}." if names else ""


def _plain(markup: str) -> str:
    return escape(Text.from_markup(markup).plain)
