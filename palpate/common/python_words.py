"""Says in Python's words what errors say in options of the command line: `units=` for `--unit`."""

import inspect
import re
import shlex
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from robot_io.errors import PalpateError

_PAIRS = {"unit": "units", "column": "columns", "where": "where"}
_LISTS = {"context": "context", "effect": "effects"}
_NUMBERS = {"runs": "runs", "from": "start", "revision": "revision"}
_TEXTS = {"model": "model", "channel": "channel", "urdf": "arm"}
_FLAGS = {"fresh-runs": "fresh", "fresh": "fresh", "apply": "apply"}
_KEYWORDS = _LISTS | _NUMBERS | _TEXTS
_WORD = r"""(?:'[^']*'|"[^"]*"|[^\s'",;:()])+(?:,\d+)*"""
_OPTION = re.compile(
    rf"--(?P<pair>{'|'.join(_PAIRS)})(?: (?P<key>[\w ]+?)=(?P<value>{_WORD}))?(?![\w-])"
    rf"|--(?P<flag>{'|'.join(_FLAGS)})(?![\w-])"
    # What follows such an option is its value only where the text goes on with a mark, or ends.
    rf"|--(?P<name>{'|'.join(_KEYWORDS)})(?: (?P<given>(?:\S+\.py:\w+|{_WORD})(?=:|$|\)| says)))?(?![\w-])"
)
_COMMAND = re.compile(r"palpate (diagnose|add) --(apply|fresh)")
_ONE_AFTER_THE_OTHER = re.compile(r"(?<=\")\} (?:units|columns|where)=\{(?=\")")  # belong in one
Class = TypeVar("Class", bound=type)


class ErrorWording:
    """Whose words errors use; one for the whole process."""

    of_command_line = False


def in_python(text: str) -> str:
    """Write each option of the command line as the keyword of `palpate.Study` that does the same."""
    text = _OPTION.sub(_keyword, _COMMAND.sub(r"study.\1(\2=True)", text))
    return _ONE_AFTER_THE_OTHER.sub(", ", text)


def _keyword(option: re.Match[str]) -> str:
    if pair := option["pair"]:
        value = f'{{"{option["key"]}": "{_unquoted(option["value"])}"}}' if option["key"] else ""
        return f"{_PAIRS[pair]}={value}"
    if flag := option["flag"]:
        return f"{_FLAGS[flag]}=True"
    name, value = option["name"], _unquoted(option["given"] or "")
    if value and name not in _NUMBERS:
        value = f'["{value}"]' if name in _LISTS else f'"{value}"'
    return f"{_KEYWORDS[name]}={value}"


def _unquoted(word: str) -> str:
    """A word as a shell understands it."""
    return "".join(shlex.split(word))


def speaks_python(made: Class) -> Class:
    """Let errors of a class's public methods use Python's words, except below a command line."""

    def speaking(method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def call(*args: Any, **by_name: Any) -> Any:  # noqa: ANN401
            try:
                return method(*args, **by_name)
            except PalpateError as error:
                if not ErrorWording.of_command_line:
                    error.args = (in_python(str(error)),)
                raise

        return call

    for name in dir(made):
        method = inspect.getattr_static(made, name)
        if inspect.isfunction(method) and (name == "__init__" or not name.startswith("_")):
            setattr(made, name, speaking(method))
    return made
