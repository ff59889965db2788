"""Effects of the library as text, data and drawings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.padding import Padding
from rich.text import Text

from palpate.common.console import labeled, safe, table
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect, Effect, SensorEffect
from palpate.estimation.effects import EFFECTS
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.model import Model
from palpate.render import palette
from palpate.render.build import axes_of, concatenated_times
from palpate.render.thinning import even_places
from palpate.robot_io.types import BoolArray, FloatArray

_TIME_S, _PLAIN_S = 0.01, 2.0  # step and length of the plain motion
_SHARE = 0.35  # size of a drawn effect relative to the effort without it
_NEXT = 1.0 / 3.0  # ratio between successive gains: equal gains could cancel
_TRIED = 8  # number of starting values tried for an effect without gains
_RUNS = 3  # runs of the user's motion that are simulated
_PLAIN = {"stiffness.k": 500.0, "damping.c": 4.0, "inertia.m": 0.02, "viscous_friction.d": 0.3}


@dataclass
class EffectExample:
    """A model with an effect, compared with the same model without it."""

    effect: Effect  # effect that is shown
    data: ChannelData  # motion, and the effort (n,) without the effect
    model: Model  # with the effect
    # Parameters by "effect.parameter", large enough to be seen; they may be changed.
    values: dict[str, float]

    @classmethod
    def on_simple_motion(cls, effect: Effect, kind: ChannelKind) -> "EffectExample | None":
        """Show the effect on two plain presses or swings; None if it has no influence there.

        The model without the effect is a spring and damper, or a mass with viscous friction. If the effect is
        one of these two terms, the model has only the other term.

        Args:
            effect: the effect, which may need signals that a plain motion lacks.
            kind: kind of channel of the motion.
        """
        data, model, values = simple_motion(kind)
        if not effect.applies_to(data):
            return None
        if effect.name in {effect.name for effect in model.effects}:
            without = model.without(effect.name).predict(data, values)
            return cls(effect, replace(data, effort=without), model, values)
        made = cls(effect, data, model.with_effect(effect), _visible_parameters(data, model, values, effect))
        return made if np.any(made.effort() != data.effort) else None

    @classmethod
    def on_fitted_motion(cls, fitted: FitResult, effect: Effect) -> "EffectExample":
        """Add an effect to a fitted model, on a few runs of its motion.

        Args:
            fitted: the base model's fit.
            effect: effect to add.
        """
        runs = fitted.data.runs
        moved = fitted.data.of_runs(runs[even_places(len(runs), _RUNS)])
        data = replace(moved, effort=fitted.model.predict(moved, fitted.values))
        values = _visible_parameters(data, fitted.model, dict(fitted.values), effect)
        return cls(effect, data, fitted.model.with_effect(effect), values)

    def effort(self) -> FloatArray:
        """Effort with the effect, shape (n,)."""
        return self.model.predict(self.data, self.values)


def simple_motion(kind: ChannelKind) -> tuple[ChannelData, Model, dict[str, float]]:
    """Make a plain motion, a plain model, and its prediction as the effort.

    Args:
        kind: kind of channel; a contact is pressed twice, to 7.5 mm, and a joint swings by 1 rad or 1 m to
            each side.

    Returns:
        The channel, the model (spring and damper, or mass and viscous friction), and its parameters by name.
    """
    t = np.arange(0.0, _PLAIN_S, _TIME_S)
    rate = 4.0 * np.pi / _PLAIN_S
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
    return replace(data, effort=model.predict(data, values)), model, values


def _visible_parameters(
    data: ChannelData, model: Model, base: Mapping[str, float], effect: Effect
) -> dict[str, float]:
    """Add an effect to a model's parameters, large enough to be seen against the data's effort."""
    starts = effect.starts(data)
    tried = [starts[len(starts) // 2]] if effect.gains else starts[:: -(-len(starts) // _TRIED)]
    start_values = [
        {**base, **{f"{effect.name}.{name}": value for name, value in start.items()}} for start in tried
    ]
    target = _SHARE * _rms(data.effort)
    if not effect.gains:
        with_effect = model.with_effect(effect)
        differ = [_rms(with_effect.predict(data, values) - data.effort) for values in start_values]
        return start_values[int(np.argmin(np.abs(np.array(differ) - target)))]
    values = start_values[0]
    if isinstance(effect, AdditiveEffect):
        for column, gain in zip(effect.columns(data, tried[0]).T, effect.gains, strict=True):
            values[f"{effect.name}.{gain.name}"] = target / length if (length := _rms(column)) > 0.0 else 0.0
            target *= _NEXT
    return values


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # Unicode, block Braille Patterns
_BLANK = 0x2800
Curve = tuple[FloatArray, FloatArray, str]  # x (n,), y (n,), color


def _draw_characters(first: Curve, second: Curve, width: int, height: int) -> list[Text]:
    """Draw two curves in one frame, line by line: the first as points "·", the second in Braille."""
    frame = []
    for axis in (0, 1):
        values = np.concatenate([first[axis], second[axis]])
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        frame.append((low, high if high > low else low + 1.0))
    behind = _raster(first, frame, width, height).reshape(height, 4, width, 2).max(axis=(1, 3))
    dots = _raster(second, frame, width, height).reshape(height, 4, width, 2)
    codes = np.einsum("hdwc,dc->hw", dots.astype(np.int64), _DOTS)
    lines = []
    for row, under in zip(codes.tolist(), behind.tolist(), strict=True):
        cells = [
            (chr(_BLANK + code), second[2]) if code else ("·" if dot else " ", first[2])
            for code, dot in zip(row, under, strict=True)
        ]
        lines.append(Text.assemble(*cells))
    return lines


def _raster(curve: Curve, frame: Sequence[tuple[float, float]], width: int, height: int) -> BoolArray:
    """Return the dots, shape (4 height, 2 width), on a curve that is interpolated between its samples."""
    dots = np.zeros((4 * height, 2 * width), dtype=np.bool_)
    shares = [(values - low) / (high - low) for values, (low, high) in zip(curve[:2], frame, strict=True)]
    across, up = shares[0] * (2 * width - 1), shares[1] * (4 * height - 1)
    steps = np.maximum(np.abs(np.diff(across)), np.abs(np.diff(up)))
    place = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-9))])
    fine = np.linspace(0.0, place[-1], 2 * int(np.ceil(place[-1])) + 2)
    columns, rows = (np.rint(np.interp(fine, place, values)).astype(int) for values in (across, up))
    dots[4 * height - 1 - rows, columns] = True
    return dots


GROUPS = ("Contact", "Joints", "Contact and joints", "Sensor and drive readings", "From run to run")
_TO_MILLI, _ROOMY = 1e3, 100
_TALLEST, _WIDEST, _NARROWEST = 11, 46, 34  # size of a drawing, in characters
_APART = " " * 3  # between two drawings
_ROUNDING = 1e-9  # relative to a range; smaller numbers count as zero


def library() -> tuple[Effect, ...]:
    """Return all effects, ordered by group."""
    every = [effect() for effect in EFFECTS.values()]
    return tuple(sorted(every, key=lambda effect: (GROUPS.index(group_of(effect)), effect.name)))


def kind_of(effect: Effect) -> ChannelKind:
    """Return the kind of channel in which to draw an effect: a contact if it occurs there.

    Args:
        effect: effect of the library or the user's own.
    """
    return next(kind for kind in ChannelKind if kind in effect.channels)


def as_data(effect: Effect) -> dict[str, Any]:
    """Return an effect as plain data, with units for the channel of `kind_of`; the keys are stable.

    Args:
        effect: effect of the library or the user's own.
    """
    words = ("name", "physics", "equation", "source", "signature", "confused_with", "needs")
    kind = kind_of(effect)
    parameters = [
        {"name": parameter.name, "unit": parameter.unit_of(kind), "typical": list(parameter.typical)}
        for parameter in (*effect.gains, *effect.inner)
    ]
    about = {"group": group_of(effect), "channels": _channels(effect), "parameters": parameters}
    return {word: getattr(effect, word) for word in words} | about


def print_library(console: Console, effects: Sequence[Effect]) -> None:
    """Print one table per group: each effect's signature and, if there is room, its similar effects."""
    roomy = console.width >= _ROOMY
    for group in GROUPS:
        chosen = [effect for effect in effects if group_of(effect) == group]
        columns = ("effect", "signature", *(("confused with",) if roomy else ()))
        made = table(group, *columns)
        made.columns[0].no_wrap = True
        for effect in chosen:
            rivals = [safe(", ".join(sorted(effect.confused_with)))] if roomy else []
            made.add_row(f"[bold]{safe(effect.name)}[/bold]", safe(effect.signature), *rivals)
        if chosen:
            console.print(made)


