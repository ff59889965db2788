"""Load, check, test and run the user's own effects and drivers."""

import importlib.util
import inspect
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from palpate.common.files import existing_file
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.units import LARGEST_NUMBER
from palpate.estimation.effect import (
    SIGNALS,
    AdditiveEffect,
    Effect,
    MemoryEffect,
    MotionEffect,
    Parameter,
    SensorEffect,
)
from palpate.estimation.effects import EFFECTS
from palpate.robot_io.errors import InputError, describe_error
from palpate.robot_io.types import FloatArray

LIMIT_S = 10.0  # for loading, and for trying each method once [s]


class _TooLongError(BaseException):
    """Raised within the user's code by the timer; `except Exception` does not catch it."""


@contextmanager
def user_code(where: str, limit_s: float | None = None, own_file: str = "") -> Iterator[None]:
    """Convert errors of the user's code, including `SystemExit`, into `InputError`; Ctrl-C passes through.

    Output of the code goes to stderr, because stdout is for results that a program may read.

    Args:
        where: name of the code that runs, for the error message.
        limit_s: time limit, in the main thread only [s]; None for no limit.
        own_file: the user's file, whose line the error names.

    Raises:
        InputError: the code failed, or took too long.
    """
    try:
        with redirect_stdout(sys.stderr), _limited(limit_s):
            yield
    except _TooLongError as error:
        raise InputError(f"{where}: did not end within {error} s; does it wait or loop?") from None
    except (KeyboardInterrupt, InputError):
        raise
    except BaseException as error:
        raise InputError(f"{where}: {describe_error(error, own_file)}") from error


@contextmanager
def _limited(limit_s: float | None) -> Iterator[None]:
    if limit_s is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: object) -> None:
        raise _TooLongError(f"{limit_s:g}")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def load_user_effects(texts: Sequence[str]) -> dict[str, Effect]:
    """Load the user's effects; return them by the texts that name them.

    Args:
        texts: each of the form FILE.py:Class.

    Raises:
        InputError: a file or class does not exist, cannot be run or is not an effect, or its name is taken.
    """
    loaded: dict[str, Effect] = {}
    for text in dict.fromkeys(texts):
        effect = _load_user_effect(text)
        taken = "palpate" if effect.name in EFFECTS else ""
        taken = next((place for place, known in loaded.items() if known.name == effect.name), taken)
        if taken:
            raise InputError(
                f"--effect {text}: the name '{effect.name}' is taken by an effect of {taken}; "
                "give the class another name"
            )
        loaded[text] = effect
    return loaded


