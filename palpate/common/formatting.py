"""Format numbers, durations, paths and text from files for a terminal or a shell."""

import math
import shlex
from collections.abc import Iterable
from pathlib import Path

from rich.markup import escape

FIRST_PROBE = "--speed-mm-s 20 --force-limit-n 3"  # of a real arm: slow and soft
AT_REST = "the arm is at rest and without torque"  # after Ctrl-C
AT_BOUND = "at its bound"  # of a search: the data say no value
NOT_DETERMINED = "not determined"  # by the data: said in place of an interval
_LEAST_P = 0.005  # of 199 surrogates and the measurement itself
_MOST_DECIMALS = 6  # what would need more is written with a power of ten
_MOST_DIGITS = 8


def safe(text: str) -> str:
    """Text from a file for a console: one line, no escape sequence, no mark of direction, no markup."""
    line = "".join(char if char.isprintable() else " " if char in "\t\n" else "�" for char in text)
    last = line[len(line.rstrip("\\")) :]  # a backslash before markup would take its meaning away
    return escape(line.rstrip("\\")) + 2 * last


def count(number: int, one: str) -> str:
    """A number with its noun, such as "1 run" and "3,000 runs"."""
    return f"{number:,} {one if number == 1 else one + 's'}"


def duration(seconds: float) -> str:
    """A duration as a person says it."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min {rest:.0f} s"


def shown(path: Path) -> str:
    """A path as short as it can be said from where the user is, in one line, for a console."""
    return safe(_from_here(path))


def typed(path: Path) -> str:
    """A path as short as it can be typed where the user is, for a shell."""
    return as_shell_word(_from_here(path))


def as_shell_word(text: str) -> str:
    """Text as one word of a command that can be pasted into a shell."""
    if text.isprintable():
        return shlex.quote(text)
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    words = (
        char
        if char.isprintable()
        else "".join(f"\\x{byte:02x}" for byte in char.encode("utf-8", "surrogateescape"))
        for char in escaped
    )
    return f"$'{''.join(words)}'"


def as_command(arguments: Iterable[str]) -> str:
    """How palpate was called, to be pasted into a shell."""
    return " ".join(map(as_shell_word, ["palpate", *arguments]))


def _from_here(path: Path) -> str:
    """As short as it can be said, and never like an option."""
    try:
        text = str(path.absolute().relative_to(Path.cwd()))
    except ValueError:
        text = str(path)
    return f"./{text}" if text.startswith("-") else text


def chance(p_value: float) -> str:
    """A p value from surrogates, of which there are too few to say less than this."""
    return f"≤ {_LEAST_P:g}" if p_value <= _LEAST_P else f"{p_value:.3f}"


def significant(value: float, uncertainty: float | None = None) -> str:
    """A value with as many digits as its uncertainty allows (two of the uncertainty's), or five in all.

    Of what is not determined, with an uncertainty without bound or none that is known (NaN), two digits show
    the size. What rounds to zero has no sign.
    """
    if uncertainty is not None and not math.isfinite(uncertainty):
        return f"{value:z.2g}"
    if uncertainty is None or not uncertainty > 0:
        return f"{value:z.5g}"
    decimals = 1 - _exponent(uncertainty)
    if decimals > _MOST_DECIMALS:
        digits = _exponent(value) - _exponent(uncertainty) + 2
        return f"{value:z.{min(max(digits, 1), _MOST_DIGITS)}g}"
    return f"{round(value, decimals):z.{max(decimals, 0)}f}"


def _exponent(value: float) -> int:
    return int(f"{value:e}".split("e")[1])
