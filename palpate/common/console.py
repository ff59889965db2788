"""Where words go: results to stdout, progress and remarks to stderr, so that `--json` output can be piped."""

import json
import math
import os
import shutil
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD as SIMPLE
from rich.console import Console, JustifyMethod
from rich.markup import escape
from rich.table import Table

from palpate.common.failures import JsonOutput
from palpate.common.formatting import safe, typed

_UNBOUNDED = 10_000  # columns: wider than any table
# Columns when the output is no terminal and COLUMNS does not say how many: in 80, tables are squeezed.
PIPE_WIDTH = 120


def stdout() -> Console:
    """The console for results. Made on each call: the tests exchange `sys.stdout`."""
    return _console(stderr=False)


def stderr() -> Console:
    """The console for progress, remarks and next steps."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    made = Console(stderr=stderr, emoji=False, highlight=False)  # text of a file stays as it is
    if not made.is_terminal and not os.environ.get("COLUMNS", "").strip("0").isdigit():
        made.width = PIPE_WIDTH
    return made


def print_json(data: Any) -> None:  # noqa: ANN401
    """Print `data` as strict JSON on stdout; arrays become lists, NaN and infinity become null."""
    JsonOutput.was_printed = True
    readable = "utf" in (sys.stdout.encoding or "").lower()
    text = json.dumps(plain(data), indent=2, ensure_ascii=not readable, allow_nan=False)
    # what stands for itself in JSON may still be an order to a terminal
    print("".join(char if char.isprintable() or char == "\n" else json.dumps(char)[1:-1] for char in text))


def plain(value: Any) -> Any:  # noqa: ANN401
    """The same value in JSON's own types."""
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
    """A table in the house style: light rules, numbers to the right; what is too wide is folded, not cut."""
    made = Table(
        title=title or None, title_style="bold", title_justify="left", header_style="bold", box=SIMPLE
    )
    aligned = set(right)
    for column in columns:
        justify: JustifyMethod = "right" if column in aligned else "left"
        made.add_column(column, justify=justify, no_wrap=column in aligned, overflow="fold")
    return made


def natural_width(made: Table) -> int:
    """Columns of a terminal that a table takes if nothing in it is folded."""
    wide = Console(width=_UNBOUNDED)
    return made.__rich_measure__(wide, wide.options).maximum


def as_typed(command: str) -> str:
    """A command as it can be typed here: with its folder, where the shell would not find it otherwise."""
    program, _, rest = command.partition(" ")
    folder = Path(sys.argv[0]).parent
    started = folder / program
    if not started.is_file() or shutil.which(program) == str(started.absolute()):
        return command
    return f"{typed(started)} {rest}"


def next_steps(*commands: tuple[str, str]) -> None:
    """Show commands to try next, each with what it does.

    Args:
        commands: as they can be pasted into a shell (`typed` for paths), and their purpose.
    """
    console = stderr()
    console.print("\n[bold]Next[/bold]")
    runnable = [(as_typed(command), purpose) for command, purpose in commands]
    width = max(len(command) for command, _ in runnable)
    fits = all(width + len(purpose) + 4 <= console.width for _, purpose in runnable)
    for command, purpose in runnable:
        between = f"\n{' ' * 6}" if console.is_terminal and not fits else " " * (width - len(command) + 2)
        console.print(f"  [cyan]{escape(command)}[/cyan]{between}[dim]{purpose}[/dim]", soft_wrap=True)


def say_read(read: str, notes: Iterable[str]) -> None:
    """Say on stderr what of a data file was taken for what; nothing of a session."""
    console = stderr()
    if read:
        console.print(f"[dim]read: {safe(read)}[/dim]")
    for note in notes:
        console.print(f"[yellow]{safe(note)}[/yellow]")


def command_group(about: str) -> typer.Typer:
    """Commands under one name, which by itself prints its help."""
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
