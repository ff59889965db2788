"""Plotly figures of a view, and the HTML report in one file that needs no network."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from palpate.common.console import format_p_value
from palpate.estimation.estimate import rounded, with_unit
from palpate.estimation.signals.blocks import blocks
from palpate.render import palette
from palpate.render.diagnosis import budget_svg
from palpate.render.terminal import with_interval
from palpate.render.thinning import join_curves, rows_by_run, run_curves
from palpate.render.view import RANGE_MEANING, ChannelView, StageView, StudyView, residual_map
from palpate.robot_io.types import FloatArray

_HERE = Path(__file__).parent
_STYLE = _HERE / "report.css"


def rendered(template: Path, filters: Mapping[str, Callable[..., Any]], **values: object) -> str:
    """Render a template with values; every template also gets `style`, `version` and `plotly`.

    A template extends base.html, which requires a `title` and `facts`.
    """
    environment = _environment(template.parent)
    environment.filters |= filters
    style = Markup(_STYLE.read_text(encoding="utf-8"))  # noqa: S704, our own
    plotly = Markup(get_plotlyjs())  # noqa: S704, plotly's own
    common = {"style": style, "version": version("palpate"), "plotly": plotly}
    return environment.get_template(template.name).render(**values, **common)


@cache
def _environment(folder: Path) -> Environment:
    """Return the environment of a folder's templates, which are compiled once."""
    return Environment(
        loader=FileSystemLoader([folder, _HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


PLOT_CONFIG = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}
_RULE, _ZERO = "rgba(128,140,155,0.22)", "rgba(128,140,155,0.6)"
_SHADE_CELLS = 300  # number of intervals of the time axis, each shaded or not
_BAR_PX = 40
_CHARACTER_PX = 7.5
RUN_TIME = "time, runs one after the other [s]"
Place = tuple[int, int]  # row and column of a subplot
Curve = tuple[FloatArray, FloatArray]
_BRIGHT = 0.98  # quantile of a map's cells at which its colors saturate


@dataclass(frozen=True)
class PlotStyle:
    """Style of a curve, and its name in the legend."""

    name: str
    color: str
    dash: str = "solid"
    width: float = 1.3
    opacity: float = 1.0
    named: bool = True  # whether the legend shows the name
    shown: bool = True  # whether it is visible before a click on its name in the legend


def figure(channel: ChannelView) -> go.Figure:
    """Draw everything about one channel in one figure, for a notebook.

    Args:
        channel: channel with its stages.
    """
    specs = [[{}, {}], [{"colspan": 2}, None], [{"colspan": 2}, None]]
    titles = ("Error in held-out runs", "Over position", "Over time", "")
    made = make_subplots(
        3, 2, specs=specs, subplot_titles=titles, row_heights=[0.36, 0.36, 0.28], vertical_spacing=0.14
    )
    _draw_error_steps(made, channel)
    one_color = replace(channel, speeds={})  # the legend is that of the curves over time
    _draw_state(made, one_color, (1, 2), channel.position, channel.axes.position, named=False)
    _draw_time(made, channel, (2, 1))
    _draw_residuals(made, channel, (3, 1))
    made = styled(made, 800)
    return made.update_layout(margin_t=96, legend_y=1.06)  # above the titles of the first row


def error_steps_figure(channel: ChannelView) -> go.Figure:
    """Draw the held-out error stage by stage, down to the noise level."""
    made = make_subplots(1, 1)
    _draw_error_steps(made, channel)
    made = styled(made, 96 + _BAR_PX * (len(channel.error_steps) + 1))
    # The margin has room for the longest label, which a share of a narrow window's width would not have.
    room = _CHARACTER_PX * max(map(len, made.data[1].text))
    reach = max(channel.noise_level, *(error for _, error in channel.error_steps))
    made.update_xaxes(range=[0.0, reach], nticks=4, tickangle=0)
    return made.update_layout(margin_t=40, margin_r=room)  # there is no legend


def time_figure(channel: ChannelView) -> go.Figure:
    """Draw effort and models over time, and residuals below; gray marks samples excluded from scoring.

    Args:
        channel: channel with its stages.
    """
    if not channel.stages:
        made = make_subplots(1, 1)
        _draw_time(made, channel, (1, 1))
        return styled(made, 360)
    made = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.6, 0.4], vertical_spacing=0.06)
    _draw_time(made, channel, (1, 1))
    _draw_residuals(made, channel, (2, 1))
    return styled(made, 540)


def state_figure(channel: ChannelView) -> go.Figure:
    """Draw effort and models over position and velocity; intermediate stages are in the legend."""
    made = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.03)
    _draw_state(made, channel, (1, 1), channel.position, channel.axes.position)
    _draw_state(made, channel, (1, 2), channel.velocity, channel.axes.velocity, named=False)
    made.update_yaxes(title_text="", row=1, col=2)
    return styled(made, 424)


