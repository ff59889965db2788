"""All candidates beside the base model, and what stands against chance."""

from html import escape
from typing import ClassVar

from estimation.diagnosis import ChannelDiagnosis, Verdict
from palpate.findings.story import Story
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.words import chance

MOST = 8


class EvidenceSection(Section):
    """What speaks for the verdict."""

    name: ClassVar[str] = "evidence"
    title: ClassVar[str] = "Evidence"
    place: ClassVar[int] = 25

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(
            pieces.channel_heading(report, story) + _channel(story, story.diagnosis)
            for story in report.stories
            if story.diagnosis is not None and _tells(story.diagnosis)
        )


def _tells(found: ChannelDiagnosis) -> bool:
    """Where nothing is missing, no candidate lowers the error, and a ranking of nothing tells nothing."""
    return bool(found.ranking) and found.verdict is not Verdict.ADEQUATE


def _channel(story: Story, found: ChannelDiagnosis) -> str:
    unit = found.effort_unit
    accepted = [
        [
            escape(entry.effect),
            f"{entry.rmse_before:.4g}",
            f"{entry.rmse_after:.4g}",
            chance(entry.p_value),
            escape(", ".join(entry.confused_with)) or "&ndash;",
        ]
        for entry in found.accepted
    ]
    columns = ["accepted", f"before [{unit}]", f"after [{unit}]", "p", "not to be told from"]
    first = pieces.table(columns, accepted, (1, 2, 3)) if accepted else ""
    ranked = [
        [escape(entry.effect), f"{entry.rmse_held_out:.4g}", f"{100 * entry.score:z.1f} %"]
        for entry in found.ranking[:MOST]
    ]
    alone = ["alone beside the base model", f"held-out error [{unit}]", "error falls by"]
    meaning = (
        "p: how often the best of all candidates does as well on noise of the measured kind alone. "
        f"{len(found.ranking)} effects were possible; the best are shown."
    )
    return first + pieces.table(alone, ranked, (1, 2)) + f"<p class='quiet'>{meaning}</p>"
