"""The command line: every module of `palpate.commands` is one command, loaded when it is called."""

import ast
import importlib
import importlib.util
import pkgutil
import re
from functools import cache
from importlib.metadata import version
from inspect import getdoc
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from palpate.common.failures import OneLineGroup
from robot_io.errors import InputError

ORDER = (
    *("demo", "probe", "replay", "estimate", "inspect", "compare", "diagnose", "resolve"),
    *("add", "remove", "revisions", "effects", "workbench", "report", "export", "reveal"),
    *("import", "merge", "info", "sweep", "teleop", "calibrate", "doctor"),
)

_ALIASES = {"study": "sweep"}  # earlier names, for one release
_WITHOUT_VALUE = re.compile(r"--[a-z-]+=")  # an option with nothing after its sign


class CommandGroup(OneLineGroup):
    """Knows every command by name and first line; imports a command's module only to run it.

    What is behind a command (simulator, viewer, statistics) takes a second or two to import, and nobody who
    asks for help should wait for it.
    """

    def __init__(self, **attributes: Any) -> None:  # noqa: ANN401
        super().__init__(**attributes)
        self.commands = {name: TyperCommand(name, help=text) for name, text in _first_lines().items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:  # noqa: ANN401
        """Find the command that is called, and load it; see `TyperGroup.resolve_command`."""
        # A shell makes empty names of variables that are not set: "" would be the current folder.
        before = ["", *args]
        for number, argument in enumerate(args):
            if not argument or _WITHOUT_VALUE.fullmatch(argument):
                place = argument or before[number]
                raise InputError(f"an argument is empty{f' ({place} ...)' if place else ''}; give it a value")
        if args and args[0] in _ALIASES:
            args = [_ALIASES[args[0]], *args[1:]]
        name, found, rest = super().resolve_command(ctx, args)
        return name, found if name is None else load_command(name), rest


app = typer.Typer(
    name="palpate",
    cls=CommandGroup,
    rich_markup_mode="rich",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"palpate {version('palpate')}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    _version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Probe compliant objects with a robot arm, and find out which physical effect the model is missing.

    Start with [bold]palpate demo[/bold]. Every command has its own [bold]--help[/bold].
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def load_command(name: str) -> Any:  # noqa: ANN401, typer's own command
    """What a module of `palpate.commands` offers: its function `command`, or its `group` of commands."""
    module = importlib.import_module(f"palpate.commands.{_module_of(name)}")
    if hasattr(module, "group"):
        return get_command(module.group)
    single = typer.Typer(rich_markup_mode="rich", add_completion=False)
    paragraphs = (getdoc(module.command) or "").split("\n\n")
    about = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    single.command(name=name, help=about, context_settings={"help_option_names": ["-h", "--help"]})(
        module.command
    )
    return get_command(single)


@cache
def _first_lines() -> dict[str, str]:
    """What each command does, in its module's words after the colon; modules are read, not imported."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        source = Path(__path__[0], f"{module.name}.py").read_text(encoding="utf-8")
        first_line = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
        words = first_line.partition(": ")[2]
        found[module.name.rstrip("_")] = words[:1].upper() + words[1:]
    return dict(sorted(found.items(), key=lambda item: (_rank(item[0]), item[0])))


def _module_of(command: str) -> str:
    """A command that is a Python keyword lives in a module with an underscore behind."""
    exists = importlib.util.find_spec(f"palpate.commands.{command}") is not None
    return command if exists else f"{command}_"


def _rank(name: str) -> int:
    return ORDER.index(name) if name in ORDER else len(ORDER)
