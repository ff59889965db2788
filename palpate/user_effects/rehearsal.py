"""Tries an effect of the user's own before a diagnosis relies upon it."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import AdditiveEffect, Effect, Inner, MotionEffect, SensorEffect
from estimation.effects import EFFECTS
from palpate.foreign_code import foreign_code
from palpate.user_effects.guard import wrong_array
from robot_io.errors import InputError
from robot_io.types import FloatArray

_Shape = tuple[int, ...]


def rehearse(effect: Effect, data: ChannelData) -> None:
    """Call each method of a user's effect once on a channel.

    Raises:
        InputError: a method fails there, or gives arrays of the wrong shape, or values that are not real
            numbers or not finite.
    """
    where = f"effect '{effect.name}' on channel '{data.name}'"
    with foreign_code(where):
        if not effect.applies_to(data):
            return
        wrong = _wrong_form(effect) or _wrong_suit(effect, data)
        if wrong:
            raise InputError(f"{where}: {wrong}")
        effect = effect.suited_to(data)
        starts = list(effect.starts(data))
        wrong = _wrong_starts(effect, starts)
        if wrong:
            raise InputError(f"{where}: {wrong}")
        for name, made, shape in _outputs(effect, data, starts[len(starts) // 2]):
            wrong = wrong_array(made, shape)
            if wrong:
                raise InputError(f"{where}: {name} gives {wrong}")
        _judged(effect, data)


def _wrong_form(effect: Effect) -> str | None:
    if not isinstance(effect, (AdditiveEffect, MotionEffect, SensorEffect)):
        return "derive it from AdditiveEffect, MotionEffect or SensorEffect"
    for parameter in (*effect.gains, *effect.inner):
        if not (parameter.lower < parameter.upper and parameter.typical[0] <= parameter.typical[1]):
            bounds = (
                f"bounds {parameter.lower:g} and {parameter.upper:g} and typical range {parameter.typical}"
            )
            return f"{bounds} of parameter '{parameter.name}' are not in ascending order"
    return None


def _wrong_suit(effect: Effect, data: ChannelData) -> str | None:
    suited = effect.suited_to(data)
    if isinstance(suited, Effect) and suited.name == effect.name:
        return None
    return f"suited_to gives {suited!r}, wanted is an effect of the same name"


def _wrong_starts(effect: Effect, starts: Sequence[Inner]) -> str | None:
    """Whether there is a value for each inner parameter."""
    wanted = {parameter.name for parameter in effect.inner}
    if starts and all(set(start) == wanted for start in starts):
        return None
    return f"starts gives {starts[:1]}, wanted are values for {', '.join(sorted(wanted)) or 'nothing: ({},)'}"


def _outputs(effect: Effect, data: ChannelData, inner: Inner) -> Iterator[tuple[str, FloatArray, _Shape]]:
    """What an effect makes of a channel: the method, its array, and the shape that this should have."""
    count = len(data)
    match effect:
        case AdditiveEffect():
            columns = effect.columns(data, inner)
            yield "columns", columns, (count, len(effect.gains))
            yield "known", effect.known(data, inner), (count,)
            simpler = effect.simpler(_frozen(columns))
            yield "simpler", simpler, (count, min(np.shape(simpler)[-1], len(effect.gains)))
        case MotionEffect():
            moved = effect.move(data, inner)
            for what in ("position", "velocity", "acceleration", "effort"):
                yield f"{what} of move", getattr(moved, what), (count,)
        case SensorEffect():
            columns = _frozen(np.column_stack([data.effort, np.ones(count)]))
            yield "sense", effect.sense(data.effort, data, inner), (count,)
            yield "slope", effect.slope(data.effort, columns, data, inner), (count, 2)
            slopes, sensed = effect.follow(data.effort, columns, data, inner)
            yield "slopes of follow", slopes, (count, 2)
            yield "effort of follow", sensed, (count,)


def _judged(effect: Effect, data: ChannelData) -> None:
    """Ask for its name beside all other effects, each parameter in the middle of its typical range."""
    usual = _usual(*(EFFECTS[name]() for name in EFFECTS), effect)
    noise = 0.01 * float(np.std(data.effort))
    effect.is_misnamed(data, usual, lambda: {name: 0.1 * abs(value) for name, value in usual.items()}, noise)


def _usual(*effects: Effect) -> Mapping[str, float]:
    parameters = ((effect.name, p) for effect in effects for p in (*effect.gains, *effect.inner))
    return {f"{name}.{p.name}": float(p.spread(3)[1]) for name, p in parameters}


def _frozen(values: FloatArray) -> FloatArray:
    view = np.asarray(values).view()
    view.setflags(write=False)
    return view
