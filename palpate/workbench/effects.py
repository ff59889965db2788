"""The left of the page: the library with tick, picture, signature and evidence."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
from nicegui import events, ui

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Effect
from estimation.effects import EFFECTS
from estimation.model import Model
from palpate.render import palette
from palpate.workbench import words
from palpate.workbench.ahead import Ahead
from palpate.workbench.bench import TELLING, Bench, Evidence, evidence_of, groups
from palpate.workbench.picture import picture
from robot_io.errors import PalpateError

_TIME_S, _PICTURE_S = 0.01, 2.0  # step and length of the motion of a picture
_PAUSE_S = 0.1  # between looks whether another model was chosen
_SHARE = 0.35  # of the plain effort, that the effect is drawn with
Tick = Callable[[str], Awaitable[None]]


class Effects:
    """The list of effects of one channel; their evidence comes while the page is idle."""

    def __init__(self, bench: Bench, tick: Tick, gallery: Tick) -> None:
        self._bench, self._tick, self._gallery = bench, tick, gallery
        self._effects: dict[str, Effect] = {}
        self._ticks: dict[str, ui.checkbox] = {}
        self._rows: dict[str, ui.element] = {}
        self._marks: dict[str, ui.html] = {}
        self._setting = False
        self._evidence: list[Evidence] = []
        self._last: dict[str, float] = {}
        self._said: list[ui.label] = []
        self._rivals: dict[str, tuple[str, ...]] = {}  # that did the same, when neither was ticked

    def build(self) -> None:
        """Put the heading and the place of the list."""
        with ui.element("section").classes("card effects"):
            with ui.row().classes("bar"):
                ui.html("<h2>Effects</h2>", sanitize=False).props(f'title="{words.EFFECTS}"')
                ui.space()
                self._filter = (
                    ui.input(placeholder="filter", on_change=self._narrow)
                    .props("dense outlined clearable aria-label='filter effects'")
                    .classes("filter")
                )
            self._list = ui.element("div").classes("list")

    def fill(self) -> None:
        """List the library for the channel, those in the model ticked."""
        self._effects = {one.name: one for one in self._bench.effects()}
        data = self._bench.channel.data
        with self._list:
            for effect in self._effects.values():
                self._row(effect, data.kind)
        self.show(self._bench.choice.effects)

    def show(self, chosen: tuple[str, ...]) -> None:
        """Tick what is chosen."""
        self._setting = True
        for name, box in self._ticks.items():
            if box.value != (name in chosen):
                box.set_value(name in chosen)
            row = self._rows[name]
            row.classes(add="chosen") if name in chosen else row.classes(remove="chosen")
            if name in chosen:
                row.style(f"order: {_rank(self._last.get(name, 1.0), chosen=True)}")
        self._setting = False

    async def weigh(self, idle: asyncio.Event) -> None:
        """Find out what each effect would do beside the chosen model, while nobody waits for the page.

        A tick finds its fit made already.
        """
        channel, weighed = self._bench.channel, None
        ahead = Ahead(self._bench.study, channel)
        try:
            while not self._list.is_deleted and self._bench.channel is channel:
                chosen = self._bench.choice.effects
                if chosen != weighed and await self._weigh_beside(chosen, ahead, idle):
                    weighed = chosen
                await asyncio.sleep(_PAUSE_S)
        finally:
            ahead.close()

    async def _weigh_beside(self, chosen: tuple[str, ...], ahead: Ahead, idle: asyncio.Event) -> bool:
        """Weigh all effects beside those chosen; whether nothing else was chosen meanwhile."""
        study, channel, found = self._bench.study, self._bench.channel, list[Evidence]()
        for name in sorted(self._effects, key=self._urgency):
            await idle.wait()
            if self._list.is_deleted or self._bench.choice.effects != chosen:
                return False
            beside = tuple(one for one in chosen if one != name)
            try:
                await ahead.fit((*beside, name))
                one = await asyncio.to_thread(evidence_of, study, channel, beside, name)
            except PalpateError as error:
                self._marks[name].set_content(_no_mark(str(error)))
                continue
            found.append(one)
            self._last[name] = one.falls
            self._mark(one)
        self._evidence = found
        self.arrange()
        return True

    def _urgency(self, name: str) -> tuple[float, int]:
        """What told most before first, then what is quickly fitted."""
        return -self._last.get(name, 0.0), len(self._effects[name].inner)

    def arrange(self) -> None:
        """The most telling first; what cannot be told apart in one frame."""
        for label in self._said:
            label.delete()
        self._said.clear()
        for row in self._rows.values():
            row.classes(remove="alike last")
        found, placed = self._bench.diagnosis, set[str]()
        named = {one.effect: one.confused_with for one in found.accepted} if found is not None else {}
        for group in groups(self._evidence):
            names = [one.effect for one in group]
            if len(names) > 1:
                self._rivals |= dict.fromkeys(names, tuple(names))
            known = [self._rivals.get(one, ()) for one in names if one in self._bench.choice.effects]
            rivals = [
                other for others in (*known, *(named.get(one, ()) for one in names)) for other in others
            ]
            names = [
                one for one in dict.fromkeys([*names, *rivals]) if one in self._rows and one not in placed
            ]
            placed.update(names)
            chosen = any(name in self._bench.choice.effects for name in names)
            for name in names:
                self._rows[name].style(f"order: {_rank(group[0].falls, chosen=chosen)}")
            if len(names) > 1:
                self._frame(names)

    def _frame(self, names: list[str]) -> None:
        for name in names:
            self._rows[name].classes(add="alike")
        shown = [name for name in self._rows if name in names]  # in the order of the page
        self._rows[shown[-1]].classes(add="last")
        with self._rows[shown[-1]]:
            said = f"much the same to this data: {', '.join(name.replace('_', ' ') for name in names)}"
            self._said.append(ui.label(said).classes("together").props(f'title="{words.ALIKE}"'))

    def _row(self, effect: Effect, kind: ChannelKind) -> None:
        with ui.element("div").classes("effect").props(f'data-effect="{effect.name}"') as row:
            self._ticks[effect.name] = (
                ui.checkbox(
                    effect.name.replace("_", " "),
                    on_change=lambda event, name=effect.name: self._ticked(event, name),
                )
                .props("dense")
                .mark(effect.name)
            )
            self._ticks[effect.name].props(f'title="{escape(effect.physics, quote=True)}"')
            self._marks[effect.name] = ui.html("", sanitize=False).classes("evidence")
            drawn = (
                ui.html(_drawn(effect, kind), sanitize=False)
                .classes("picture")
                .props(
                    f'title="{words.PICTURE}" aria-label="picture of {effect.name}" role=button tabindex=0'
                )
            )
            drawn.on("click", lambda name=effect.name: self._gallery(name))
            drawn.on("keydown.enter", lambda name=effect.name: self._gallery(name))
            ui.label(effect.signature).classes("signature").props(
                f'title="{escape(effect.equation, quote=True)}"'
            )
        self._rows[effect.name] = row

    async def _ticked(self, event: events.ValueChangeEventArguments[Any], name: str) -> None:
        if not self._setting and event.value != (name in self._bench.choice.effects):
            await self._tick(name)

    def _mark(self, one: Evidence) -> None:
        falls = max(one.falls, 0.0)
        strong = "strong" if one.falls > TELLING else "quiet"
        self._marks[one.effect].set_content(
            f'<span class="{strong}" title="{words.EVIDENCE}"><i style="width:{44 * falls:.0f}px"></i>'
            f"{'−' if falls > 0.005 else ''}{100 * falls:.0f} %</span>"
        )
        if not self._evidence:  # later the list keeps still until all are weighed again
            chosen = one.effect in self._bench.choice.effects
            self._rows[one.effect].style(f"order: {_rank(one.falls, chosen=chosen)}")

    def _narrow(self, event: events.ValueChangeEventArguments[Any]) -> None:
        wanted = (event.value or "").strip().lower().replace(" ", "_")
        for name, row in self._rows.items():
            effect = self._effects[name]
            row.set_visibility(
                wanted in name or wanted.replace("_", " ") in f"{effect.signature} {effect.physics}".lower()
            )


def _rank(falls: float, *, chosen: bool) -> int:
    """Place in the list: what is ticked first, then what takes most away."""
    return round(-1000.0 * max(falls, 0.0)) - 2000 * chosen


def _no_mark(why: str) -> str:
    return f'<span class="quiet" title="{escape(why, quote=True)}">–</span>'


def _drawn(effect: Effect, kind: ChannelKind) -> str:
    """What an effect looks like on a plain motion: effort over position, without it and with it."""
    data, model = plain(kind)
    base = {name: _PLAIN.get(name, 0.0) for name in (*model.gains, *model.inner)}
    if effect.name in {one.name for one in model.effects} or not effect.applies_to(data):
        return ""
    after = model.with_effect(effect).predict(data, sized(data, model, base, effect))
    step = slice(None, None, 2)
    return picture(data.position[step], [(data.effort[step], palette.BASE), (after[step], palette.MODEL)])


_PLAIN = {"stiffness.k": 500.0, "damping.c": 4.0, "inertia.m": 0.02, "viscous_friction.d": 0.3}


def plain(kind: ChannelKind) -> tuple[ChannelData, Model]:
    """A plain motion, two presses or swings, and a plain model of it."""
    t = np.arange(0.0, _PICTURE_S, _TIME_S)
    rate = 4.0 * np.pi / _PICTURE_S
    x, v, a = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    names = ("inertia", "viscous_friction")
    if kind is ChannelKind.CONTACT:
        turn = rate * t
        x, v, a = 0.0035 - 0.004 * np.cos(turn), 0.004 * rate * np.sin(turn), 0.004 * rate**2 * np.cos(turn)
        names = ("stiffness", "damping")
    still, run = np.zeros(len(t)), np.zeros(len(t), dtype=np.int64)
    model = Model("plain", tuple(EFFECTS[name]() for name in names))
    context = {} if kind is ChannelKind.CONTACT else {"load": np.cos(rate * t)}
    data = ChannelData("plain", kind, t, x, v, a, still, run, run - 1, context)
    values = {name: _PLAIN.get(name, 0.0) for name in (*model.gains, *model.inner)}
    return replace(data, effort=model.predict(data, values)), model


def sized(data: ChannelData, model: Model, base: Mapping[str, float], effect: Effect) -> dict[str, float]:
    """Parameters of a model with one effect more, of a size that is well seen beside the data's effort."""
    starts = effect.starts(data)
    inner = dict(starts[len(starts) // 2])
    values = {**base, **{f"{effect.name}.{name}": value for name, value in inner.items()}}
    if isinstance(effect, AdditiveEffect):
        for column, gain in zip(effect.columns(data, inner).T, effect.gains, strict=True):
            length = float(np.sqrt(np.mean(column**2)))
            wanted = _SHARE * float(np.sqrt(np.mean(data.effort**2))) / length if length > 0.0 else 0.0
            values[f"{effect.name}.{gain.name}"] = wanted
    return values
