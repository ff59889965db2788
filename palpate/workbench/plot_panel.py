"""The middle of the page: curves with cursors, run selection, residual maps."""

from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import numpy as np
from nicegui import events, ui

from palpate.workbench import curves, elements
from palpate.workbench.curves import DrawnMotion
from palpate.workbench.elements import Plot, heading, set_props
from palpate.workbench.state import DisplayedFit, WorkbenchState
from robot_io.types import FloatArray

MOST_RUNS = 60  # that can be chosen one by one
UseRuns = Callable[[Sequence[int], Sequence[int]], Awaitable[None]]  # takes those left out, those held out


class PlotPanel:
    """Curves of one channel; a tick redraws the model's alone."""

    def __init__(self, state: WorkbenchState, use_runs: UseRuns) -> None:
        self._state, self._use_runs = state, use_runs
        self._data = state.channel.data
        self._motion = DrawnMotion.of(self._data)
        self._span_s: tuple[float, float] | None = None
        self._shown: DisplayedFit | None = None
        self._drawn: tuple[FloatArray, FloatArray] | None = None  # effort and residual of the model
        self._cursors: dict[str, float] = {}
        self._next = "A"

    def build(self) -> None:
        """Put the elements where they are; raw curves are there before, and whatever, the analysis says."""
        with ui.element("section").classes("card"):
            with ui.row().classes("bar"):
                heading("Curves", elements.CURVES)
                self._runs()
            self._time = Plot(curves.time_figure(self._motion, None, None))
            self._time.on("zoom", self._zoomed)
            self._time.on("point", self._clicked)
            self._cursor_bar()
        with ui.element("section").classes("card"):
            heading("Over the state", elements.STATE)
            self._state_plot = Plot(curves.state_figure(self._motion, None))
        with ui.element("section").classes("card") as self._map_card:
            heading("Residual over the state", elements.MAP)
            self._map: Plot | None = None

    def show(self, shown: DisplayedFit) -> None:
        """Draw a fit; the first one of a channel with its base model."""
        first, self._shown = self._shown is None, shown
        self._drawn = _of(shown)
        if first:
            self._redraw()
        else:
            self._model(*self._drawn)

    def show_state(self) -> None:
        """Draw the fit over the state: what is looked at after the curves over time."""
        if self._drawn is not None:
            self._state_plot.restyle(curves.state_update(self._motion, self._drawn[0]))

    def show_map(self) -> None:
        """Draw the residual map, which takes longest and so comes last."""
        if self._shown is None or self._drawn is None:
            return
        if self._map is None:
            with self._map_card:
                self._map = Plot(curves.map_figure(self._motion, self._shown.base.residual, self._drawn[1]))
        else:
            self._map.restyle(curves.map_update(self._motion, self._drawn[1]))

    def preview(self, effort: FloatArray) -> None:
        """Draw another prediction (n,) than that of the fit, while a slider is pulled."""
        if self._shown is not None:
            self._drawn = effort, np.where(self._shown.base.judged, self._data.effort - effort, np.nan)
            self._model(*self._drawn)

    def _model(self, effort: FloatArray, left: FloatArray) -> None:
        self._time.restyle(curves.model_update(self._motion, effort, left, self._span_s))
        self._read_cursors()

    def _redraw(self) -> None:
        if self._shown is None or self._drawn is None:
            self._time.replace(curves.time_figure(self._motion, None, None))
            self._state_plot.replace(curves.state_figure(self._motion, None))
            return
        base = _of_base(self._shown)
        figure = curves.time_figure(self._motion, *base)
        update, traces = curves.time_update(self._motion, base, self._drawn, self._span_s)
        for number in traces:
            figure["data"][number] |= {"x": update["x"][number], "y": update["y"][number]}
        figure["layout"] |= curves.cursor_shapes(self._cursors)
        self._time.replace(figure)
        self._state_plot.replace(curves.state_figure(self._motion, self._drawn[0]))

    def _runs(self) -> None:
        measured = (self._state.whole or self._state).study.source
        if not 1 < len(measured.runs) <= MOST_RUNS:
            return
        names = {run: f"run {run}" for run in measured.runs}
        left = {run: name for run, name in names.items() if run not in self._state.out}
        _select(left, "drawn: all", "runs to draw", elements.RUNS).on_value_change(self._chose_runs)
        out = _select(names, "runs left out", "runs to leave out", elements.LEFT_OUT, self._state.out)
        held = self._state.study.held_out
        judged = _select(left, "runs held out", "runs to hold out", elements.HELD_OUT, held)

        choosing = False

        async def use(*, still: bool) -> None:
            nonlocal choosing
            choosing = still
            if not still:
                await self._use_runs(out.value or (), judged.value or ())

        for one in (out, judged):  # several can be chosen before the list is closed
            one.on("popup-show", lambda: use(still=True)).on("popup-hide", lambda: use(still=False))
            one.on_value_change(lambda: use(still=choosing))

    def _chose_runs(self, event: events.ValueChangeEventArguments[Any]) -> None:
        drawn = self._state.study.source.runs_of(self._data, event.value or ())
        self._motion = DrawnMotion.of(self._data, drawn)
        self._span_s = None
        self._redraw()
        if self._map is not None and self._shown is not None and self._drawn is not None:
            self._map.replace(curves.map_figure(self._motion, self._shown.base.residual, self._drawn[1]))

    def _zoomed(self, event: events.GenericEventArguments) -> None:
        span = event.args
        self._span_s = (float(span[0]), float(span[1])) if span else None
        if self._shown is not None and self._drawn is not None:
            self._time.restyle(
                curves.time_update(self._motion, _of_base(self._shown), self._drawn, self._span_s)
            )

    def _cursor_bar(self) -> None:
        with ui.row().classes("bar cursors"):
            set_props(ui.label("cursors").classes("quiet"), title=elements.CURSORS)
            self._at = {name: self._cursor_input(name) for name in ("A", "B")}
            self._reading = ui.html("").classes("reading").mark("reading")

    def _cursor_input(self, name: str) -> ui.number:
        def typed(event: events.ValueChangeEventArguments[Any]) -> None:
            if self._cursors.get(name) != event.value:
                self._set_cursor(name, event.value)

        return (
            ui.number(f"{name} [s]", format="%.3f", on_change=typed).props("dense outlined").classes("cursor")
        )

    def _clicked(self, event: events.GenericEventArguments) -> None:
        name, self._next = self._next, "B" if self._next == "A" else "A"
        self._at[name].set_value(round(float(event.args), 4))

    def _set_cursor(self, name: str, time_s: float | None) -> None:
        """Put a cursor at a time [s], or on the nearer end of the curves; None takes it away."""
        self._cursors.pop(name, None)
        if time_s is not None:
            self._cursors[name] = float(np.clip(time_s, *self._motion.time_s[[0, -1]]))
        self._time.relayout(curves.cursor_shapes(self._cursors))
        self._read_cursors()

    def _read_cursors(self) -> None:
        rows = {name: int(np.argmin(np.abs(self._motion.time_s - t))) for name, t in self._cursors.items()}
        self._reading.set_content(" &nbsp; ".join(self._readings(rows)))

    def _readings(self, rows: dict[str, int]) -> list[str]:
        unit, effort = self._motion.axes.effort_unit, self._data.effort
        model = self._drawn[0] if self._drawn else None
        said = []
        for name, row in rows.items():
            beside = (
                "" if model is None else f", model {model[row]:.4g}, left {effort[row] - model[row]:+.3g}"
            )
            said.append(f"<b>{name}</b> {effort[row]:.4g} {unit}{beside}")
        if len(rows) == 2:
            a, b = rows["A"], rows["B"]
            depth, _, of_depth = self._motion.axes.position.rstrip("]").partition(" [")
            apart = np.diff(self._motion.position[[a, b]])[0]
            said.append(
                f"<b>B − A</b> {self._motion.time_s[b] - self._motion.time_s[a]:.4g} s, "
                f"{effort[b] - effort[a]:+.4g} {unit}, {depth} {apart:+.4g} {of_depth}"
            )
        return said


def _select(
    options: dict[int, str], label: str, name: str, said: str, value: Sequence[int] = ()
) -> ui.select:
    made = ui.select(options, multiple=True, label=label, value=list(value)).classes("runs")
    return set_props(
        made.props("dense outlined options-dense clearable use-chips"), aria_label=name, title=said
    )


def _of(shown: DisplayedFit) -> tuple[FloatArray, FloatArray]:
    """Effort that the fit expects, and what it leaves in held-out runs, (n,) each."""
    return shown.fitted.predict(shown.fitted.values), shown.fitted.residual


def _of_base(shown: DisplayedFit) -> tuple[FloatArray, FloatArray]:
    return shown.base.predict(shown.base.values), shown.base.residual
