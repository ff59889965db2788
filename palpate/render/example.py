"""What an effect looks like: a model without it and with it, on a plain motion or on the user's own."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Effect
from estimation.effects import EFFECTS
from estimation.fit.fit_result import FitResult
from estimation.model import Model
from robot_io.types import FloatArray

_TIME_S, _PLAIN_S = 0.01, 2.0  # step and length of the plain motion
_SHARE = 0.35  # of the effort without it, that an effect is drawn with
_NEXT = 1.0 / 3.0  # of each gain's share that the next one has: alike, they could cancel
_TRIED = 8  # starts of an effect without gains
_RUNS = 3  # of the user's motion that are simulated
_PLAIN = {"stiffness.k": 500.0, "damping.c": 4.0, "inertia.m": 0.02, "viscous_friction.d": 0.3}


@dataclass
class Example:
    """A model with an effect beside the same model without it."""

    effect: Effect  # that is shown
    data: ChannelData  # the motion; its effort (n,) is that without the effect
    model: Model  # with the effect
    # Of all its parameters by "effect.parameter", of a size that is well seen; they may be changed.
    values: dict[str, float]

    @classmethod
    def plain(cls, effect: Effect, kind: ChannelKind) -> "Example | None":
        """The effect on two plain presses or swings; None where that shows nothing of it.

        Beside a spring and damper, or a mass with viscous friction; if it is one of these, beside the other.
        """
        data, model, values = plain(kind)
        if not effect.applies_to(data):
            return None
        if effect.name in {effect.name for effect in model.effects}:
            without = model.without(effect.name).predict(data, values)
            return cls(effect, replace(data, effort=without), model, values)
        made = cls(effect, data, model.with_effect(effect), sized(data, model, values, effect))
        return made if np.any(made.effort() != data.effort) else None

    @classmethod
    def beside(cls, fitted: FitResult, effect: Effect) -> "Example":
        """The effect added to a fitted model, on a few runs of its motion."""
        there = fitted.data.runs
        few = there[np.unique(np.linspace(0, len(there) - 1, _RUNS).astype(int))]
        moved = fitted.data.of_runs(few)
        data = replace(moved, effort=fitted.model.predict(moved, fitted.values))
        values = sized(data, fitted.model, dict(fitted.values), effect)
        return cls(effect, data, fitted.model.with_effect(effect), values)

    def effort(self) -> FloatArray:
        """Effort with the effect, shape (n,)."""
        return self.model.predict(self.data, self.values)


def plain(kind: ChannelKind) -> tuple[ChannelData, Model, dict[str, float]]:
    """A plain motion, two presses or swings, a plain model of it, and that model's parameters."""
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


def sized(data: ChannelData, model: Model, base: Mapping[str, float], effect: Effect) -> dict[str, float]:
    """Parameters of a model with one effect more, of a size that is well seen beside the data's effort."""
    starts = effect.starts(data)
    tried = [starts[len(starts) // 2]] if effect.gains else starts[:: -(-len(starts) // _TRIED)]
    of_start = [{**base, **{f"{effect.name}.{name}": value for name, value in one.items()}} for one in tried]
    wanted = _SHARE * _rms(data.effort)
    if not effect.gains:
        with_effect = model.with_effect(effect)
        differ = [_rms(with_effect.predict(data, values) - data.effort) for values in of_start]
        return of_start[int(np.argmin(np.abs(np.array(differ) - wanted)))]
    values = of_start[0]
    if isinstance(effect, AdditiveEffect):
        for column, gain in zip(effect.columns(data, tried[0]).T, effect.gains, strict=True):
            values[f"{effect.name}.{gain.name}"] = wanted / length if (length := _rms(column)) > 0.0 else 0.0
            wanted *= _NEXT
    return values


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
