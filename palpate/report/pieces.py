"""Pieces of HTML that several sections use."""

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from palpate.findings.story import Story
from palpate.report.report import Report
from palpate.views import style
from robot_io.types import FloatArray, IntArray

MOST_POINTS = 6000  # in one curve; a browser stays quick
CONFIG = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}


def channel_heading(report: Report, story: Story) -> str:
    """The channel's name, where there are several."""
    return f"<h3>{escape(story.subject.channel.name)}</h3>" if len(report.stories) > 1 else ""


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table; cells are HTML already.

    Args:
        columns: headlines.
        rows: cells.
        numbers: which columns stand to the right.
    """
    look = ['class="number"' if i in numbers else "" for i in range(len(columns))]
    head = "".join(f"<th {how}>{name}</th>" for how, name in zip(look, columns, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td {how}>{cell}</td>" for how, cell in zip(look, row, strict=True)) + "</tr>"
        for row in rows
    )
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def figure(height: int, **layout: object) -> go.Figure:
    """An empty figure in the house style."""
    made = go.Figure()
    made.update_layout(
        template="none",
        paper_bgcolor="white",
        plot_bgcolor="white",
        height=height,
        margin={"l": 64, "r": 16, "t": 34, "b": 48},
        font={"family": "Inter, Liberation Sans, Arial, sans-serif", "size": 12.5, "color": style.INK},
        legend={"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"},
        hoverlabel={"bgcolor": "white"},
        **layout,
    )
    return with_axes(made)


def with_axes(made: go.Figure) -> go.Figure:
    """The figure with light rules on all of its axes."""
    axis = {"gridcolor": style.RULE, "zerolinecolor": "#aeb8c2", "linecolor": "#aeb8c2", "automargin": True}
    made.update_xaxes(**axis)
    made.update_yaxes(**axis)
    return made


def grid(height: int, rows: int, columns: int, **how: Any) -> go.Figure:  # noqa: ANN401, as plotly's own
    """Several plots side by side or above each other; see `plotly.subplots.make_subplots`."""
    made = go.Figure(make_subplots(rows, columns, **how))
    places = {axis: made.layout[axis] for axis in made.layout if "axis" in axis}
    made.update_layout(figure(height).layout)
    made.update_layout(places)
    return with_axes(made)


def plot(made: go.Figure) -> str:
    """The figure as a part of the page; the page brings plotly.js once."""
    html: str = made.to_html(full_html=False, include_plotlyjs=False, config=CONFIG)
    return f'<div class="plot">{html}</div>'


def thinned(rows: IntArray, most: int = MOST_POINTS) -> IntArray:
    """Evenly chosen rows, `most` of them or all."""
    if len(rows) <= most:
        return rows
    chosen: IntArray = rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]
    return chosen


def rounded(values: FloatArray, digits: int = 5) -> list[float]:
    """Values with so many significant digits of the largest, which keeps the file small."""
    largest = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    decimals = digits - int(np.floor(np.log10(largest)))
    return [None if not np.isfinite(v) else round(v, max(decimals, 0)) for v in values.tolist()]  # type: ignore[misc]
