"""The command line: every module of `palpate.commands` is one command, and every failure is one line."""

import importlib
import pkgutil
from importlib.metadata import version
from typing import Annotated

import typer

import palpate.commands
from palpate.failures import OneLineGroup

ORDER = ("demo", "probe", "estimate", "inspect", "import", "info", "doctor")

app = typer.Typer(
    name="palpate",
    cls=OneLineGroup,
    rich_markup_mode="rich",
    invoke_without_command=True,
    add_completion=False,
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


def _register() -> None:
    """Add the function `command` of each module, under the module's name without a trailing underscore."""
    names = [info.name for info in pkgutil.iter_modules(palpate.commands.__path__)]
    ranked = sorted(names, key=lambda name: (_rank(name.rstrip("_")), name))
    for name in ranked:
        module = importlib.import_module(f"palpate.commands.{name}")
        app.command(name=name.rstrip("_"))(module.command)


def _rank(name: str) -> int:
    return ORDER.index(name) if name in ORDER else len(ORDER)


_register()
