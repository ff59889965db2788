"""The answer, in one sentence for each channel."""

from html import escape
from typing import ClassVar

from rich.text import Text

from estimation.diagnosis.result import Accepted
from palpate.findings.story import Story
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.text import diagnosis as diagnosis_text
from palpate.text.comparison import headline
from palpate.text.diagnosis import force_remark
from palpate.text.stages import fall_sentence


class VerdictSection(Section):
    """What is missing, and what to do about it."""

    name: ClassVar[str] = "verdict"
    title: ClassVar[str] = "Verdict"
    place: ClassVar[int] = 10

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join((_diagnosed(story) or _compared(story)) + _left_out(story) for story in report.stories)


def _diagnosed(story: Story) -> str:
    found = story.diagnosis
    if found is None:
        return ""
    sentence = _plain(diagnosis_text.sentence(found))
    told = [f"<p><span class='tag'>{found.verdict.upper()}</span> &nbsp;{sentence}</p>"]
    told += [
        f"<p class='quiet'><b>{escape(entry.effect)}</b>: {escape(entry.physics)} "
        f"Signature: {escape(entry.signature)}.{_rivals(entry)}</p>"
        for entry in found.accepted
    ]
    told += [f"<p class='quiet'>{escape(text)}</p>" for text in diagnosis_text.remarks(found)]
    if story.added and not story.adds_what_was_found:
        told.append(f"<p>Added since: {_plain(fall_sentence(story))}</p>")
    return f"<div class='verdict {found.verdict}'>{''.join(told)}</div>"


def _compared(story: Story) -> str:
    if story.comparison is None:
        return ""
    last = story.grown or story.comparison
    words = [*last.words, force_remark(story.subject.force_ahead_of)]
    told = [f"<p>{_plain(headline(last))}</p>"]
    if story.added:
        told.append(f"<p>{_plain(fall_sentence(story))}</p>")
    told += [f"<p class='quiet'>{escape(text)}</p>" for text in words if text]
    return f"<div class='verdict'>{''.join(told)}</div>"


def _left_out(story: Story) -> str:
    return f"<p class='quiet'>{escape(story.left_out)}</p>" if story.left_out else ""


def _rivals(entry: Accepted) -> str:
    rivals, told_by = ", ".join(entry.confused_with), ", ".join(entry.told_by)
    told = f" Told by {escape(told_by)}." if told_by else ""
    return f"{told} This data cannot tell it from {escape(rivals)}." if rivals else told


def _plain(markup: str) -> str:
    return escape(Text.from_markup(markup).plain)
