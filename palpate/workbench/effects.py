"""Left panel of the page: library of effects with plots and evidence, and single effects with sliders."""

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from itertools import chain
from typing import Any

import numpy as np
from nicegui import events, ui
from nicegui.element import Element

from palpate.estimation.effect import Effect, Parameter
from palpate.estimation.estimate import with_unit
from palpate.render import palette
from palpate.render.build import axes_of
from palpate.render.effects import EffectExample
from palpate.robot_io.errors import InputError, PalpateError
from palpate.workbench import elements
from palpate.workbench.elements import Figure, Plot, Restyle, axis, curve, heading, layout_of, set_props
from palpate.workbench.plots import DrawnMotion, near, picked
from palpate.workbench.processes import FitPrefetcher
from palpate.workbench.startup import thumbnail_svg
from palpate.workbench.state import TELLING, EffectEvidence, WorkbenchState, evidence_of, groups

_BAR_PX = 44  # width of the bar of an effect that removes the whole error
_PAUSE_S = 0.1  # period of checks for a changed selection
Tick = Callable[[str], Awaitable[None]]
Row = dict[str, Any]  # fields of a row, as in effects.js
_APART: Row = {"alike": False, "together": ""}


class EffectRows(Element, component="effects.js"):
    """The effect library as one browser element, so that ticking an effect does not redraw the page."""

    def __init__(self, rows: list[Row]) -> None:
        super().__init__()
        self.by_name = {row["name"]: row for row in rows}
        self._is_ready = False
        self._props |= {"effects": rows, "hint": elements.PICTURE, "alike": elements.ALIKE}

        def send_all() -> None:
            self._is_ready = True
            self.run_method("change", self.by_name)

        self.on("ready", send_all)

    def change(self, changes: Mapping[str, Row]) -> None:
        """Change fields of some effects; only differences are sent.

        Args:
            changes: changed fields of rows, by effect name.
        """
        differing = {
            name: left
            for name, row in changes.items()
            if (left := {key: value for key, value in row.items() if self.by_name[name][key] != value})
        }
        for name, row in differing.items():
            self.by_name[name] |= row
        if differing and self._is_ready:
            self.run_method("change", differing)


