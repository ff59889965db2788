"""Whether an effect of the user's own states what it is in the form that everything else relies upon."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from estimation.channel import ChannelKind
from estimation.effect import AdditiveEffect, Effect, MemoryEffect, MotionEffect, Parameter, SensorEffect

STATED = ("name", "physics", "equation", "source", "signature", "channels")
_TEXTS = STATED[1:-1]
_NAME = re.compile(r"[a-z][a-z0-9_]*")


def flaw(found: type[Effect]) -> str | None:
    """What is wrong with what a class states, in a few words; None if nothing is."""
    return next(_flaws(found), None)


def _flaws(found: Any) -> Iterator[str]:  # noqa: ANN401, it may state anything
    missing = [what for what in STATED if not hasattr(found, what)]
    if missing:
        yield f"states no {', '.join(missing)} (estimation/effects/bias.py is a short example)"
        return
    if not (isinstance(found.name, str) and _NAME.fullmatch(found.name)):
        yield f"its name is {found.name!r}; wanted are small letters, digits and _, such as 'my_effect'"
    for what in _TEXTS:
        if not isinstance(text := getattr(found, what), str):
            yield f"its {what} is {text!r}, wanted is text"
    if not (isinstance(found.channels, set | frozenset) and _all(found.channels, ChannelKind)):
        yield f"its channels are {found.channels!r}, wanted is frozenset({{ChannelKind.CONTACT}}) or the like"
    for what, kind in (("gains", Parameter), ("inner", Parameter), ("needs", str), ("essential", str)):
        if not (isinstance(made := getattr(found, what), tuple | list) and _all(made, kind)):
            yield f"its {what} are {made!r}, wanted is a tuple of {kind.__name__}"
            return
    if not issubclass(found, AdditiveEffect | MotionEffect | MemoryEffect | SensorEffect):
        yield "derive it from AdditiveEffect, MotionEffect, MemoryEffect or SensorEffect"
    for one in (*found.gains, *found.inner):
        yield from _flaws_of_parameter(one)
    rivals = found.confused_with
    if not (isinstance(rivals, Mapping) and all(isinstance(n, str) and n.isidentifier() for n in rivals)):
        yield f"its confused_with is {rivals!r}, wanted is a dict of experiments by effect"


def _flaws_of_parameter(one: Parameter) -> Iterator[str]:
    if not (one.lower < one.upper and one.typical[0] <= one.typical[1]):
        bounds = f"bounds {one.lower:g} and {one.upper:g} and typical range {one.typical}"
        yield f"{bounds} of parameter '{one.name}' are not in ascending order"
    if not (isinstance(one.name, str) and one.name.isidentifier()):
        yield f"a parameter's name is {one.name!r}, wanted are letters, digits and _"


def _all(made: Any, kind: type) -> bool:  # noqa: ANN401
    return all(isinstance(one, kind) for one in made)
