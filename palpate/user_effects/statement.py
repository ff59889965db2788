"""Whether an effect of the user's own states what it is in the form that everything else relies upon."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from estimation.channel import ChannelKind
from estimation.effect import AdditiveEffect, Effect, MemoryEffect, MotionEffect, Parameter, SensorEffect

STATED = ("name", "physics", "equation", "source", "signature", "channels")
_TEXTS = STATED[1:-1]
_NAME = re.compile(r"[a-z][a-z0-9_]*")


def flaw(found: type[Effect]) -> str | None:
    """What is wrong with what a class states, and in which line; None if nothing is."""
    return next((problem + place_of(found, attribute) for attribute, problem in _flaws(found)), None)


def file_of(found: type) -> str:
    """Path of the file that a class is written in; empty if there is none."""
    try:
        return inspect.getsourcefile(found) or ""
    except (OSError, TypeError):
        return ""


def place_of(found: type, attribute: str) -> str:
    """Where a class states an attribute or method, or else begins, such as " (mine.py, line 14)"."""
    try:
        lines, first = inspect.getsourcelines(found)
        (made,) = ast.parse(textwrap.dedent("".join(lines))).body
    except (OSError, TypeError, SyntaxError, ValueError):
        return ""
    line = first
    for node in made.body if isinstance(made, ast.ClassDef) else ():
        names = [getattr(target, "id", "") for target in getattr(node, "targets", [])]
        names += [getattr(getattr(node, "target", None), "id", ""), getattr(node, "name", "")]
        if attribute and attribute in names:
            line = first + node.lineno - 1
    return f" ({Path(file_of(found)).name}, line {line})"


def _flaws(found: Any) -> Iterator[tuple[str, str]]:  # noqa: ANN401, it may state anything
    """Attributes with what is wrong with each."""
    missing = [what for what in STATED if not hasattr(found, what)]
    if missing:
        yield "", f"states no {', '.join(missing)}; estimation/effects/bias.py is a short example"
        return
    if not (isinstance(found.name, str) and _NAME.fullmatch(found.name)):
        problem = f"its name is {found.name!r}; wanted are small letters, digits and _, such as 'my_effect'"
        yield "name", problem
    for what in _TEXTS:
        if not isinstance(text := getattr(found, what), str):
            yield what, f"its {what} is {text!r}, wanted is text"
    if not (isinstance(found.channels, set | frozenset) and _all(found.channels, ChannelKind)):
        kinds = ", ".join(f"ChannelKind.{kind.name}" for kind in ChannelKind)
        yield "channels", f"its channels are {found.channels!r}, wanted is a frozenset of some of {kinds}"
    for what, kind in (("gains", Parameter), ("inner", Parameter), ("needs", str), ("essential", str)):
        if not (isinstance(made := getattr(found, what), tuple | list) and _all(made, kind)):
            yield what, f"its {what} are {made!r}, wanted is a tuple of {kind.__name__}"
            return
    if not issubclass(found, AdditiveEffect | MotionEffect | MemoryEffect | SensorEffect):
        yield "", "derive it from AdditiveEffect, MotionEffect, MemoryEffect or SensorEffect"
    for what in ("gains", "inner"):
        yield from ((what, problem) for each in getattr(found, what) for problem in _flaws_of_parameter(each))
    rivals = found.confused_with
    if not (isinstance(rivals, Mapping) and all(isinstance(n, str) and n.isidentifier() for n in rivals)):
        yield "confused_with", f"its confused_with is {rivals!r}, wanted is a dict of experiments by effect"


def _flaws_of_parameter(one: Parameter) -> Iterator[str]:
    if not (one.lower < one.upper and one.typical[0] <= one.typical[1]):
        bounds = f"bounds {one.lower:g} and {one.upper:g} and typical range {one.typical}"
        yield f"{bounds} of parameter '{one.name}' are not in ascending order"
    if not (isinstance(one.name, str) and one.name.isidentifier()):
        yield f"a parameter's name is {one.name!r}, wanted are letters, digits and _"


def _all(made: Any, kind: type) -> bool:  # noqa: ANN401
    return all(isinstance(one, kind) for one in made)
