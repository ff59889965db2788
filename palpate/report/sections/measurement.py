"""Model and measurement over time, with what is left."""

from html import escape
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from palpate.findings.story import Story
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.report.sections.waterfall import stage_name
from palpate.views import style
from palpate.views.quantities import quantities_of
from palpate.views.time_axis import one_after_the_other
from robot_io.types import FloatArray


class MeasurementSection(Section):
    """Model and measurement."""

    name: ClassVar[str] = "measurement"
    title: ClassVar[str] = "Model and measurement"
    place: ClassVar[int] = 30

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(
            pieces.channel_heading(report, story) + _channel(story)
            for story in report.stories
            if story.stages
        )


def _channel(story: Story) -> str:
    data, names = story.subject.channel, quantities_of(story.subject.channel)
    shown = pieces.grid(520, 2, 1, shared_xaxes=True, row_heights=[0.62, 0.38], vertical_spacing=0.05)
    time_s = one_after_the_other(data)
    rows = pieces.thinned(np.arange(len(data)))
    base, last = story.stages[0], story.stages[-1]

    def curve(values: FloatArray, name: str, color: str, row: int, **look: object) -> None:
        shown.add_trace(
            go.Scatter(
                x=pieces.rounded(time_s[rows]),
                y=pieces.rounded(values[rows]),
                name=name,
                line={"color": color, "width": 1.3, **look},
                legendgroup=name,
                showlegend=row == 1,
                hovertemplate="%{x:.3f} s: %{y:.4g} " + names.effort_unit,
            ),
            row,
            1,
        )

    before, after = f"base model: {stage_name(base)}", f"with {escape(last.added)}"
    curve(data.effort, "measured", style.MEASURED, 1)
    curve(base.predicted, before, "#9aa5b1", 1, dash="dot")
    curve(base.residual, before, "#9aa5b1", 2)
    if last is not base:
        curve(last.predicted, after, style.TRUTH, 1, dash="dash")
        curve(last.residual, after, style.TRUTH, 2)
    _axes(shown, names.effort, f"measured − model [{names.effort_unit}]")
    return pieces.plot(shown)


def _axes(shown: go.Figure, effort: str, residual: str) -> None:
    shown.update_xaxes(title={"text": "time, runs behind each other [s]"}, row=2, col=1)
    shown.update_yaxes(title={"text": effort}, row=1, col=1)
    shown.update_yaxes(title={"text": residual}, row=2, col=1)
