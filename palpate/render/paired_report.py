"""Plotly figures, HTML report and Rerun recording of a paired comparison."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.subplots import make_subplots

from palpate.common.console import significant
from palpate.estimation.estimate import ParameterEstimate
from palpate.render import palette
from palpate.render.paired import LETTERS, ChannelPairView, PairView, difference_text
from palpate.render.recording.file import TIME, plot, recording_file, send_lines, shown_on
from palpate.render.recording.rerun_modules import rrb
from palpate.render.report import RUN_TIME, PlotStyle, as_html, draw_curves, rendered, styled, title_axes
from palpate.render.thinning import rows_by_run, run_curves

COLORS = (palette.MEASURED, palette.OTHER)


def _state_figure(view: ChannelPairView) -> go.Figure:
    """Draw both measured efforts, and their models dashed, over position and over velocity."""
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


def _time_figure(view: ChannelPairView) -> go.Figure:
    """Draw both efforts and residuals over time; if B repeats A, it is drawn at A's times."""
    made = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.6, 0.4], vertical_spacing=0.06)
    first, second = view.views
    unit = first.axes.effort_unit
    for letter, color, channel in zip(LETTERS, COLORS, view.views, strict=True):
        runs = list(rows_by_run(channel.run).values())
        if channel is second and view.sides.overlay is not None:
            curves = run_curves(first.time_s, view.sides.overlay, list(rows_by_run(first.run).values()))
        else:
            curves = run_curves(channel.time_s, channel.effort, runs)
        draw_curves(made, curves, (1, 1), unit, PlotStyle(f"{letter} measured", color, width=1.8))
        if channel.stages:
            left = run_curves(channel.time_s, channel.stages[-1].residual, runs)
            draw_curves(made, left, (2, 1), unit, PlotStyle(f"residual of {letter}'s model", color))
    title_axes(made, (1, 1), "", first.axes.effort)
    title_axes(made, (2, 1), RUN_TIME, first.axes.residual)
    return styled(made, 520)


def _residual_figure(view: ChannelPairView) -> go.Figure:
    """Draw autocorrelations of the residuals and their correlations with velocity, with 99 % bands."""
    titles = ("Autocorrelation", "Cross-correlation with the velocity")
    made = make_subplots(1, 2, shared_yaxes=True, horizontal_spacing=0.04, subplot_titles=titles)
    for letter, color, side in zip(LETTERS, COLORS, view.pair, strict=True):
        for column, correlation in enumerate((side.autocorrelation, side.cross_correlation), start=1):
            group = {"x": side.step_s * correlation.lag, "legendgroup": letter}
            line = {"color": color, "width": 1.3}
            about = {"name": f"{letter}'s model", "showlegend": column == 1}
            made.add_trace(go.Scatter(y=correlation.value, line=line, **about, **group), 1, column)
            band = {"color": color, "width": 1, "dash": "dot"}
            for edge in (correlation.band, -correlation.band):
                trace = go.Scatter(y=edge, line=band, showlegend=False, hoverinfo="skip", **group)
                made.add_trace(trace, 1, column)
    title_axes(made, (1, 1), "lag [s]", "correlation")
    title_axes(made, (1, 2), "lag [s]; positive: velocity leads", "")
    made.update_yaxes(range=[-1.05, 1.05])
    made.update_annotations(yshift=6)
    return styled(made, 360).update_layout(legend_y=1.1)


_TEMPLATE = Path(__file__).parent / "paired.html"


def document(pair: PairView) -> str:
    """Return the HTML page.

    Args:
        pair: all channels of both files.
    """

    def value(estimate: ParameterEstimate | None) -> str:
        return "–" if estimate is None else significant(estimate.value, estimate.std_err)

    def plots(view: ChannelPairView) -> dict[str, Markup]:
        draw = {"state": _state_figure, "time": _time_figure, "residual": _residual_figure}
        return {name: as_html(figure(view)) for name, figure in draw.items()}

    filters: dict[str, Callable[..., Any]] = {"value": value, "difference": difference_text}
    models = dict.fromkeys(side.model for channel in pair.channels for side in channel.pair)
    facts = dict(zip(LETTERS, pair.names, strict=True)) | {"models": ", ".join(models)}
    return rendered(_TEMPLATE, filters, title=" and ".join(pair.names), facts=facts, pair=pair, plots=plots)


def record_pair(view: PairView, path: Path) -> None:
    """Write the recording, completely or not at all.

    On timeline `time` each side has its runs one after the other; if B repeats A, it uses A's times.

    Args:
        view: all channels of both files.
        path: path of the .rrd file.

    Raises:
        InputError: the file cannot be written.
    """
    tabs, corner = [], rrb.Corner2D.LeftTop
    for paired in view.channels:
        axes, place = paired.views[0].axes, paired.sides.channel
        titles = {name: getattr(axes, name) for name in ("effort", "residual", "position")}
        plots = [plot(f"{place}/{name}", title, legend=corner) for name, title in titles.items()]
        tabs.append(rrb.Vertical(*plots, row_shares=[3, 2, 1], name=place))
    with recording_file(" and ".join(view.names), path, shown_on(*tabs, timeline=TIME)) as recording:
        for paired in view.channels:
            place = paired.sides.channel
            for letter, color, channel in zip(LETTERS, COLORS, paired.views, strict=True):
                overlay = paired.sides.overlay if letter == LETTERS[1] else None
                time_s = channel.time_s if overlay is None else paired.views[0].time_s
                effort = channel.effort if overlay is None else overlay
                measured = {f"{letter} measured": (effort, color, 2.0)}
                send_lines(recording, f"{place}/effort/{letter}", time_s, measured)
                for stage in channel.stages[-1:]:
                    left = {f"residual of {letter}'s model": (stage.residual, color, 1.0)}
                    send_lines(recording, f"{place}/residual/{letter}", channel.time_s, left)
                motion = {f"{letter}": (channel.position, color, 1.2)}
                send_lines(recording, f"{place}/position/{letter}", channel.time_s, motion)
