"""Consoles for results and remarks, and text for numbers, paths and commands.

Results go to stdout, progress and remarks to stderr, so that `--json` output can be piped.
"""

import json
import math
import os
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD as SIMPLE
from rich.console import Console, JustifyMethod
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from palpate.common.failures import JsonOutput
from palpate.estimation.channel import ChannelKind
from palpate.robot_io.extras import EXTRAS, install_command

_UNBOUNDED = 10_000  # columns; wider than any table
# Width in columns if the output is not a terminal and COLUMNS is not set; 80 would squeeze tables.
PIPE_WIDTH = 120


def stdout() -> Console:
    """Return the console for results, created on each call because tests replace `sys.stdout`."""
    return _console(stderr=False)


def stderr() -> Console:
    """Return the console for progress, remarks and suggested commands."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    made = Console(stderr=stderr, emoji=False, highlight=False)  # text from a file is printed unchanged
    if not made.is_terminal and not os.environ.get("COLUMNS", "").strip("0").isdigit():
        made.width = PIPE_WIDTH
    return made


def print_json(data: Any) -> None:  # noqa: ANN401
    """Print `data` as strict JSON on stdout; see `plain`.

    Args:
        data: any data.
    """
    JsonOutput.was_printed = True
    readable = "utf" in (sys.stdout.encoding or "").lower()
    text = json_text(data, is_ascii=not readable)
    # JSON allows some control characters that a terminal would execute
    shown_text = (char if char.isprintable() or char == "\n" else json.dumps(char)[1:-1] for char in text)
    print("".join(shown_text), end="")


def json_text(data: Any, *, is_ascii: bool = False) -> str:  # noqa: ANN401
    """Format data as the text of a JSON file; see `plain`.

    Args:
        data: any data.
        is_ascii: whether to escape all characters beyond ASCII.
    """
    return json.dumps(plain(data), indent=2, ensure_ascii=is_ascii, allow_nan=False) + "\n"


def plain(value: Any) -> Any:  # noqa: ANN401
    """Convert a value to JSON's own types; NaN and infinity become null.

    Args:
        value: mappings, dataclasses, models of pydantic, sequences, arrays and scalars; anything else is
            converted by `str`.
    """
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif hasattr(value, "model_dump"):
        value = value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def table(title: str, *columns: str, right: Iterable[str] = ()) -> Table:
    """Make a table in the house style: light rules, numbers right-aligned, long cells folded.

    Args:
        title: title above the table; empty for none.
        columns: column headings.
        right: headings of the numeric columns, which are right-aligned.
    """
    made = Table(
        title=title or None, title_style="bold", title_justify="left", header_style="bold", box=SIMPLE
    )
    aligned = set(right)
    for column in columns:
        justify: JustifyMethod = "right" if column in aligned else "left"
        made.add_column(column, justify=justify, no_wrap=column in aligned, overflow="fold")
    return made


def labeled(*lines: tuple[str, str]) -> Table:
    """Set texts beside their labels, with the second and later lines of a text below its first.

    Args:
        lines: pairs of a label and a text from any source; see `safe`.
    """
    made = Table.grid(padding=(0, 2, 0, 0))
    for label, text in lines:
        made.add_row(f"[dim]{label}[/dim]", safe(text))
    return made


def natural_width(made: Table) -> int:
    """Return the width of a table in terminal columns if no cell is folded."""
    wide = Console(width=_UNBOUNDED)
    return made.__rich_measure__(wide, wide.options).maximum


def first_that_fits(layouts: Iterable[Table], width: int) -> Table:
    """Return the first table that needs no folded cell, or else the last one.

    Args:
        layouts: tables of the same content, the widest first; at least one.
        width: width of the terminal [characters].
    """
    for made in layouts:
        if natural_width(made) <= width:
            break
    return made


# How commands start that are proposed although an extra may be missing, and a module of that extra.
_NEEDED_MODULES = {
    "palpate inspect": "rerun",
    "palpate workbench": "nicegui",
    "palpate probe --scenario": "mujoco",
}


def _format_command(command: str) -> str:
    """Return a command that can be typed here; include the program's folder if it is not on the PATH."""
    program, _, rest = command.partition(" ")
    started = Path(sys.argv[0]).parent / program
    if not started.is_file() or shutil.which(program) == str(started.absolute()):
        return command
    return f"{shell_path(started)} {rest}"


