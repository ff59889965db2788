"""What is left over position and velocity, before and after."""

from html import escape
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from palpate.findings.story import Story
from palpate.report import pieces
from palpate.report.report import Report
from palpate.report.section import Section
from palpate.report.sections.waterfall import stage_name
from palpate.views.quantities import quantities_of
from palpate.views.residual_grid import residual_grid

CELLS = 36
EMPTY = "#eceff2"  # where nothing was measured; white is no error
DIVERGING = [[0.0, "#2a6fb0"], [0.25, "#a9c6e3"], [0.5, "#ffffff"], [0.75, "#e8b27a"], [1.0, "#c4453a"]]


class ResidualMapSection(Section):
    """Where the model fails."""

    name: ClassVar[str] = "residual_map"
    title: ClassVar[str] = "Where the model fails"
    place: ClassVar[int] = 40

    def html(self, report: Report) -> str:
        """See `Section.html`."""
        return "".join(
            pieces.channel_heading(report, story) + _words(story) + pieces.plot(_map(story)) + _parts(story)
            for story in report.stories
            if story.stages
        )


def _words(story: Story) -> str:
    words = story.comparison.words if story.comparison is not None else ()
    meaning = "Mean of measured − model in each cell; both maps have the same colours."
    return "".join(f"<p>{escape(text)}</p>" for text in words) + f"<p class='quiet'>{meaning}</p>"


def _map(story: Story) -> go.Figure:
    data, names = story.subject.channel, quantities_of(story.subject.channel)
    stages = [story.stages[0], *story.stages[1:][-1:]]
    titles = [stage_name(stage) if not stage.added else f"with {escape(stage.added)}" for stage in stages]
    shown = pieces.grid(380, 1, len(stages), shared_yaxes=True, subplot_titles=titles)
    shown.update_layout(plot_bgcolor=EMPTY, margin={"t": 56})
    grids = [residual_grid(data, stage.residual, CELLS) for stage in stages]
    reach = float(np.nanmax(np.abs(grids[0].mean)))
    for column, grid in enumerate(grids, start=1):
        shown.add_trace(
            go.Heatmap(
                x=pieces.rounded(names.scale * grid.position),
                y=pieces.rounded(names.scale * grid.velocity),
                z=[pieces.rounded(row) for row in grid.mean],
                zmin=-reach,
                zmax=reach,
                colorscale=DIVERGING,
                showscale=column == len(grids),
                colorbar={"title": {"text": names.effort_unit}, "thickness": 12, "outlinewidth": 0},
                hovertemplate=names.position
                + " %{x}<br>"
                + names.velocity
                + " %{y}<br>%{z:.3g} "
                + names.effort_unit
                + "<extra></extra>",
            ),
            1,
            column,
        )
        shown.update_xaxes(title={"text": names.position}, row=1, col=column)
    shown.update_yaxes(title={"text": names.velocity}, row=1, col=1)
    shown.update_xaxes(showgrid=False, zeroline=False)
    shown.update_yaxes(showgrid=False, zeroline=False)
    return shown


def _parts(story: Story) -> str:
    if story.comparison is None:
        return ""
    unit = story.comparison.effort_unit
    rows = [
        [
            by if number == 0 else "",
            escape(part.label),
            f"{part.rmse:.3g}",
            f"{part.mean:+.2g}",
            f"{part.excess:.1f}",
        ]
        for by, parts in story.comparison.parts.items()
        for number, part in enumerate(parts)
    ]
    columns = ["base model, by", "", f"rmse [{unit}]", f"mean [{unit}]", "× floor"]
    table = pieces.table(columns, rows, (2, 3, 4))
    return f"<details><summary>The base model's error, part by part</summary>{table}</details>"
