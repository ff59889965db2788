"""Watches over a user's effect while a search calls it at parameters that no rehearsal came to."""

from collections.abc import Callable
from typing import Any

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Effect
from palpate.foreign_code import foreign_code
from robot_io.errors import InputError
from robot_io.types import FloatArray

_CALLED = (
    *("columns", "known", "simpler", "move", "sense", "slope", "follow", "starts", "is_misnamed"),
    *("applies_to", "suited_to"),
)
_REAL = "fiub"  # kinds of dtype: floats, whole numbers, truth values


def guarded(found: type[Effect]) -> type[Effect]:
    """The class, of which every method says whose it is where it fails or gives what cannot be used.

    Args:
        found: an effect; its methods then raise an `InputError` and nothing else.
    """

    def watched(method: str) -> Callable[..., Any]:
        def call(effect: Effect, *args: Any, **by_name: Any) -> Any:  # noqa: ANN401
            channel = next((a for a in args if isinstance(a, ChannelData)), None)
            where = f"effect '{effect.name}'" + (f" on channel '{channel.name}'" if channel else "")
            with foreign_code(where):
                made = getattr(super(telling, effect), method)(*args, **by_name)
                shape = _wanted(effect, method, args)
                wrong = wrong_array(made, shape) if shape else None
            if wrong:
                raise InputError(f"{where}: {method} gives {wrong}, at {dict(args[-1])}")
            return made

        return call

    methods = {method: watched(method) for method in _CALLED if hasattr(found, method)}
    telling: type[Effect] = type(found.__name__, (found,), {**methods, "__module__": found.__module__})
    return telling


def _wanted(effect: Effect, method: str, args: tuple[Any, ...]) -> tuple[int, ...] | None:
    """The shape of what a method gives; None where that is no array, or the rehearsal has seen to it."""
    match method, args:
        case "columns", (ChannelData() as data, *_):
            return len(data), len(effect.gains)
        case "known", (ChannelData() as data, *_):
            return (len(data),)
        case "sense", (np.ndarray() as effort, *_):
            return tuple(int(count) for count in effort.shape)
    return None


def wrong_array(made: FloatArray, shape: tuple[int, ...]) -> str | None:
    """What is wrong with an array that a user's effect made, in words; None if nothing is.

    Args:
        made: the array.
        shape: that it should have.
    """
    kind = np.asarray(made).dtype
    if kind.kind not in _REAL:
        return f"values of type {kind}, wanted are real numbers"
    if np.shape(made) != shape:
        return f"an array of shape {np.shape(made)}, wanted is {shape}"
    if not np.isfinite(made).all():
        return "values that are not finite"
    return None