def map_figure(channel: ChannelView) -> go.Figure:
    """Draw mean residuals over position and velocity, of the base model and of the last stage."""
    stages, axes = channel.shown_stages, channel.axes
    titles = [_escaped(stage.name).replace(" + ", "<br>+ ") for stage in stages]  # beside each other
    made = make_subplots(
        1, max(len(stages), 1), shared_yaxes=True, horizontal_spacing=0.03, subplot_titles=titles
    )
    used = channel.engaged & channel.scored
    maps = [residual_map(channel.position, channel.velocity, stage.residual, used) for stage in stages]
    level = np.abs(np.concatenate([grid.mean.ravel() for grid in maps]))
    reach = float(np.quantile(level[np.isfinite(level)], _BRIGHT)) if np.isfinite(level).any() else 1.0
    title = {"text": axes.residual, "side": "right", "font": {"size": 12.5}}
    for column, grid in enumerate(maps, start=1):
        trace = go.Heatmap(
            x=_small(grid.position),
            y=_small(grid.velocity),
            z=_small(grid.mean),
            zmin=-reach,
            zmax=reach,
            colorscale=palette.RESIDUAL,
            showscale=column == len(maps),
            colorbar={"title": title, "thickness": 12},
            hovertemplate=f"{axes.position} %{{x:.3g}}<br>{axes.velocity} %{{y:.3g}}<br>"
            f"%{{z:.3g}} {axes.effort_unit}<extra></extra>",
        )
        made.add_trace(trace, 1, column)
        made.update_xaxes(title_text=axes.position, row=1, col=column)
    made.update_yaxes(title_text=axes.velocity, row=1, col=1)
    made.update_annotations(yshift=6)
    lines = 1 + max((title.count("<br>") for title in titles), default=0)
    styled(made, 368 + 16 * lines).update_layout(margin_t=48 + 16 * lines)
    made.update_xaxes(showgrid=False, zeroline=False)
    return made.update_yaxes(showgrid=False, zeroline=False)


def _draw_error_steps(made: go.Figure, channel: ChannelView) -> None:
    labels = [_escaped(label) for label, _ in channel.error_steps]
    errors = np.array([error for _, error in channel.error_steps])
    unit, reach = channel.axes.effort_unit, 1.35 * float(errors.max())  # space for the labels
    taken = np.maximum(np.concatenate([[0.0], errors[:-1] - errors[1:]]), 0.0)
    before = np.concatenate([errors[:1], errors[:-1]])
    falls = [
        f" {with_unit(error, unit)}" + (f"  −{100 * (1 - error / old):.0f} %" if old > error else "")
        for error, old in zip(errors, before, strict=True)
    ]
    colors = [palette.BASE, *[palette.MEASURED] * (len(errors) - 1)]
    bars = {"y": labels, "orientation": "h", "showlegend": False}
    shown = go.Bar(
        x=errors, marker_color=colors, hovertemplate=f"%{{y}}: %{{x:.4g}} {unit}<extra></extra>", **bars
    )
    removed = go.Bar(
        x=taken, marker_color=palette.SHADE, text=falls, textposition="outside", cliponaxis=False, **bars
    )
    removed.hoverinfo = "skip"
    made.add_traces([shown, removed], [1] * 2, [1] * 2)
    made.update_layout(barmode="stack", bargap=0.3)
    left = channel.noise_level < 0.6 * reach
    line = {"color": palette.NOISE, "width": 1.5, "dash": "dot"}
    words = f"{channel.noise_label} {with_unit(channel.noise_level, unit)}"
    note = {"text": words, "font_color": palette.NOISE, "xshift": 4 if left else -4}
    side = "bottom right" if left else "bottom left"
    look = {"line": line, "annotation": note, "annotation_position": side}
    made.add_vline(x=channel.noise_level, row=1, col=1, **look)
    # space below the last bar for the label of the noise level
    made.update_yaxes(range=[len(errors) + 0.1, -0.6], showgrid=False, row=1, col=1)
    made.update_xaxes(title_text=f"error in held-out runs [{unit}]", range=[0.0, reach], row=1, col=1)


