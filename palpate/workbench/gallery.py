"""What an effect looks like, with live sliders, on the user's own motion."""

import asyncio
import math

import numpy as np
from nicegui import events, ui

from estimation.effect import Effect, Parameter
from palpate.render import palette
from palpate.render.build import axes_of
from palpate.render.example import Example
from palpate.workbench.curves import DrawnMotion, axis, curve, layout_of, near, picked
from palpate.workbench.elements import Figure, Plot, Restyle, heading, set_props
from palpate.workbench.state import WorkbenchState
from robot_io.errors import PalpateError

_POINTS = 600  # samples drawn
_STEPS = 100.0  # of a slider
_DECADES = 1.0  # to either side of where a gain's slider begins


class Gallery:
    """A dialog for one effect after the other: the fitted base model with it, simulated."""

    def __init__(self, state: WorkbenchState) -> None:
        self._state = state

    async def open(self, name: str) -> None:
        """Show an effect beside the base model."""
        effect = next(effect for effect in self._state.effects() if effect.name == name)
        try:
            simulated = await asyncio.to_thread(_Simulated, self._state, effect)
        except PalpateError as error:
            ui.notify(str(error), type="warning")
            return
        with ui.dialog() as dialog, ui.card().classes("gallery"):
            heading(name.replace("_", " "))
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

    def __init__(self, state: WorkbenchState, effect: Effect) -> None:
        self.example = Example.beside(state.study.fit(state.channel), effect)
        self._motion = DrawnMotion.of(self.example.data)
        rows = np.flatnonzero(near(self._motion))
        rows = rows[:: max(len(rows) // _POINTS, 1)]
        self._rows = np.insert(rows, np.flatnonzero(np.diff(self.example.data.run[rows])) + 1, -1)

    def figure(self) -> Figure:
        axes, traces = axes_of(self.example.data.kind), []
        for x, place in ((self._motion.time_s, "x"), (self._motion.position, "x2")):
            for name, y, color in (
                ("base model", self.example.data.effort, palette.BASE),
                ("with it", self.example.effort(), palette.MODEL),
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
        return {"y": [picked(self.example.effort(), self._rows)] * 2}, [1, 3]


def _slider(parameter: Parameter, simulated: _Simulated, plot: Plot) -> None:
    """A slider over what is met in practice: by ratio where that spans decades."""
    example = simulated.example
    name = f"{example.effect.name}.{parameter.name}"
    start = example.values[name]
    is_gain = parameter in example.effect.gains
    low, high = (start / 10**_DECADES, start * 10**_DECADES) if is_gain and start > 0 else parameter.typical
    by_ratio = low > 0.0 and high / low > 20.0
    unit = parameter.unit_of(example.data.kind)

    def value(step: float) -> float:
        share = step / _STEPS
        return float(low * (high / low) ** share) if by_ratio else low + share * (high - low)

    def moved(event: events.GenericEventArguments) -> None:
        example.values[name] = value(float(event.args))
        said.set_text(f"{parameter.name} = {example.values[name]:.3g} {unit}")
        plot.restyle(simulated.update())

    share = (
        math.log(start / low) / math.log(high / low) if by_ratio else (start - low) / ((high - low) or 1.0)
    )
    with ui.row().classes("bar no-wrap"):
        said = ui.label(f"{parameter.name} = {start:.3g} {unit}").style("min-width: 170px")
        slider = ui.slider(min=0.0, max=_STEPS, step=1.0, value=min(max(share, 0.0), 1.0) * _STEPS)
        set_props(slider.props("dense"), aria_label=name).on("update:model-value", moved, throttle=0.05)
