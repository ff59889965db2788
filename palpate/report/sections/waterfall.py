"""The error in held-out runs, stage by stage down to the noise floor."""

from html import escape
from typing import ClassVar

import plotly.graph_objects as go

from estimation.revision import Revision
from palpate.findings.story import Story
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.views import style


class WaterfallSection(Section):
    """How the error falls."""

    name: ClassVar[str] = "waterfall"
    title: ClassVar[str] = "How the error falls"
    place: ClassVar[int] = 20

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(_channel(report, story) for story in report.stories if story.stages)


def _channel(report: Report, story: Story) -> str:
    unit = story.subject.channel.kind.effort_unit
    stages, floor = story.stages, story.stages[-1].noise_floor
    shown = pieces.figure(90 + 46 * (len(stages) + 1), showlegend=False, bargap=0.35)
    names = [stage_name(stage) for stage in stages]
    colors = [style.COMMANDED, *[style.MEASURED] * (len(stages) - 1)]
    errors = [stage.rmse for stage in stages]
    shown.add_trace(
        go.Bar(
            x=errors,
            y=names,
            orientation="h",
            marker={"color": colors},
            text=[f"{error:.3g} {unit}" for error in errors],
            textposition="outside",
            cliponaxis=False,
            hovertemplate="%{y}: %{x:.4g} " + unit + "<extra></extra>",
        )
    )
    shown.add_vline(
        x=floor,
        line={"color": style.TRUTH, "width": 1.5, "dash": "dot"},
        annotation={"text": f"noise floor {floor:.3g} {unit}", "font": {"color": style.TRUTH}},
        annotation_position="bottom right" if floor < 0.6 * max(errors) else "bottom left",
    )
    # room below the last bar for the word at the floor: above, it would lie under the toolbar
    shown.update_yaxes(range=[len(stages) + 0.1, -0.6], showgrid=False, ticks="")
    shown.update_xaxes(title={"text": f"error in held-out runs [{unit}]"}, range=[0, 1.18 * max(errors)])
    remark = "Each stage is fitted anew and judged on runs that the fit has not seen."
    return pieces.channel_heading(report, story) + f"<p class='quiet'>{remark}</p>" + pieces.plot(shown)


def stage_name(stage: Revision) -> str:
    """The base model, or the effect that was added."""
    return f"+ {escape(stage.added)}" if stage.added else escape(stage.model.name)