def next_steps(*commands: tuple[str, str]) -> None:
    """Show commands to try next, each with what it does; the installation of a missing extra comes first.

    Args:
        commands: pairs of a command that can be pasted into a shell (see `shell_path`) and its purpose.
    """
    console = stderr()
    console.print("\n[bold]Next[/bold]")
    runnable = []
    for command, purpose in commands:
        typed = _format_command(command)
        needed = next((part for start, part in _NEEDED_MODULES.items() if command.startswith(start)), None)
        if needed is not None and not find_spec(needed):
            typed = f"{_format_command(install_command(EXTRAS[needed][1]))} && {typed}"
        runnable.append((typed, purpose))
    width = max(len(command) for command, _ in runnable)
    fits = all(width + len(purpose) + 4 <= console.width for _, purpose in runnable)
    for command, purpose in runnable:
        between = f"\n{' ' * 6}" if console.is_terminal and not fits else " " * (width - len(command) + 2)
        console.print(f"  [cyan]{escape(command)}[/cyan]{between}[dim]{purpose}[/dim]", soft_wrap=True)


def has_display() -> bool:
    """Return whether a window can be opened."""
    return sys.platform == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def rerun_step(recording: Path) -> tuple[str, str]:
    """Return the command that opens a recording of revisions, and its purpose with requirements."""
    where = "" if has_display() else " (needs a display)"
    return f"rerun {shell_path(recording)}", f"see each revision in Rerun{where}"


def export_steps(kept: str, kinds: Iterable[ChannelKind]) -> list[tuple[str, str]]:
    """Return the commands that export revisions; for a servo's goal error, one that also needs its gain.

    Args:
        kept: the data path and the folder of revisions, quoted for a shell.
        kinds: kinds of the channels that have a saved model.
    """
    joints = set(kinds) - {ChannelKind.CONTACT}
    export = f"palpate export {kept}"
    if ChannelKind.SERVO in joints:
        gain = "the joints in a copy of your MJCF, with the servo's gain K [N m/rad]"
        return [(f"{export} --format mjcf --patch MODEL.xml --servo-gain K", gain)]
    steps = [(export, "the improved model as a simulated world")]
    if joints:
        into = "the joints in a copy of your MJCF; also urdf, isaaclab, bam"
        steps.append((f"{export} --format mjcf --patch MODEL.xml", into))
        steps.append((f"{export} --format feedforward", "joint torques as a table and in Python and C"))
    return steps


def present(
    content: Any,  # noqa: ANN401
    show: Callable[[], object],
    steps: Iterable[tuple[str, str]] = (),
    *,
    as_json: bool,
) -> None:
    """Print a command's result, either as JSON or as text with commands to try next.

    Args:
        content: the result as plain data.
        show: function that prints the result as text.
        steps: commands to try next, see `next_steps`; not computed for JSON.
        as_json: whether to print JSON.
    """
    if as_json:
        print_json(content)
        return
    show()
    if commands := list(steps):
        next_steps(*commands)


def say(text: str) -> None:
    """Print a line of results, which only the terminal wraps.

    Args:
        text: line to print, with markup.
    """
    stdout().print(text, soft_wrap=True)


def say_below(text: str) -> None:
    """Print a line of results that belongs to the one above; all its lines are indented.

    Args:
        text: line to print, with markup.
    """
    stdout().print(Padding(text, (0, 0, 0, 2), expand=False))


def warn(remark: str, more: str = "") -> None:
    """Print a warning on stderr.

    Args:
        remark: the warning, which may quote a file.
        more: advice behind it, with markup.
    """
    stderr().print(f"[yellow]{safe(remark)}[/yellow]{more}")


def print_read_notes(read: str, notes: Iterable[str]) -> None:
    """Report on stderr how the columns of a data file were interpreted; print nothing for a session.

    Args:
        read: the file's columns and their roles; empty for a session.
        notes: sentences that the reader should see.
    """
    if read:
        stderr().print(f"[dim]read: {safe(read)}[/dim]")
    for note in notes:
        warn(note)


