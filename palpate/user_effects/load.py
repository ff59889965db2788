"""Loads effects from files of the user's own."""

import importlib.util
import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from estimation.effect import Effect
from estimation.effects import EFFECTS
from palpate.common.files import existing_file
from palpate.common.foreign_code import LIMIT_S, foreign_code
from palpate.user_effects.guard import file_of, flaw, watched
from robot_io.errors import InputError

FORM = "FILE.py:Class"


def load_user_effects(texts: Sequence[str]) -> dict[str, Effect]:
    """The effects that the user names, by how they were named.

    Args:
        texts: each of the form FILE.py:Class.

    Raises:
        InputError: a file or class is not there, cannot be run, states no effect, or one whose name is taken.
    """
    loaded: dict[str, Effect] = {}
    for text in dict.fromkeys(texts):
        effect = load_user_effect(text)
        taken = "palpate" if effect.name in EFFECTS else ""
        taken = next((place for place, other in loaded.items() if other.name == effect.name), taken)
        if taken:
            raise InputError(
                f"--effect {text}: the name '{effect.name}' is taken by an effect of {taken}; "
                "give the class another name"
            )
        loaded[text] = effect
    return loaded


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


def _run(file: Path) -> ModuleType:
    name = f"palpate_user_effect_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise InputError(f"effect file {file}: is no Python file (.py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    with foreign_code(f"effect file {file}", LIMIT_S, str(file.absolute())):
        spec.loader.exec_module(module)
    return module


def _is_effect(value: Any, module: ModuleType) -> bool:  # noqa: ANN401
    return inspect.isclass(value) and issubclass(value, Effect) and value.__module__ == module.__name__


def _checked(text: str, found: type[Effect]) -> Effect:
    with foreign_code(f"--effect {text}", own_file=file_of(found)):
        wrong = flaw(found)
    if wrong:
        raise InputError(f"--effect {text}: {wrong}")
    with foreign_code(f"--effect {text}: cannot be made", LIMIT_S, file_of(found)):
        return watched(found())
