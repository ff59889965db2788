"""Whether an effect of the user's own states what it is in the form that everything else relies upon."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from estimation.channel import ChannelKind
from estimation.effect import Effect, Parameter

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
    for name in (parameter.name for parameter in (*found.gains, *found.inner)):
        if not (isinstance(name, str) and name.isidentifier()):
            yield f"a parameter's name is {name!r}, wanted are letters, digits and _"
    rivals = found.confused_with
    if not (isinstance(rivals, Mapping) and all(isinstance(n, str) and n.isidentifier() for n in rivals)):
        yield f"its confused_with is {rivals!r}, wanted is a dict of experiments by effect"


def _all(made: Any, kind: type) -> bool:  # noqa: ANN401
    return all(isinstance(one, kind) for one in made)