def _draw_time(made: go.Figure, channel: ChannelView, place: Place) -> None:
    """Draw measured and commanded effort, and the first and the last model."""
    unit, runs = channel.axes.effort_unit, list(rows_by_run(channel.run).values())
    curves = [(channel.effort, PlotStyle("measured", palette.MEASURED, width=2.4))]
    if channel.commanded is not None:
        curves.append((channel.commanded[1], PlotStyle(channel.commanded[0], palette.TRUTH, "2px,2px")))
    curves += [(stage.predicted, _look_of(channel, stage)) for stage in channel.shown_stages]
    for values, look in curves:
        draw_curves(made, run_curves(channel.time_s, values, runs), place, unit, look)
    _shade(made, channel, place)
    title_axes(made, place, "" if channel.stages else RUN_TIME, channel.axes.effort)


def _draw_residuals(made: go.Figure, channel: ChannelView, place: Place) -> None:
    """Draw residuals of the first and the last model, with lines at plus and minus two noise levels."""
    unit, runs = channel.axes.effort_unit, list(rows_by_run(channel.run).values())
    for stage in channel.shown_stages:
        look = replace(_look_of(channel, stage), named=False)
        left = np.where(channel.scored, stage.residual, np.nan)
        draw_curves(made, run_curves(channel.time_s, left, runs), place, unit, look)
    _shade(made, channel, place)
    for level in (-2 * channel.noise_level, 2 * channel.noise_level):
        line = {"color": palette.NOISE, "width": 1, "dash": "dot"}
        made.add_hline(y=level, line=line, row=place[0], col=place[1])
    title_axes(made, place, RUN_TIME, channel.axes.residual)


def _look_of(channel: ChannelView, stage: StageView) -> PlotStyle:
    return PlotStyle(stage.name, palette.MODEL if stage is channel.stages[-1] else palette.BASE)


def _draw_state(
    made: go.Figure, channel: ChannelView, place: Place, x: FloatArray, title: str, *, named: bool = True
) -> None:
    runs = {run: rows[channel.engaged[rows]] for run, rows in rows_by_run(channel.run).items()}
    unit, words = channel.axes.effort_unit, list(dict.fromkeys(channel.speeds.values()))
    colors = palette.speed_colors(words) if 1 < len(words) <= len(palette.SPEEDS) else {"": palette.MEASURED}
    rows = {w: [rows for run, rows in runs.items() if not w or channel.speeds.get(run) == w] for w in colors}
    for word, color in colors.items():
        look = PlotStyle(f"measured, {word}" if word else "measured", color, width=2.4, named=named)
        look = replace(look, opacity=0.5 if word else 1.0)  # a model of the same color lies on top
        draw_curves(made, run_curves(x, channel.effort, rows[word]), place, unit, look)
    for stage in channel.stages:
        is_shown = any(stage is each for each in channel.shown_stages)
        look = replace(_look_of(channel, stage), named=named, shown=is_shown)
        if len(colors) > 1:  # colors are those of speeds; the legend shows the dash of the model in gray
            dash = "4px,2px" if stage is channel.stages[-1] else "1px,2px"
            look = replace(look, color=palette.BASE, dash=dash)
            draw_curves(made, [], place, unit, look)
        for word, color in colors.items():
            own = replace(look, color=color, named=False) if word else look
            draw_curves(made, run_curves(x, stage.predicted, rows[word]), place, unit, own)
    title_axes(made, place, title, channel.axes.effort)


def draw_curves(made: go.Figure, curves: Sequence[Curve], place: Place, unit: str, look: PlotStyle) -> None:
    """Draw curves of one style as one trace with gaps.

    Args:
        made: figure that is drawn into.
        curves: x (n,) and y (n,) of each curve.
        place: row and column of the subplot.
        unit: unit of y.
        look: color, dash, width and name.
    """
    x, y = join_curves(curves)
    trace = go.Scatter(
        x=_small(x),
        y=_small(y),
        name=_escaped(look.name),
        mode="lines",
        legendgroup=look.name,
        showlegend=look.named,
        visible=True if look.shown else "legendonly",
        opacity=look.opacity,
        line={"color": look.color, "width": look.width, "dash": look.dash},
        hovertemplate=f"%{{x:.4g}}: %{{y:.4g}} {unit}",
    )
    made.add_trace(trace, *place)


def _shade(made: go.Figure, channel: ChannelView, place: Place) -> None:
    """Shade intervals in which more than half of the samples are excluded from scoring."""
    edges = np.linspace(channel.time_s[0], channel.time_s[-1], _SHADE_CELLS + 1)
    every = np.histogram(channel.time_s, edges)[0]
    out = np.histogram(channel.time_s[~channel.scored], edges)[0] > 0.5 * np.maximum(every, 1)
    x, y = (axis.plotly_name.replace("axis", "") for axis in made.get_subplot(*place))
    look = {"type": "rect", "fillcolor": palette.SHADE, "line_width": 0, "layer": "below"}
    where = {"xref": x, "yref": f"{y} domain", "y0": 0, "y1": 1}
    spans = [
        {**look, **where, "x0": edges[cells.start], "x1": edges[cells.stop]}
        for cells in blocks(out)
        if out[cells.start]
    ]
    # at once, as add_vrect checks the whole figure each time
    made.layout.shapes = (*made.layout.shapes, *spans)