def print_effect(console: Console, effect: Effect, example: EffectExample | None) -> None:
    """Print one effect: physics, equation, signature, drawing, parameters and similar effects.

    Args:
        console: console to print to.
        effect: effect to explain.
        example: example to draw; None for no drawing.
    """
    console.print(f"[bold]{safe(effect.name)}[/bold]  [dim]{safe(', '.join(_channels(effect)))}[/dim]")
    lines = {name: getattr(effect, name) for name in ("physics", "equation", "signature", "source")}
    if effect.needs:
        lines["needs"] = ", ".join(effect.needs)
    console.print(Padding(labeled(*lines.items()), (0, 0, 0, 2)))
    if example is not None and "utf" in console.encoding:
        console.print()
        for line in _draw_example(example, console.width):
            console.print(Padding(line, (0, 0, 0, 2)), no_wrap=True, crop=True)
    made = table("", "parameter", "unit", "typical", right=("typical",))
    for parameter in (*effect.gains, *effect.inner):
        low, high = parameter.typical
        unit = parameter.unit_of(kind_of(effect))
        made.add_row(safe(parameter.name), safe(unit), f"{low:.3g} to {high:.3g}")
    console.print(made)
    if effect.confused_with:
        rivals = table("Often confused with", "effect", "how to distinguish")
        rivals.columns[0].no_wrap = True
        for name, experiment in effect.confused_with.items():
            rivals.add_row(f"[bold]{safe(name)}[/bold]", safe(experiment))
        console.print(rivals)


