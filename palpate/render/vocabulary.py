"""The effects that palpate knows, in words and drawn: for terminal, JSON and docs/effects.md."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.text import Text

from estimation.channel import ChannelKind
from estimation.effect import Effect, Parameter, SensorEffect
from estimation.effects import EFFECTS
from estimation.effects.run_variation import RunVariation
from palpate.console import table
from palpate.example import Example
from palpate.render import palette
from palpate.render.build import axes_of, one_after_the_other
from palpate.render.characters import beside, drawing
from palpate.words import safe

GROUPS = ("Contact", "Joints", "Contact and joints", "Sensor and drive readings", "From run to run")
_MILLI, _ROOMY = 1e3, 100
_TALLEST, _WIDEST, _NARROWEST = 11, 46, 34  # of a drawing, in characters


@dataclass(frozen=True)
class EffectView:
    """One effect in words.

    Attributes:
        name: as it is typed.
        group: one of `GROUPS`.
        physics: what happens.
        equation: its term.
        source: where the equation comes from.
        signature: what one sees in the data.
        channels: kinds of channel it occurs in.
        needs: signals without which it cannot be tried.
        parameters: with their units in the first kind of channel.
        confused_with: effects that it is mistaken for, with the experiment that tells them apart.
    """

    name: str
    group: str
    physics: str
    equation: str
    source: str
    signature: str
    channels: tuple[str, ...]
    needs: tuple[str, ...]
    parameters: tuple[tuple[str, str, tuple[float, float]], ...]
    confused_with: Mapping[str, str]


def library() -> tuple[EffectView, ...]:
    """All effects, group by group."""
    every = [effect_view(effect()) for effect in EFFECTS.values()]
    return tuple(sorted(every, key=lambda one: (GROUPS.index(one.group), one.name)))


def effect_view(effect: Effect) -> EffectView:
    """What is said of an effect."""
    kind = kind_of(effect)
    return EffectView(
        effect.name,
        _group(effect),
        effect.physics,
        effect.equation,
        effect.source,
        effect.signature,
        tuple(str(one) for one in ChannelKind if one in effect.channels),
        effect.needs,
        tuple((one.name, _unit(one, kind), one.typical) for one in (*effect.gains, *effect.inner)),
        dict(effect.confused_with),
    )


def kind_of(effect: Effect) -> ChannelKind:
    """The channel in which an effect is shown: a contact, where it occurs there."""
    return next(one for one in ChannelKind if one in effect.channels)


def as_data(view: EffectView) -> dict[str, Any]:
    """An effect as plain data; the keys are stable."""
    parameters = [
        {"name": name, "unit": unit, "typical": list(typical)} for name, unit, typical in view.parameters
    ]
    return vars(view) | {"parameters": parameters}


def print_library(console: Console, views: Sequence[EffectView]) -> None:
    """One table a group: what one sees of each effect, and what it is confused with where there is room."""
    roomy = console.width >= _ROOMY
    for group in GROUPS:
        chosen = [one for one in views if one.group == group]
        columns = ("effect", "what one sees", *(("confused with",) if roomy else ()))
        made = table(group, *columns)
        made.columns[0].no_wrap = True
        for one in chosen:
            rivals = [safe(", ".join(sorted(one.confused_with)))] if roomy else []
            made.add_row(f"[bold]{safe(one.name)}[/bold]", safe(one.signature), *rivals)
        if chosen:
            console.print(made)


def print_effect(console: Console, view: EffectView, example: Example | None) -> None:
    """One effect: physics, equation, what one sees, drawn, its parameters, and what it is confused with."""
    console.print(f"[bold]{safe(view.name)}[/bold]  [dim]{safe(', '.join(view.channels))}[/dim]")
    lines = {
        "physics": view.physics,
        "equation": view.equation,
        "one sees": view.signature,
        "source": view.source,
    }
    if view.needs:
        lines["needs"] = ", ".join(view.needs)
    for what, words in lines.items():
        console.print(Padding(Text.from_markup(f"[dim]{what}[/dim]  {safe(words)}"), (0, 0, 0, 2)))
    if example is not None and "utf" in console.encoding:
        console.print()
        for line in drawn(example, console.width):
            console.print(Padding(line, (0, 0, 0, 2)), no_wrap=True, crop=True)
    made = table("", "parameter", "unit", "typical", right=("typical",))
    for name, unit, (low, high) in view.parameters:
        made.add_row(safe(name), safe(unit), f"{low:.3g} to {high:.3g}")
    console.print(made)
    if view.confused_with:
        rivals = table("Often confused with", "effect", "told apart by")
        rivals.columns[0].no_wrap = True
        for name, experiment in view.confused_with.items():
            rivals.add_row(f"[bold]{safe(name)}[/bold]", safe(experiment))
        console.print(rivals)


def drawn(example: Example, width: int) -> Iterator[Text]:
    """An example with characters: effort over position and, where there is room, over time."""
    data, axes = example.data, axes_of(example.data.kind)
    position = data.position * (1.0 if data.kind is ChannelKind.REVOLUTE else _MILLI)
    before, after = data.effort, example.effort()
    room = width - 4
    sides = 2 if room >= 2 * _NARROWEST + 3 else 1
    wide = min((room - 3 * (sides - 1)) // sides, _WIDEST)
    curves = [(f"over {axes.position}", position), ("over time", one_after_the_other(data))][:sides]
    yield Text.from_markup(
        f"{safe(axes.effort)}, {np.min([before, after]):.3g} to {np.max([before, after]):.3g}: "
        f"[{palette.BASE}]· without it[/], [{palette.MODEL}]⣿ with {safe(example.effect.name)}[/]"
    )
    panels = [
        drawing((x, before, palette.BASE), (x, after, palette.MODEL), wide, _TALLEST) for _, x in curves
    ]
    yield from beside([title for title, _ in curves], panels)


def _group(effect: Effect) -> str:
    if isinstance(effect, RunVariation):
        return "From run to run"
    if isinstance(effect, SensorEffect) or effect.name in {"bias", "drift"}:
        return "Sensor and drive readings"
    if ChannelKind.CONTACT not in effect.channels:
        return "Joints"
    return "Contact" if effect.channels == {ChannelKind.CONTACT} else "Contact and joints"


def _unit(parameter: Parameter, kind: ChannelKind) -> str:
    return parameter.unit.format(effort=kind.effort_unit, position=kind.position_unit)