def command_group(about: str) -> typer.Typer:
    """Make a group of commands that prints its help if called without a command.

    Args:
        about: help text of the group.
    """
    group = typer.Typer(
        rich_markup_mode="rich",
        add_completion=False,
        invoke_without_command=True,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @group.callback(help=about)
    def root(context: typer.Context) -> None:
        if context.invoked_subcommand is None:
            typer.echo(context.get_help())

    return group


FIRST_PROBE = "--speed-mm-s 20 --force-limit-n 3"  # options for a real arm's first probe: slow and gentle
AT_REST = "the arm is at rest and without torque"  # after Ctrl-C
AT_BOUND = "at its bound"  # the search ended at a parameter's bound: the data do not determine it
NOT_DETERMINED = "not determined"  # by the data; printed instead of an interval
_ROUNDING_OF_P = 1e-15  # a computed p value below it may be rounded to zero
_LEAST_P = 0.005  # smallest p value with 199 surrogates: 1 / (199 + 1)
_MOST_DECIMALS = 6  # numbers that need more use scientific notation
_MOST_ZEROS = 8  # after the last justified digit; beyond that, likewise
_MOST_DIGITS = 8


def safe(text: str) -> str:
    """Make text from a file safe for a console: one line without escapes, direction marks or markup.

    Args:
        text: untrusted text from a file.
    """
    line = "".join(char if char.isprintable() else " " if char in "\t\n" else "�" for char in text)
    last = line[len(line.rstrip("\\")) :]  # a trailing backslash would escape the markup that follows
    return escape(line.rstrip("\\")) + 2 * last


def count(number: int, noun: str) -> str:
    """Return a number with its noun, such as "1 run" and "3,000 runs"."""
    return f"{number:,} {noun if number == 1 else noun + 's'}"


def duration(seconds: float) -> str:
    """Format a duration for people.

    Args:
        seconds: duration [s].
    """
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min {rest:.0f} s"


def display_path(path: Path) -> str:
    """Return a path relative to the current folder, on one line, for a console.

    Args:
        path: absolute, or relative to the current folder.
    """
    return safe(_relative_path(path))


def shell_path(path: Path) -> str:
    """Return a path relative to the current folder, quoted for a shell.

    Args:
        path: absolute, or relative to the current folder.
    """
    return as_shell_word(_relative_path(path))


def as_shell_word(text: str) -> str:
    """Quote text as one word of a shell command."""
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
    """Return the command line of this call, ready to be pasted into a shell.

    Args:
        arguments: the arguments after the program's name.
    """
    return " ".join(map(as_shell_word, ["palpate", *arguments]))


def _relative_path(path: Path) -> str:
    """Return a path relative to the current folder that cannot be mistaken for an option."""
    try:
        text = str(path.absolute().relative_to(Path.cwd()))
    except ValueError:
        text = str(path)
    return f"./{text}" if text.startswith("-") else text


def format_p_value(p_value: float) -> str:
    """Format a p value from surrogates; the smallest possible one is shown as an upper bound.

    Args:
        p_value: between 0 and 1.
    """
    return f"≤ {_LEAST_P:g}" if p_value <= _LEAST_P else f"{p_value:.3f}"


def format_computed_p_value(p_value: float) -> str:
    """Format a computed p value to two digits; one below the rounding of numbers is shown as an upper bound.

    Args:
        p_value: between 0 and 1.
    """
    return f"< {_ROUNDING_OF_P:g}" if p_value < _ROUNDING_OF_P else f"{p_value:.2g}"


def significant(value: float, uncertainty: float | None = None) -> str:
    """Format a value to two significant digits of its uncertainty, or to five significant digits.

    If the uncertainty is infinite or NaN, the value gets two significant digits. A value that rounds to zero
    has no sign.

    Args:
        value: value in any unit.
        uncertainty: standard uncertainty in the same unit; None for five digits.
    """
    if uncertainty is not None and not math.isfinite(uncertainty):
        return f"{value:z.2g}"
    if uncertainty is None or not uncertainty > 0:
        return f"{value:z.5g}"
    decimals = 1 - _exponent(uncertainty)
    if decimals > _MOST_DECIMALS or decimals < -_MOST_ZEROS:
        digits = _exponent(value) - _exponent(uncertainty) + 2
        return f"{value:z.{min(max(digits, 1), _MOST_DIGITS)}g}"
    return f"{round(value, decimals):z.{max(decimals, 0)}f}"


def plus_minus(value: float, half: float) -> str:
    """Format a value with the half width of its interval, if that is finite.

    Args:
        value: value in any unit.
        half: half width of the interval in the same unit.
    """
    return significant(value, half) + (f" ± {significant(half, half)}" if math.isfinite(half) else "")


def _exponent(value: float) -> int:
    return int(f"{value:e}".split("e")[1])