def _draw_example(example: EffectExample, width: int) -> Iterator[Text]:
    """Draw an example with characters: effort over position or velocity and, if there is room, over time."""
    data, axes = example.data, axes_of(example.data)
    before, after = data.effort, example.effort()
    room = width - 4
    sides = 2 if room >= 2 * _NARROWEST + len(_APART) else 1
    wide = min((room - len(_APART) * (sides - 1)) // sides, _WIDEST)
    # over velocity for a joint's friction that depends on neither position nor history
    signals, over = example.effect.signals, (axes.position, data.position)
    is_of_past = bool({"position", "past motion"} & set(signals))
    if data.kind is not ChannelKind.CONTACT and not is_of_past and signals[0] in {"velocity", "direction"}:
        over = axes.velocity, data.velocity
    in_unit = over[1] * (1.0 if data.kind.is_angle else _TO_MILLI)
    curves = [(f"over {over[0]}", in_unit), ("over time", concatenated_times(data))][:sides]
    ends = np.array([np.min([before, after]), np.max([before, after])])
    low, high = np.where(np.abs(ends) < _ROUNDING * np.ptp(ends), 0.0, ends)
    what = f"{safe(axes.effort)}, {low:.3g} to {high:.3g}:"
    marks = f"[{palette.BASE}]· without it[/], [{palette.MODEL}]⣿ with {safe(example.effect.name)}[/]"
    caption = Text.from_markup(f"{what} {marks}")
    yield from [caption] if caption.cell_len <= room else map(Text.from_markup, (what, marks))
    panels = [
        _draw_characters((x, before, palette.BASE), (x, after, palette.MODEL), wide, _TALLEST)
        for _, x in curves
    ]
    # side by side, each below its title
    wide = max(len(line) for lines in panels for line in lines)
    yield Text(_APART.join(title.ljust(wide) for title, _ in curves), style="dim")
    for lines in zip(*panels, strict=True):
        yield Text(_APART).join(lines)


def _channels(effect: Effect) -> list[str]:
    return [str(kind) for kind in ChannelKind if kind in effect.channels]


def group_of(effect: Effect) -> str:
    """Return the effect's group, one of `GROUPS`.

    Args:
        effect: effect of the library or the user's own.
    """
    if isinstance(effect, RunVariation):
        return "From run to run"
    if isinstance(effect, SensorEffect) or effect.name in {"bias", "drift"}:
        return "Sensor and drive readings"
    if ChannelKind.CONTACT not in effect.channels:
        return "Joints"
    return "Contact" if effect.channels == {ChannelKind.CONTACT} else "Contact and joints"
