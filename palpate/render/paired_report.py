"""Plotly figures, HTML report and Rerun recording of a paired comparison."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
import rerun.blueprint as rrb
from markupsafe import Markup
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from estimation.estimate import ParameterEstimate
from estimation.statistics.correlation import Correlation
from palpate.common.console import significant
from palpate.render import palette
from palpate.render.paired import LETTERS, PairedView, PairView, difference_text
from palpate.render.recording.file import TIME, plot, recording_file, send_lines, shown_on
from palpate.render.report import (
    RUN_TIME,
    Place,
    PlotStyle,
    as_html,
    draw_curves,
    rendered,
    styled,
    title_axes,
)
from palpate.render.thinning import rows_by_run, run_curves

COLORS = (palette.MEASURED, palette.OTHER)


def state_figure(view: PairedView) -> go.Figure:
    """Measured effort of both, and the model of each dashed, over position and over velocity."""
    made, axes = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.03), view.views[0].axes
    for column, x in enumerate(("position", "velocity"), start=1):
        for letter, color, channel in zip(LETTERS, COLORS, view.views, strict=True):
            runs = [rows[channel.engaged[rows]] for rows in rows_by_run(channel.run).values()]
            curves = [(channel.effort, PlotStyle(f"{letter} measured", color, width=2.0, named=column == 1))]
            for stage in channel.stages[-1:]:
                look = PlotStyle(f"{letter}: {stage.name}", color, "5px,3px", 1.2, named=column == 1)
                curves.append((stage.predicted, look))
            for effort, look in curves:
                along = run_curves(getattr(channel, x), effort, runs)
                draw_curves(made, along, (1, column), axes.effort_unit, look)
        title_axes(made, (1, column), getattr(axes, x), axes.effort if column == 1 else "")
    return styled(made, 420)


def time_figure(view: PairedView) -> go.Figure:
    """Both over time, and what each model leaves; the second at the times of the first, if it repeats it."""
    made = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.6, 0.4], vertical_spacing=0.06)
    first, second = view.views
    unit = first.axes.effort_unit
    for letter, color, channel in zip(LETTERS, COLORS, view.views, strict=True):
        runs = list(rows_by_run(channel.run).values())
        if channel is second and view.found.overlay is not None:
            curves = run_curves(first.time_s, view.found.overlay, list(rows_by_run(first.run).values()))
        else:
            curves = run_curves(channel.time_s, channel.effort, runs)
        draw_curves(made, curves, (1, 1), unit, PlotStyle(f"{letter} measured", color, width=1.8))
        if channel.stages:
            left = run_curves(channel.time_s, channel.stages[-1].residual, runs)
            draw_curves(made, left, (2, 1), unit, PlotStyle(f"left by {letter}'s model", color))
    title_axes(made, (1, 1), "", first.axes.effort)
    title_axes(made, (2, 1), RUN_TIME, f"measured − model [{unit}]")
    return styled(made, 520)


def residual_figure(view: PairedView) -> go.Figure:
    """Autocorrelation of what each model leaves, and its correlation with the velocity; bands hold 99 %."""
    titles = ("Autocorrelation", "Cross-correlation with the velocity")
    made = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.04, subplot_titles=titles)
    for letter, color, side in zip(LETTERS, COLORS, view.pair, strict=True):
        for column, one in enumerate((side.autocorrelation, side.cross_correlation), start=1):
            look = PlotStyle(letter, color, named=column == 1)
            _draw_correlation(made, (1, column), one, side.step_s, look)
    title_axes(made, (1, 1), "lag [s]", "correlation")
    title_axes(made, (1, 2), "velocity before (+) or after (−) by [s]", "")
    made.update_yaxes(range=[-1.05, 1.05])
    made.update_annotations(yshift=6)
    return styled(made, 360).update_layout(legend_y=1.1)


def _draw_correlation(
    made: go.Figure, place: Place, correlation: Correlation, unit_s: float, look: PlotStyle
) -> None:
    lag_s = unit_s * correlation.lag
    line = {"color": look.color, "width": 1.3}
    shown = go.Scatter(
        x=lag_s,
        y=correlation.value,
        name=f"{look.name}'s model",
        line=line,
        showlegend=look.named,
        legendgroup=look.name,
    )
    made.add_trace(shown, *place)
    band = {"color": look.color, "width": 1, "dash": "dot"}
    for sign in (1.0, -1.0):
        edge = go.Scatter(
            x=lag_s,
            y=sign * correlation.band,
            line=band,
            showlegend=False,
            legendgroup=look.name,
            hoverinfo="skip",
        )
        made.add_trace(edge, *place)


_TEMPLATE = Path(__file__).parent / "paired.html"


def document(pair: PairView) -> str:
    """The whole page."""
    filters: dict[str, Callable[..., Any]] = {"value": _value, "difference": difference_text}
    facts = dict(zip(LETTERS, pair.names, strict=True))
    facts |= {
        "models": ", ".join(dict.fromkeys(side.model for channel in pair.channels for side in channel.pair))
    }
    plotly = Markup(get_plotlyjs())  # noqa: S704, plotly's own
    return rendered(_TEMPLATE, filters, title=pair.title, facts=facts, pair=pair, plotly=plotly, plots=_plots)


def _plots(view: PairedView) -> dict[str, Markup]:
    draw = {"state": state_figure, "time": time_figure, "residual": residual_figure}
    return {name: as_html(figure(view)) for name, figure in draw.items()}


def _value(estimate: ParameterEstimate | None) -> str:
    return "–" if estimate is None else significant(estimate.value, estimate.std_err)


def record_pair(view: PairView, path: Path) -> None:
    """Write the recording; the file appears whole or not at all.

    Timeline `time` is that of each side, its runs one after the other; a repetition is at the times of A.

    Raises:
        InputError: the file cannot be written.
    """
    tabs = [_tab(channel) for channel in view.channels]
    with recording_file(view.title, path, shown_on(*tabs, timeline=TIME)) as recording:
        for one in view.channels:
            for letter, color, channel in zip(LETTERS, COLORS, one.views, strict=True):
                overlay = one.found.overlay if letter == LETTERS[1] else None
                time_s = channel.time_s if overlay is None else one.views[0].time_s
                effort = channel.effort if overlay is None else overlay
                measured = {f"{letter} measured": (effort, color, 2.0)}
                send_lines(recording, f"{one.channel}/effort/{letter}", time_s, measured)
                for stage in channel.stages[-1:]:
                    left = {f"left by {letter}'s model": (stage.residual, color, 1.0)}
                    send_lines(recording, f"{one.channel}/residual/{letter}", channel.time_s, left)
                motion = {f"{letter}": (channel.position, color, 1.2)}
                send_lines(recording, f"{one.channel}/position/{letter}", channel.time_s, motion)


def _tab(view: PairedView) -> rrb.Vertical:
    axes, corner = view.views[0].axes, rrb.Corner2D.LeftTop
    plots = [
        plot(f"{view.channel}/effort", axes.effort, legend=corner),
        plot(f"{view.channel}/residual", f"measured − model [{axes.effort_unit}]", legend=corner),
        plot(f"{view.channel}/position", axes.position, legend=corner),
    ]
    return rrb.Vertical(*plots, row_shares=[3, 2, 1], name=view.channel)
