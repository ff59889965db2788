"""Loads an effect from a file of the user's own."""

import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import AdditiveEffect, Effect, MotionEffect, SensorEffect
from palpate.files import existing_file
from palpate.foreign_code import foreign_code
from robot_io.errors import InputError
from robot_io.types import FloatArray

FORM = "FILE.py:Class"
STATED = ("name", "physics", "equation", "source", "signature", "channels")


def load_user_effect(text: str) -> Effect:
    """The effect that the user names on the command line.

    Args:
        text: of the form FILE.py:Class.

    Raises:
        InputError: file or class is not there, cannot be run, or states no effect.
    """
    file, _, name = text.rpartition(":")
    if not file or not name.isidentifier():
        raise InputError(f"--effect {text!r}: give file and class, such as my_effects.py:MyEffect ({FORM})")
    module = _run(existing_file(Path(file), "effect file"))
    found = vars(module).get(name)
    if not (inspect.isclass(found) and issubclass(found, Effect)):
        there = ", ".join(key for key, value in vars(module).items() if _is_effect(value, module))
        raise InputError(f"--effect {text}: no effect is called '{name}' there. There are: {there or 'none'}")
    return _checked(text, found)


def rehearse(effect: Effect, data: ChannelData) -> None:
    """Try a user's effect on a channel before it is relied upon.

    Raises:
        InputError: it fails there, or gives arrays of the wrong shape or values that are not finite.
    """
    where = f"effect '{effect.name}' on channel '{data.name}'"
    if not effect.applies_to(data):
        return
    with foreign_code(where):
        outputs = _outputs(effect, data)
    for name, made, shape in outputs:
        if np.shape(made) != shape:
            raise InputError(f"{where}: {name} gives an array of shape {np.shape(made)}, wanted is {shape}")
        if not np.isfinite(made).all():
            raise InputError(f"{where}: {name} gives values that are not finite")


def _outputs(effect: Effect, data: ChannelData) -> list[tuple[str, FloatArray, tuple[int, ...]]]:
    """What an effect makes of a channel: the method, its array, and the shape that this should have."""
    inner = effect.starts(data)[0]
    match effect:
        case AdditiveEffect():
            columns = ("columns", effect.columns(data, inner), (len(data), len(effect.gains)))
            return [columns, ("known", effect.known(data, inner), (len(data),))]
        case MotionEffect():
            return [("move", effect.move(data, inner).position, (len(data),))]
        case SensorEffect():
            return [("sense", effect.sense(data.effort, data, inner), (len(data),))]
    raise TypeError("derive it from AdditiveEffect, MotionEffect or SensorEffect")


def _run(file: Path) -> ModuleType:
    name = f"palpate_user_effect_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise InputError(f"effect file {file}: is no Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    with foreign_code(f"effect file {file}"):
        spec.loader.exec_module(module)
    return module


def _is_effect(value: Any, module: ModuleType) -> bool:  # noqa: ANN401
    return inspect.isclass(value) and issubclass(value, Effect) and value.__module__ == module.__name__


def _checked(text: str, found: type[Effect]) -> Effect:
    missing = [what for what in STATED if not hasattr(found, what)]
    if missing:
        raise InputError(
            f"--effect {text}: states no {', '.join(missing)} (estimation/effects/bias.py is a short example)"
        )
    with foreign_code(f"--effect {text}: cannot be made"):
        return found()
