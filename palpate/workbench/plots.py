"""Curves of the page, and its middle panel: cursors, run selection, residual maps."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from nicegui import events, ui

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate import with_unit
from palpate.render import palette
from palpate.render.build import axes_of, concatenated_times, display_unit
from palpate.render.thinning import even_places, peak_rows
from palpate.render.view import AxisLabels, ResidualMap, residual_map
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray
from palpate.workbench import elements
from palpate.workbench.elements import Figure, Plot, Restyle, axis, curve, heading, layout_of, set_props
from palpate.workbench.state import DisplayedFit, WorkbenchState

MOST_POINTS = 1200  # points of a curve over time
MOST_OF_STATE = 900
_FEW = 4  # number of runs over the state if none were chosen
MODEL, LEFT = 2, 4  # numbers of the model's traces over time
Prediction = tuple[FloatArray, FloatArray]  # effort and residual of a model, (n,) each


@dataclass(frozen=True)
class DrawnMotion:
    """A channel as drawn: display units, and the selected samples."""

    data: ChannelData
    runs: tuple[int, ...]
    axes: AxisLabels
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray

    @classmethod
    def of(cls, data: ChannelData, runs: Sequence[int] = ()) -> "DrawnMotion":
        """Select the motion of some runs.

        Args:
            data: the channel, n samples.
            runs: numbers of the runs to draw; empty for all.
        """
        (scale, _), time_s = display_unit(data), concatenated_times(data)
        return cls(data, tuple(runs), axes_of(data), time_s, scale * data.position, scale * data.velocity)

    @property
    def scored(self) -> BoolArray:
        """Samples of the selected runs, shape (n,)."""
        return np.isin(self.data.run, self.runs) if self.runs else np.ones(len(self.data), dtype=np.bool_)

    def map(self, residual: FloatArray) -> ResidualMap:
        """Return the map of a residual over the state; for a contact only samples in contact.

        Args:
            residual: shape (n,), in the effort's unit.
        """
        return residual_map(self.position, self.velocity, residual, self.scored & self.data.engaged)

    def rows(self, values: FloatArray, most: int, span_s: tuple[float, float] | None = None) -> IntArray:
        """Select samples to draw, with all peaks of `values`; -1 marks a gap between runs.

        Args:
            values: shape (n,).
            most: number of samples to keep.
            span_s: first and last time to draw [s]; None for all.
        """
        chosen = self.scored
        if span_s is not None:
            chosen &= (self.time_s >= span_s[0]) & (self.time_s <= span_s[1])
        drawable = np.flatnonzero(chosen)
        kept = drawable[peak_rows(values[drawable], most)] if len(drawable) else drawable
        return self.with_gaps(kept)

    def with_gaps(self, rows: IntArray) -> IntArray:
        """Insert -1 between rows of different runs, at which a curve is interrupted.

        Args:
            rows: row numbers of drawn samples, ascending, shape (k,).
        """
        return np.insert(rows, np.flatnonzero(np.diff(self.data.run[rows])) + 1, -1)


def picked(values: FloatArray, rows: IntArray) -> np.ndarray:
    """Select rows of values as float32, which is fast to send; NaN at gaps (row -1).

    Args:
        values: shape (n,).
        rows: shape (m,), -1 for a gap.

    Returns:
        Float32, shape (m,).
    """
    return np.where(rows < 0, np.nan, values[rows]).astype(np.float32)


def time_figure(
    motion: DrawnMotion,
    base: Prediction | None,
    now: Prediction | None,
    span_s: tuple[float, float] | None = None,
) -> Figure:
    """Draw measured effort, base model and model over time, and residuals below.

    Args:
        motion: motion to draw, n samples.
        base: effort and residual of the base model, (n,) each; None before the fit.
        now: effort and residual of the selected model; None before the fit.
        span_s: first and last time to draw [s]; None for all.
    """
    unknown = np.full(len(motion.data), np.nan)
    base = base or (unknown, unknown)
    update, _ = _time_update(motion, base, now or base, span_s)
    unit, below = motion.axes.effort_unit, {"yaxis": "y2", "showlegend": False}
    looks: list[tuple[str, str, float, dict[str, object]]] = [
        ("measured", palette.MEASURED, 1.6, {}),
        ("base model", palette.BASE, 1.2, {"dash": "4px,3px"}),
        ("model", palette.MODEL, 1.4, {}),
        ("residual, base model", palette.BASE, 1.0, below),
        ("residual, model", palette.MODEL, 1.1, below),
    ]
    traces = [
        curve(name, x, y, color, width, unit, **more)
        for (name, color, width, more), x, y in zip(looks, update["x"], update["y"], strict=True)
    ]
    left = base[1]
    most = 1.15 * float(np.nanmax(np.abs(left))) if np.isfinite(left).any() else 1.0
    layout = layout_of(
        410,
        xaxis=axis("time, runs one after the other [s]", anchor="y2"),
        yaxis=axis(motion.axes.effort, domain=[0.4, 1.0]),
        yaxis2=axis(f"residual [{unit}]", domain=[0.0, 0.32], range=[-most, most]),
        dragmode="zoom",
        hovermode="x",  # a cursor can be set at any click
        hoverdistance=-1,
        uirevision=motion.data.name,
    )
    return {"data": traces, "layout": layout}


def _time_update(
    motion: DrawnMotion, base: Prediction, now: Prediction, span_s: tuple[float, float] | None
) -> Restyle:
    """Return all curves over time again, with full detail in the visible span [s]."""
    rows = motion.rows(motion.data.effort, MOST_POINTS, span_s)
    ys = [motion.data.effort, base[0], now[0], base[1], now[1]]
    update = {"x": [picked(motion.time_s, rows)] * len(ys), "y": [picked(y, rows) for y in ys]}
    return update, list(range(len(ys)))


def _state_rows(motion: DrawnMotion) -> IntArray:
    """Select samples of a few runs, evenly in time, because curves over the state have no peaks to keep."""
    all_runs = motion.data.runs
    few = motion.runs or tuple(all_runs[even_places(len(all_runs), _FEW)].tolist())
    rows = np.flatnonzero(np.isin(motion.data.run, few) & near(motion))
    return motion.with_gaps(rows[:: max(len(rows) // MOST_OF_STATE, 1)])


def near(motion: DrawnMotion) -> BoolArray:
    """Select the samples around a contact; for a joint, all samples.

    Args:
        motion: motion to draw, n samples.

    Returns:
        Shape (n,).
    """
    if motion.data.kind is not ChannelKind.CONTACT:
        return np.ones(len(motion.data), dtype=np.bool_)
    return motion.position > -0.1 * float(motion.position.max())


def state_figure(motion: DrawnMotion, predicted: FloatArray | None) -> Figure:
    """Draw measured effort and model over position, and over velocity.

    Args:
        motion: motion to draw, n samples.
        predicted: effort of the model (n,); None before the fit.
    """
    rows = _state_rows(motion)
    effort, unit = picked(motion.data.effort, rows), motion.axes.effort_unit
    model = np.full(len(rows), np.nan, dtype=np.float32) if predicted is None else picked(predicted, rows)
    traces = []
    for number, values in enumerate((motion.position, motion.velocity)):
        place = {**_PANELS[number], "showlegend": False}
        x = picked(values, rows)
        traces.append(curve("measured", x, effort, palette.MEASURED, 1.3, unit, **place))
        traces.append(curve("model", x, model, palette.MODEL, 1.2, unit, **place))
    layout = layout_of(
        270,
        xaxis=axis(motion.axes.position, domain=[0.0, 0.48]),
        xaxis2=axis(motion.axes.velocity, domain=[0.52, 1.0], anchor="y2"),
        yaxis=axis(motion.axes.effort),
        yaxis2=_second_axis(motion.axes.effort),
        uirevision=motion.data.name,
    )
    return {"data": traces, "layout": layout, "narrow": _stacked(500)}


_PANELS = ({"xaxis": "x", "yaxis": "y"}, {"xaxis": "x2", "yaxis": "y2"})  # axes of two panels


def _second_axis(title: str) -> dict[str, Any]:
    """Return the vertical axis of the second panel, which is shared with the first."""
    return axis(title, anchor="x2", matches="y") | {"showticklabels": False, "title": {"text": ""}}


def _stacked(height: int) -> Figure:
    """Return the changes of layout that stack two panels on narrow screens."""
    upper, lower = [0.58, 1.0], [0.0, 0.42]
    return {
        "height": height,
        "xaxis": {"domain": [0.0, 1.0]},
        "xaxis2": {"domain": [0.0, 1.0]},
        "yaxis": {"domain": upper},
        "yaxis2": {"domain": lower, "showticklabels": True},
    }


def map_figure(motion: DrawnMotion, before: FloatArray, now: FloatArray) -> Figure:
    """Draw residuals of base model and model over the state, on one color scale.

    Args:
        motion: motion to draw, n samples.
        before: residual of the base model (n,).
        now: residual of the chosen model (n,).
    """
    maps = motion.map(before), motion.map(now)
    sizes = np.abs(maps[0].mean[np.isfinite(maps[0].mean)])
    reach = float(np.quantile(sizes, 0.98)) if len(sizes) else 1.0
    unit = motion.axes.effort_unit
    traces = [
        {
            "type": "heatmap",
            "x": each.position.astype(np.float32),
            "y": each.velocity.astype(np.float32),
            "z": each.mean.astype(np.float32),
            "zmin": -reach,
            "zmax": reach,
            "colorscale": [list(stop) for stop in palette.RESIDUAL],
            "showscale": number == 1,
            **_PANELS[number],
            "colorbar": {"thickness": 10, "title": {"text": f"residual [{unit}]", "side": "right"}},
            "hovertemplate": f"%{{x:.3g}}, %{{y:.3g}}: %{{z:.3g}} {unit}<extra></extra>",
        }
        for number, each in enumerate(maps)
    ]
    layout = layout_of(
        250,
        xaxis=axis(motion.axes.position, domain=[0.0, 0.48], showgrid=False),
        xaxis2=axis(motion.axes.position, domain=[0.52, 1.0], anchor="y2", showgrid=False),
        yaxis=axis(motion.axes.velocity, showgrid=False),
        yaxis2=_second_axis(motion.axes.velocity) | {"showgrid": False},
        annotations=[_panel_title("base model", "x", "y"), _panel_title("model", "x2", "y2")],
        uirevision=motion.data.name,
    )
    return {"data": traces, "layout": layout, "narrow": _stacked(480)}


def _cursor_shapes(times_s: Mapping[str, float]) -> dict[str, Any]:
    """Return the cursors A and B, by letter with their times [s], as lines with their letters."""
    colors = {"A": "#1d2733", "B": palette.TRUTH}
    lines = [
        {"type": "line", "xref": "x", "yref": "paper", "x0": t, "x1": t, "y0": 0, "y1": 1,
         "line": {"color": colors[name], "width": 1.2, "dash": "dot"}}
        for name, t in times_s.items()
    ]  # fmt: skip
    letters = [
        {"xref": "x", "yref": "paper", "x": t, "y": 1.0, "yanchor": "top", "xanchor": "left", "text": name,
         "showarrow": False, "font": {"color": colors[name], "size": 12}}
        for name, t in times_s.items()
    ]  # fmt: skip
    return {"shapes": lines, "annotations": letters}


def _panel_title(text: str, x_axis: str, y_axis: str) -> dict[str, Any]:
    """Return a centered title above the panel of these axes."""
    place = {"xref": f"{x_axis} domain", "yref": f"{y_axis} domain", "x": 0.5, "y": 1.0, "yanchor": "bottom"}
    return {**place, "text": text, "showarrow": False}


MOST_RUNS = 60  # largest number of runs that can be selected one by one
# Called with the excluded and with the held-out runs.
UseRuns = Callable[[Sequence[int], Sequence[int]], Awaitable[None]]


class PlotPanel:
    """Curves of one channel; ticking an effect redraws only the model's curves."""

    def __init__(self, state: WorkbenchState, use_runs: UseRuns) -> None:
        self._state, self._use_runs = state, use_runs
        self._data = state.channel.data
        self._motion = DrawnMotion.of(self._data)
        self._span_s: tuple[float, float] | None = None
        self._shown: DisplayedFit | None = None
        self._drawn: Prediction | None = None  # of the model
        self._cursors: dict[str, float] = {}
        self._next = "A"

    def build(self) -> None:
        """Create the elements; raw curves are shown before the analysis, and if it fails."""

        def zoom(event: events.GenericEventArguments) -> None:
            span = event.args
            self._span_s = (float(span[0]), float(span[1])) if span else None
            if (base := self._base()) is not None and self._drawn is not None:
                self._time.restyle(_time_update(self._motion, base, self._drawn, self._span_s))

        def move_cursor(name: str, event: events.ValueChangeEventArguments[Any]) -> None:
            """Set a cursor at a time [s], limited to the curves' range; None removes it."""
            if self._cursors.get(name) == event.value:
                return
            self._cursors.pop(name, None)
            if event.value is not None:
                self._cursors[name] = float(np.clip(event.value, *self._motion.time_s[[0, -1]]))
            self._time.relayout(_cursor_shapes(self._cursors))
            self._read_cursors()

        def place_cursor(event: events.GenericEventArguments) -> None:
            name, self._next = self._next, "B" if self._next == "A" else "A"
            self._at[name].set_value(round(float(event.args), 4))

        with ui.element("section").classes("card"):
            with ui.row().classes("bar"):
                heading("Curves", elements.CURVES)
                self._runs()
            self._time = Plot(time_figure(self._motion, None, None))
            self._time.on("zoom", zoom)
            self._time.on("point", place_cursor)
            with ui.row().classes("bar cursors"):
                set_props(ui.label("cursors").classes("quiet"), title=elements.CURSORS)
                self._at = {}
                for name in ("A", "B"):
                    cursor = ui.number(f"{name} [s]", format="%.3f", on_change=partial(move_cursor, name))
                    self._at[name] = cursor.props("dense outlined").classes("cursor")
                    # once the time is typed, show where the cursor is
                    cursor.on("blur", lambda name=name: self._at[name].set_value(self._cursors.get(name)))
                self._reading = ui.html("").classes("reading").mark("reading")
        with ui.element("section").classes("card"):
            heading("Over position and velocity", elements.STATE)
            self._state_plot = Plot(state_figure(self._motion, None))
        with ui.element("section").classes("card") as self._map_card:
            heading("Residual over position and velocity", elements.MAP)
            self._map: Plot | None = None

    def show(self, shown: DisplayedFit) -> None:
        """Draw a fit; with the first fit of a channel, also draw its base model."""
        first, self._shown = self._shown is None, shown
        # Predicted effort, and residuals in held-out runs, (n,) each.
        self._drawn = shown.fitted.predict(shown.fitted.values), shown.fitted.residual
        if first:
            self._redraw()
        else:
            self._model(*self._drawn)

    def show_state(self) -> None:
        """Draw the fit over the state, after the curves over time."""
        if self._drawn is not None:
            curve = picked(self._drawn[0], _state_rows(self._motion))
            self._state_plot.restyle(({"y": [curve] * 2}, [1, 3]))

    def show_map(self) -> None:
        """Draw the residual map, last because it is the slowest."""
        if self._shown is None or self._drawn is None:
            return
        if self._map is None:
            with self._map_card:
                self._map = Plot(map_figure(self._motion, self._shown.base.residual, self._drawn[1]))
        else:
            grid = self._motion.map(self._drawn[1])
            x, y, z = (part.astype(np.float32) for part in (grid.position, grid.velocity, grid.mean))
            self._map.restyle(({"x": [x], "y": [y], "z": [z]}, [1]))

    def preview(self, effort: FloatArray) -> None:
        """Draw a prediction other than the fit's while a slider moves.

        Args:
            effort: predicted effort, shape (n,), in the effort's unit.
        """
        if self._shown is not None:
            self._drawn = effort, np.where(self._shown.base.scored, self._data.effort - effort, np.nan)
            self._model(*self._drawn)

    def _model(self, effort: FloatArray, left: FloatArray) -> None:
        rows = self._motion.rows(self._motion.data.effort, MOST_POINTS, self._span_s)
        self._time.restyle(({"y": [picked(effort, rows), picked(left, rows)]}, [MODEL, LEFT]))
        self._read_cursors()

    def _redraw(self) -> None:
        figure = time_figure(self._motion, self._base(), self._drawn, self._span_s)
        figure["layout"] |= _cursor_shapes(self._cursors)
        self._time.replace(figure)
        self._state_plot.replace(state_figure(self._motion, self._drawn and self._drawn[0]))

    def _base(self) -> Prediction | None:
        base = None if self._shown is None else self._shown.base
        return None if base is None else (base.predict(base.values), base.residual)

    def _runs(self) -> None:
        measured = (self._state.whole or self._state).study.source
        if not 1 < len(measured.runs) <= MOST_RUNS:
            return
        names = {run: f"run {run}" for run in measured.runs}
        left = {run: name for run, name in names.items() if run not in self._state.out}

        def draw(event: events.ValueChangeEventArguments[Any]) -> None:
            drawn = self._state.study.source.runs_of(self._data, event.value or ())
            self._motion, self._span_s = DrawnMotion.of(self._data, drawn), None
            self._redraw()
            if self._map is not None and self._shown is not None and self._drawn is not None:
                self._map.replace(map_figure(self._motion, self._shown.base.residual, self._drawn[1]))

        _select(left, "drawn: all", "runs to draw", elements.RUNS).on_value_change(draw)
        out = _select(names, "runs left out", "runs to leave out", elements.LEFT_OUT, self._state.out)
        held = self._state.study.held_out
        scored = _select(left, "runs held out", "runs to hold out", elements.HELD_OUT, held)

        choosing = False

        async def use(*, still: bool) -> None:
            nonlocal choosing
            choosing = still
            if still:
                return
            try:
                await self._use_runs(out.value or (), scored.value or ())
            except InputError as error:
                ui.notify(str(error), type="warning")
                out.value, scored.value = list(self._state.out), list(held)

        for select in (out, scored):  # several runs can be selected before the list is closed
            select.on("popup-show", lambda: use(still=True)).on("popup-hide", lambda: use(still=False))
            select.on_value_change(lambda: use(still=choosing))

    def _read_cursors(self) -> None:
        rows = {name: int(np.argmin(np.abs(self._motion.time_s - t))) for name, t in self._cursors.items()}
        unit, effort = self._motion.axes.effort_unit, self._data.effort
        model = self._drawn[0] if self._drawn else None
        readings = []
        for name, row in rows.items():
            fit = "" if model is None else f", model {model[row]:.4g}, left {effort[row] - model[row]:+.3g}"
            readings.append(f"<b>{name}</b> {with_unit(effort[row], unit, 4)}{fit}")
        if len(rows) == 2:
            a, b = rows["A"], rows["B"]
            depth, _, depth_unit = self._motion.axes.position.rstrip("]").partition(" [")
            apart = np.diff(self._motion.position[[a, b]])[0]
            readings.append(
                f"<b>B − A</b> {self._motion.time_s[b] - self._motion.time_s[a]:.4g} s, "
                f"{effort[b] - effort[a]:+.4g} {unit}, {depth} {apart:+.4g} {depth_unit}"
            )
        self._reading.set_content(" &nbsp; ".join(readings))


def _select(
    options: dict[int, str], label: str, name: str, title: str, value: Sequence[int] = ()
) -> ui.select:
    select = ui.select(options, multiple=True, label=label, value=list(value)).classes("runs")
    select.props("dense outlined options-dense clearable use-chips")
    return set_props(select, aria_label=name, title=title)