class EffectList:
    """List of effects of one channel; their evidence is computed while the page is idle."""

    def __init__(self, state: WorkbenchState, tick: Tick) -> None:
        self._state, self._tick = state, tick
        self._effects: dict[str, Effect] = {}
        self._evidence: list[EffectEvidence] = []
        self._marked: tuple[str, ...] = ()  # effects to which the marks in the list refer
        self._last: dict[str, float] = {}
        # groups of indistinguishable effects, found when neither was ticked
        self._rivals: dict[str, tuple[str, ...]] = {}

    def build(self) -> None:
        """Build the heading and an empty list."""

        def show_matching(event: events.ValueChangeEventArguments[Any]) -> None:
            part, words = (event.value or "").strip().lower(), ("name", "label", "signature", "physics")
            texts = {name: " ".join(row[key] for key in words) for name, row in self._rows.by_name.items()}
            self._rows.change({name: {"seen": part in text.lower()} for name, text in texts.items()})

        with ui.element("section").classes("card effects") as self._card, ui.row().classes("bar"):
            heading("Effects", elements.EFFECTS)
            ui.space()
            text = ui.input(placeholder="filter", on_change=show_matching).classes("filter")
            set_props(text.props("dense outlined clearable"), aria_label="filter effects")

    def fill(self) -> None:
        """List the channel's library, with the model's effects ticked."""
        self._effects = {effect.name: effect for effect in self._state.effects()}
        kind = self._state.channel.data.kind
        rows: list[Row] = []
        for effect in self._effects.values():
            # a drawing of effort over position with and without the effect
            example, drawn = EffectExample.on_simple_motion(effect, kind), ""
            if example is not None:
                step, data = slice(None, None, 2), example.data
                curves = [(data.effort[step], palette.BASE), (example.effort()[step], palette.MODEL)]
                drawn = thumbnail_svg(data.position[step], curves)
            rows.append(
                {
                    "name": effect.name,
                    "label": effect.name.replace("_", " "),
                    "physics": effect.physics,
                    "signature": effect.signature,
                    "equation": effect.equation,
                    "picture": drawn,
                    "chosen": False,
                    "order": 1000,
                    **{"mark": "", "look": "quiet", "about": "", "share": None},  # evidence of the effect
                    "seen": True,
                    **_APART,
                }
            )
        with self._card:
            self._rows = EffectRows(rows)

        async def tick(event: events.GenericEventArguments) -> None:
            # selection in the browser; reverted if it cannot be fitted
            self._rows.by_name[event.args]["chosen"] ^= True
            await self._tick(event.args)

        self._rows.on("tick", tick)
        self._rows.on("picture", lambda event: open_gallery(self._state, event.args))
        self.show(self._state.choice.effects)
        self.arrange()

    def show(self, chosen: tuple[str, ...]) -> None:
        """Tick the selected effects.

        Args:
            chosen: names of the effects in the model.
        """
        if not self._effects:
            return
        if chosen != self._marked:
            marked = [name for name in self._effects if self._rows.by_name[name]["mark"]]
            self._rows.change({name: {"look": "stale", "about": elements.STALE} for name in marked})
            self._marked = chosen
        self._rows.change({name: {"chosen": name in chosen} for name in self._effects})
        self._rows.change({name: {"order": _rank(self._last.get(name, 1.0), chosen=True)} for name in chosen})

    async def rank_effects(self, idle: asyncio.Event) -> None:
        """Compute the change of the error by each effect while the page is idle.

        The fits are then already available when the user ticks an effect.

        Args:
            idle: set while the page is idle.
        """
        channel, weighed = self._state.channel, None
        ahead = FitPrefetcher(self._state.study, channel)
        try:
            while not self._card.is_deleted and self._state.channel is channel:
                chosen = self._state.choice.effects
                if chosen != weighed and await self._evaluate_extensions(chosen, ahead, idle):
                    weighed = chosen
                await asyncio.sleep(_PAUSE_S)
        finally:
            ahead.close()

    async def _evaluate_extensions(
        self, chosen: tuple[str, ...], ahead: FitPrefetcher, idle: asyncio.Event
    ) -> bool:
        """Compute the evidence of all effects; return whether the selection stayed the same."""
        study, channel, weighed = self._state.study, self._state.channel, list[EffectEvidence]()
        # the strongest evidence so far first, then fast fits
        for name in sorted(
            self._effects, key=lambda name: (-self._last.get(name, 0.0), len(self._effects[name].inner))
        ):
            await idle.wait()
            if self._card.is_deleted or self._state.choice.effects != chosen:
                return False
            beside = tuple(effect for effect in chosen if effect != name)
            try:
                await ahead.fit((*beside, name))
                evidence = await asyncio.to_thread(evidence_of, study, channel, beside, name)
            except PalpateError as error:
                self._rows.change({name: {"mark": "–", "look": "quiet", "about": str(error), "share": None}})
                continue
            if self._state.choice.effects != chosen:
                return False
            weighed.append(evidence)
            self._last[name] = evidence.falls
            falls = max(evidence.falls, 0.0)
            change: Row = {
                "mark": f"{'−' if falls > 0.005 else ''}{100 * falls:.0f} %",
                "look": "strong" if evidence.falls > TELLING else "quiet",
                "about": elements.EVIDENCE,
                "share": round(_BAR_PX * falls),
            }
            # later, and in a frame, the order stays until all effects are computed
            if not (self._evidence or self._rows.by_name[name]["alike"]):
                change["order"] = _rank(evidence.falls, chosen=evidence.effect in self._state.choice.effects)
            self._rows.change({evidence.effect: change})
        self._evidence = weighed
        self.arrange()
        return True

    def arrange(self) -> None:
        """Sort by evidence, with indistinguishable effects in one frame."""
        rows, placed = self._rows.by_name, set[str]()
        changes = {name: {**_APART, "order": rows[name]["order"]} for name in self._effects}
        diagnosis = None
        with suppress(InputError):  # the card of the diagnosis reports a damaged file
            diagnosis = self._state.diagnosis
        if diagnosis is not None:
            alike = [[each.effect, *each.confused_with] for each in diagnosis.accepted if each.confused_with]
            alike += ([evidence.effect] for evidence in self._evidence)
        else:
            alike = [[evidence.effect for evidence in group] for group in groups(self._evidence)]
            self._rivals |= {name: tuple(names) for names in alike if len(names) > 1 for name in names}
            chosen = self._state.choice.effects
            for names in alike:
                names.extend(chain(*[self._rivals.get(name, ()) for name in names if name in chosen]))
        for group in alike:
            names = [name for name in dict.fromkeys(group) if name in self._effects and name not in placed]
            placed.update(names)
            is_chosen = any(name in self._state.choice.effects for name in names)
            falls = max((each.falls for each in self._evidence if each.effect in names), default=0.0)
            for name in names:
                changes[name] |= {"order": _rank(falls, chosen=is_chosen), "alike": len(names) > 1}
            if len(names) > 1:
                # Last effect in the order of the page.
                last = [name for name in self._effects if name in names][-1]
                listed = ", ".join(name.replace("_", " ") for name in names)
                changes[last] |= {"together": f"hard to tell apart in these data: {listed}"}
        self._rows.change(changes)