def title_axes(made: go.Figure, place: Place, x: str, y: str) -> None:
    """Set the titles of both axes of a subplot.

    Args:
        made: figure that is drawn into.
        place: row and column of the subplot.
        x: title of the horizontal axis.
        y: title of the vertical axis.
    """
    made.update_xaxes(title_text=x, row=place[0], col=place[1])
    made.update_yaxes(title_text=y, row=place[0], col=place[1])


def styled(made: go.Figure, height: int) -> go.Figure:
    """Apply the common style: thin rules, transparent background, colors for light and dark.

    Args:
        made: the figure.
        height: height [px].

    Returns:
        The same figure.
    """
    made.update_layout(
        template="none",
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        height=height,
        margin={"l": 64, "r": 16, "t": 64, "b": 48},  # the buttons are above the legend
        font={"family": palette.FONT, "size": 12.5},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": _ZERO, "activecolor": palette.MEASURED},
        legend={"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"},
    )
    made.update_annotations(font_size=12.5)
    axis = {"gridcolor": _RULE, "zerolinecolor": _ZERO, "linecolor": _ZERO, "automargin": True}
    axis |= {"ticks": "", "ticklabelstandoff": 4, "title_font_size": 12.5}
    made.update_xaxes(**axis)
    return made.update_yaxes(**axis)


def _escaped(text: str) -> str:
    """Escape text for plotly, which interprets some HTML tags."""
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _small(values: FloatArray) -> np.ndarray:
    return np.asarray(values, dtype=np.float32)


_TEMPLATE = Path(__file__).parent / "report.html"
_BUDGET_WIDTH = 940  # [px]
_GREEK = {"tau": "τ", "mu": "μ", "pi": "π", "alpha": "α", "beta": "β", "omega": "ω"}


def document(view: StudyView) -> str:
    """Return the HTML page.

    Args:
        view: all channels.
    """
    draw = {"fall": error_steps_figure, "map": map_figure, "time": time_figure, "state": state_figure}

    def plots(channel: ChannelView) -> dict[str, Markup]:
        """Return the channel's figures as HTML, by name; empty if there is nothing to draw."""
        is_drawn = dict.fromkeys(draw, bool(channel.stages)) | {"fall": bool(channel.error_steps)}
        is_drawn["time"] |= channel.commanded is not None
        return {name: as_html(draw[name](channel)) if is_drawn[name] else Markup() for name in draw}

    filters: dict[str, Callable[..., Any]] = {
        "bold": bold, "typeset": typeset, "interval": with_interval, "chance": format_p_value,
        "rounded": rounded,
        "picture": lambda budget: Markup(budget_svg(budget, _BUDGET_WIDTH)),  # noqa: S704, escaped
        "yaml": lambda data: yaml.safe_dump(dict(data), sort_keys=False),
    }  # fmt: skip
    shown = {"view": view, "facts": view.facts, "range_meaning": RANGE_MEANING, "plots": plots}
    return rendered(_TEMPLATE, filters, title=view.file, **shown)


def as_html(figure: go.Figure) -> Markup:
    """Return the HTML of a figure, for a page that includes plotly.js."""
    return Markup(figure.to_html(full_html=False, include_plotlyjs=False, config=PLOT_CONFIG))  # noqa: S704, ours


def bold(sentence: str, names: Iterable[str]) -> Markup:
    """Escape a sentence and set names in bold.

    Args:
        sentence: plain text.
        names: words that are set in bold.
    """
    text = escape(sentence)
    for name in dict.fromkeys(filter(None, names)):
        text = re.sub(rf"(?<![\w>]){re.escape(escape(name))}(?!\w)", f"<b>{escape(name)}</b>", text)
    return Markup(text)  # noqa: S704, escaped above


def typeset(equation: str) -> Markup:
    """Escape a formula; typeset powers, indices and Greek letters.

    Args:
        equation: plain text.
    """
    raised = re.sub(r"\^(\([^)]*\)|[\w.]+)", r"<sup>\1</sup>", escape(equation, quote=False))
    lowered = re.sub(r"\b([A-Za-z])(\d)\b", r"\1<sub>\2</sub>", raised)
    greek = re.sub(rf"\b({'|'.join(_GREEK)})\b", lambda match: _GREEK[match[1]], lowered)
    return Markup(greek.replace("\n", "<br>"))  # noqa: S704, escaped above
