"""What an effect looks like, with live sliders, on the user's own motion."""

import asyncio
import math
from dataclasses import replace

import numpy as np
from nicegui import events, ui

from estimation.effect import Effect, Parameter
from palpate.render import palette
from palpate.render.build import axes_of
from palpate.workbench.bench import Bench
from palpate.workbench.curves import Motion, axis, curve, layout_of, near, picked
from palpate.workbench.effects import sized
from palpate.workbench.plot import Figure, Plot, Restyle
from robot_io.errors import PalpateError
from robot_io.types import FloatArray

_RUNS, _POINTS = 3, 600  # of the user's motion that are simulated; samples drawn
_STEPS = 100.0  # of a slider
_DECADES = 1.0  # to either side of where a gain's slider begins


class Gallery:
    """A dialog for one effect after the other: the fitted base model with it, simulated."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    async def open(self, name: str) -> None:
        """Show an effect beside the base model."""
        effect = next(one for one in self._bench.effects() if one.name == name)
        try:
            simulated = await asyncio.to_thread(_Simulated, self._bench, effect)
        except PalpateError as error:
            ui.notify(str(error), type="warning")
            return
        with ui.dialog() as dialog, ui.card().classes("gallery"):
            ui.html(f"<h2>{name.replace('_', ' ')}</h2>", sanitize=False)
            ui.label(effect.physics)
            ui.label(f"What one sees: {effect.signature}.")
            ui.label(effect.equation).classes("code")
            plot = Plot(simulated.figure())
            for parameter in (*effect.gains, *effect.inner):
                _slider(parameter, simulated, plot)
            for other, experiment in effect.confused_with.items():
                ui.label(f"Told from {other.replace('_', ' ')} by: {experiment}").classes("quiet")
            ui.button("Close", on_click=dialog.close).props("flat no-caps autofocus")
        dialog.on("hide", dialog.delete)
        dialog.open()


class _Simulated:
    """An effect added to the fitted base model, on a few runs of the user's motion."""

    def __init__(self, bench: Bench, effect: Effect) -> None:
        base = bench.study.fit(bench.channel)
        there = base.data.runs
        few = there[np.unique(np.linspace(0, len(there) - 1, _RUNS).astype(int))]
        moved = base.data.of_runs(few)
        self.effect = effect
        self.data = replace(moved, effort=base.model.predict(moved, base.values))
        self._model = base.model.with_effect(effect)
        self._motion = Motion.of(self.data)
        self.values = sized(self.data, base.model, dict(base.values), effect)
        rows = np.flatnonzero(near(self._motion))
        rows = rows[:: max(len(rows) // _POINTS, 1)]
        self._rows = np.insert(rows, np.flatnonzero(np.diff(self.data.run[rows])) + 1, -1)

    def effort(self) -> FloatArray:
        return self._model.predict(self.data, self.values)

    def figure(self) -> Figure:
        axes, traces = axes_of(self.data.kind), []
        for x, place in ((self._motion.time_s, "x"), (self._motion.position, "x2")):
            for name, y, color in (
                ("base model", self.data.effort, palette.BASE),
                ("with it", self.effort(), palette.MODEL),
            ):
                drawn = picked(x, self._rows), picked(y, self._rows)
                traces.append(
                    curve(name, *drawn, color, 1.4, axes.effort_unit, xaxis=place, showlegend=place == "x")
                )
        layout = layout_of(
            260,
            xaxis=axis("time [s]", domain=[0, 0.55]),
            xaxis2=axis(axes.position, domain=[0.62, 1]),
            yaxis=axis(axes.effort),
        )
        return {"data": traces, "layout": layout, "config": {"displayModeBar": False}}

    def update(self) -> Restyle:
        return {"y": [picked(self.effort(), self._rows)] * 2}, [1, 3]


def _slider(parameter: Parameter, simulated: _Simulated, plot: Plot) -> None:
    """A slider over what is met in practice: by ratio where that spans decades."""
    name = f"{simulated.effect.name}.{parameter.name}"
    start = simulated.values[name]
    is_gain = parameter in simulated.effect.gains
    low, high = (start / 10**_DECADES, start * 10**_DECADES) if is_gain and start > 0 else parameter.typical
    by_ratio = low > 0.0 and high / low > 20.0
    unit = parameter.unit.format(
        effort=simulated.data.kind.effort_unit, position=simulated.data.kind.position_unit
    )

    def value(step: float) -> float:
        share = step / _STEPS
        return float(low * (high / low) ** share) if by_ratio else low + share * (high - low)

    def moved(event: events.GenericEventArguments) -> None:
        simulated.values[name] = value(float(event.args))
        said.set_text(f"{parameter.name} = {simulated.values[name]:.3g} {unit}")
        plot.restyle(simulated.update())

    share = (
        math.log(start / low) / math.log(high / low) if by_ratio else (start - low) / ((high - low) or 1.0)
    )
    with ui.row().classes("bar no-wrap"):
        said = ui.label(f"{parameter.name} = {start:.3g} {unit}").style("min-width: 170px")
        ui.slider(min=0.0, max=_STEPS, step=1.0, value=min(max(share, 0.0), 1.0) * _STEPS).props(
            f'dense aria-label="{name}"'
        ).on("update:model-value", moved, throttle=0.05)