def _rank(falls: float, *, chosen: bool) -> int:
    """Return the sort key: selected effects first, then by the error that they remove."""
    return round(-1000.0 * max(falls, 0.0)) - 2000 * chosen


_POINTS = 600  # samples drawn
_STEPS = 100.0  # of a slider
_DECADES = 1.0  # range of a gain's slider around its start


async def open_gallery(state: WorkbenchState, name: str) -> None:
    """Open a dialog that simulates an effect on the fitted base model.

    Args:
        state: state of the page.
        name: name of the effect.
    """
    effect = next(effect for effect in state.effects() if effect.name == name)
    try:
        simulated = await asyncio.to_thread(_Simulated, state, effect)
    except PalpateError as error:
        ui.notify(str(error), type="warning")
        return
    with ui.dialog() as dialog, ui.card().classes("gallery"):
        heading(name.replace("_", " "))
        ui.label(effect.physics)
        ui.label(f"Signature: {effect.signature}.")
        ui.label(effect.equation).classes("code")
        plot = Plot(simulated.figure())
        for parameter in (*effect.gains, *effect.inner):
            _slider(parameter, simulated, plot)
        for rival, experiment in effect.confused_with.items():
            ui.label(f"Separate it from {rival.replace('_', ' ')}: {experiment}").classes("quiet")
        ui.button("Close", on_click=dialog.close).props("flat no-caps autofocus")
    dialog.on("hide", dialog.delete)
    dialog.open()


class _Simulated:
    """A fitted base model with an added effect, on a few runs of the user's motion."""

    def __init__(self, state: WorkbenchState, effect: Effect) -> None:
        self.example = EffectExample.on_fitted_motion(state.study.fit(state.channel), effect)
        self._motion = DrawnMotion.of(self.example.data)
        rows = np.flatnonzero(near(self._motion))
        self._rows = self._motion.with_gaps(rows[:: max(len(rows) // _POINTS, 1)])

    def figure(self) -> Figure:
        axes, traces = axes_of(self.example.data), []
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
    """Make a slider over the typical range, logarithmic where that spans decades."""
    example = simulated.example
    name = f"{example.effect.name}.{parameter.name}"
    start = example.values[name]
    is_gain = parameter in example.effect.gains
    low, high = (start / 10**_DECADES, start * 10**_DECADES) if is_gain and start > 0 else parameter.typical
    by_ratio = low > 0.0 and high / low > 20.0
    unit = parameter.unit_of(example.data)

    def value(step: float) -> float:
        share = step / _STEPS
        return float(low * (high / low) ** share) if by_ratio else low + share * (high - low)

    def moved(event: events.GenericEventArguments) -> None:
        example.values[name] = value(float(event.args))
        label.set_text(f"{parameter.name} = {with_unit(example.values[name], unit)}")
        plot.restyle(simulated.update())

    share = (
        math.log(start / low) / math.log(high / low) if by_ratio else (start - low) / ((high - low) or 1.0)
    )
    with ui.row().classes("bar no-wrap"):
        label = ui.label(f"{parameter.name} = {with_unit(start, unit)}").style("min-width: 170px")
        slider = ui.slider(min=0.0, max=_STEPS, step=1.0, value=min(max(share, 0.0), 1.0) * _STEPS)
        set_props(slider.props("dense"), aria_label=name).on("update:model-value", moved, throttle=0.05)