def _load_user_effect(text: str) -> Effect:
    """Load an effect that the user names on the command line."""
    file, _, name = text.rpartition(":")
    if not file or not name.isidentifier():
        raise InputError(
            f"--effect {text!r}: give a file and a class, such as my_effects.py:MyEffect (FILE.py:Class)"
        )
    path = existing_file(Path(file), "effect file")
    spec = importlib.util.spec_from_file_location(f"palpate_user_effect_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"effect file {path}: is not a Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module
    with user_code(f"effect file {path}", LIMIT_S, str(path.absolute())):
        spec.loader.exec_module(module)
    member = vars(module).get(name)
    if not (inspect.isclass(member) and issubclass(member, Effect)):
        classes = [(key, value) for key, value in vars(module).items() if inspect.isclass(value)]
        own = [
            key for key, value in classes if issubclass(value, Effect) and value.__module__ == module.__name__
        ]
        names = ", ".join(own)
        raise InputError(f"--effect {text}: no effect is called '{name}' there. Available: {names or 'none'}")
    with user_code(f"--effect {text}", own_file=file_of(member)):
        attribute, wrong = next(_flaws(member), ("", ""))
    if wrong:
        raise InputError(f"--effect {text}: {wrong}{place_of(member, attribute)}")
    with user_code(f"--effect {text}: cannot be created", LIMIT_S, file_of(member)):
        return guarded(member())


STATED = ("name", "physics", "equation", "source", "signature")
_NAME = re.compile(r"[a-z][a-z0-9_]*")


def file_of(effect_type: type) -> str:
    """Return the path of the file that defines a class; empty if there is none."""
    try:
        return inspect.getsourcefile(effect_type) or ""
    except (OSError, TypeError):
        return ""


def place_of(effect_type: type, attribute: str) -> str:
    """Return where a class defines a name, such as " (mine.py, line 14)", or else where the class begins.

    Args:
        effect_type: a class.
        attribute: name of the attribute or method; empty for the class itself.
    """
    try:
        lines, first = inspect.getsourcelines(effect_type)
    except (OSError, TypeError):
        return ""
    defines = re.compile(rf"    (?:def )?{re.escape(attribute)}\b\s*[(:=]")
    defined = (number for number, text in enumerate(lines, first) if attribute and defines.match(text))
    return f" ({Path(file_of(effect_type)).name}, line {next(defined, first)})"


def _flaws(effect_type: Any) -> Iterator[tuple[str, str]]:  # noqa: ANN401, it may state anything
    """Yield attributes with their errors."""
    missing = [what for what in STATED if not hasattr(effect_type, what)]
    if missing:
        yield "", f"does not state {', '.join(missing)}; see Bias in estimation/effects/sensor_statics.py"
        return
    if not (isinstance(effect_type.name, str) and _NAME.fullmatch(effect_type.name)):
        expected = "expected lower-case letters, digits and _, such as 'my_effect'"
        yield "name", f"its name is {effect_type.name!r}; {expected}"
    for what in STATED[1:]:
        if not isinstance(text := getattr(effect_type, what), str):
            yield what, f"its {what} is {text!r}, expected text"
    if not (isinstance(effect_type.channels, set | frozenset) and _all(effect_type.channels, ChannelKind)):
        kinds = ", ".join(f"ChannelKind.{kind.name}" for kind in ChannelKind)
        yield (
            "channels",
            f"its channels are {effect_type.channels!r}, expected a frozenset of some of {kinds}",
        )
    for what, kind in (("gains", Parameter), ("inner", Parameter), ("needs", str), ("essential", str)):
        if not (isinstance(made := getattr(effect_type, what), tuple | list) and _all(made, kind)):
            yield what, f"its {what} are {made!r}, expected a tuple of {kind.__name__}"
            return
    if not issubclass(effect_type, AdditiveEffect | MotionEffect | MemoryEffect | SensorEffect):
        yield "", "derive the class from AdditiveEffect, MotionEffect, MemoryEffect or SensorEffect"
    yield from _parameter_flaws(effect_type)
    if not isinstance(effect_type.signals, tuple | list):
        yield "signals", f"its signals are {effect_type.signals!r}, expected a tuple of {', '.join(SIGNALS)}"
    elif unknown := [str(signal) for signal in effect_type.signals if signal not in SIGNALS]:
        yield "signals", f"its signals contain {', '.join(unknown)}. Valid: {', '.join(SIGNALS)}"
    rivals = effect_type.confused_with
    if not (isinstance(rivals, Mapping) and all(isinstance(n, str) and n.isidentifier() for n in rivals)):
        expected = "expected a dict from an effect's name to an experiment"
        yield "confused_with", f"its confused_with is {rivals!r}, {expected}"


def _parameter_flaws(effect_type: type[Effect]) -> Iterator[tuple[str, str]]:
    """Yield `gains` or `inner` with each error in a parameter."""
    pairs = [(group, p) for group in ("gains", "inner") for p in getattr(effect_type, group)]
    for what, p in pairs:
        if not p.lower < p.upper:
            bounds = f"the bounds of parameter '{p.name}', {p.lower:g} and {p.upper:g},"
            yield what, f"{bounds} are not in ascending order"
        elif not p.typical[0] <= p.typical[1]:
            yield what, f"the typical range of parameter '{p.name}', {p.typical}, is not in ascending order"
        elif not p.lower <= p.typical[0] <= p.typical[1] <= p.upper:
            yield (
                what,
                f"typical range {p.typical} of parameter '{p.name}' exceeds its bounds {p.lower:g} and "
                f"{p.upper:g}",
            )
        if not (isinstance(p.name, str) and p.name.isidentifier()):
            yield what, f"a parameter's name is {p.name!r}, expected letters, digits and _"
        try:
            p.unit_of(ChannelKind.CONTACT)
        except (AttributeError, IndexError, KeyError, ValueError):
            valid = "{effort}, {position} and {inertia}"
            yield what, f"unit {p.unit!r} of parameter '{p.name}': valid placeholders are {valid}"


def _all(made: Any, kind: type) -> bool:  # noqa: ANN401
    return all(isinstance(element, kind) for element in made)


_CALLED = (
    *("columns", "known", "simpler", "move", "fade", "sense", "slope", "follow", "starts", "is_misnamed"),
    *("applies_to", "suited_to", "in_order"),
)
_MOTION = ("position", "velocity", "acceleration", "effort")
_REAL = "fiub"  # kinds of dtype: floats, integers, booleans
_Shape = tuple[int, ...]


def guarded(effect: Effect) -> Effect:
    """Wrap an effect so that its methods raise `InputError` on failure or unusable results.

    Args:
        effect: effect from the user.
    """
    effect_type = type(effect)

    def watch(method: str) -> Callable[..., Any]:
        def call(effect: Effect, *args: Any, **by_name: Any) -> Any:  # noqa: ANN401
            channel = next((a for a in args if isinstance(a, ChannelData)), None)
            where = f"effect '{effect.name}'" + (f" on channel '{channel.name}'" if channel else "")
            with user_code(where, own_file=file_of(effect_type)):
                made = getattr(super(watching, effect), method)(*args, **by_name)
                made = tuple(made) if method == "starts" else made
                wrong = _flaw(effect, method, args, made)
            if wrong:
                at = f", at {dict(args[-1])}" if args and isinstance(args[-1], Mapping) and args[-1] else ""
                raise InputError(f"{where}: {wrong}{at}{place_of(effect_type, method)}")
            return made

        return call

    methods = {method: watch(method) for method in _CALLED if hasattr(effect_type, method)}
    watching: type[Effect] = type(
        effect_type.__name__, (effect_type,), {**methods, "__module__": effect_type.__module__}
    )
    made = object.__new__(watching)
    vars(made).update(vars(effect))
    return made


def try_effect(effect: Effect, data: ChannelData) -> bool | None:
    """Call each method of a guarded effect on a channel once, before a search uses it.

    Args:
        effect: the user's effect, whose methods are guarded.
        data: channel to which a model with the effect would be fitted.

    Returns:
        Whether the effect changes the prediction: False if its columns are zero at all starting values of a
        search; None if the effect does not apply to the channel.

    Raises:
        InputError: a method fails, or returns an unusable result.
    """
    applies = effect.applies_to(data)
    if not isinstance(applies, bool | np.bool_):
        raise InputError(
            f"effect '{effect.name}': applies_to() returns {type(applies).__name__}, expected a bool"
            f"{place_of(type(effect), 'applies_to')}"
        )
    if not applies:
        return None
    effect, acts = effect.suited_to(data), True
    starts = list(effect.starts(data))
    inner, both = starts[len(starts) // 2], _frozen(np.column_stack([data.effort, np.ones(len(data))]))
    match effect:
        case AdditiveEffect():
            effect.known(data, inner)
            columns = effect.columns(data, inner)
            effect.simpler(_frozen(columns))
            if not np.array_equal(columns, effect.columns(data, inner)):
                raise InputError(
                    f"effect '{effect.name}': columns() returns different values when called again; it must "
                    f"depend only on the data and the inner parameters{place_of(type(effect), 'columns')}"
                )
            acts = any(np.any(effect.columns(data, start)) for start in starts)
        case MotionEffect():
            effect.move(data, inner)
        case MemoryEffect():
            effect.fade(both, data, inner)
        case SensorEffect():
            effect.sense(data.effort, data, inner)
            effect.slope(data.effort, both, data, inner)
            effect.follow(data.effort, both, data, inner)
    known = [*(EFFECTS[name]() for name in EFFECTS), effect]
    parameters = ((each.name, p) for each in known for p in (*each.gains, *each.inner))
    # each parameter in the middle of its typical range
    usual = {f"{name}.{p.name}": float(p.spread(3)[1]) for name, p in parameters}
    noise = 0.01 * float(np.std(data.effort))
    effect.is_misnamed(data, usual, lambda: {name: 0.1 * abs(value) for name, value in usual.items()}, noise)
    return acts


def _flaw(effect: Effect, method: str, args: tuple[Any, ...], made: Any) -> str | None:  # noqa: ANN401
    """Describe the error in a method's result; None if there is none."""
    if method == "suited_to" and not (isinstance(made, Effect) and made.name == effect.name):
        return f"suited_to() returns {made!r}, expected an effect of the same name"
    names = {parameter.name for parameter in effect.inner}
    if method == "starts" and not (made and all(set(start) == names for start in made)):
        values = ", ".join(sorted(names)) or "nothing: ({},)"
        return f"starts() returns {list(made[:1])}, expected values for {values}"
    for what, array, shape in _arrays(effect, method, args, made):
        kind = np.asarray(array).dtype
        wrong = ""
        if kind.kind not in _REAL:
            wrong = f"values of type {kind}, expected real numbers"
        elif np.shape(array) != shape:
            wrong = f"an array of shape {np.shape(array)}, expected {shape}"
        elif not np.isfinite(array).all():
            wrong = "values that are not finite"
        elif np.any(np.abs(array) > LARGEST_NUMBER):
            wrong = f"values beyond {LARGEST_NUMBER:g}"
        if wrong:
            return f"{what}() returns {wrong}"
    return None


def _arrays(
    effect: Effect,
    method: str,
    args: tuple[Any, ...],
    made: Any,  # noqa: ANN401, as the user's code has it
) -> Iterator[tuple[str, FloatArray, _Shape]]:
    """Yield name, array and expected shape of each array in a method's result."""
    match method, args:
        case "columns", (ChannelData() as data, *_):
            yield method, made, (len(data), len(effect.gains))
        case "known", (ChannelData() as data, *_):
            yield method, made, (len(data),)
        case "simpler", (np.ndarray() as columns, *_):
            yield method, made, (len(columns), min(np.shape(made)[-1], len(effect.gains)))
        case "move", (ChannelData() as data, *_):
            yield from ((f"{what} of move", getattr(made, what), (len(data),)) for what in _MOTION)
        case "fade", (np.ndarray() as elastic, *_):
            yield method, made, elastic.shape
        case "sense", (np.ndarray() as effort, *_):
            yield method, made, effort.shape
        case "slope", (_, np.ndarray() as columns, *_):
            yield method, made, columns.shape
        case "follow", (np.ndarray() as effort, np.ndarray() as columns, *_):
            yield "slopes of follow", made[0], columns.shape
            yield "effort of follow", made[1], effort.shape


def _frozen(values: FloatArray) -> FloatArray:
    view = np.asarray(values).view()
    view.setflags(write=False)
    return view
