"""The command line: a table of all commands, each loaded when it is called."""

import importlib
import re
from collections.abc import Mapping
from inspect import cleandoc
from typing import Annotated, Any

import typer
from typer import Option
from typer.core import TyperCommand
from typer.main import get_command

from palpate.common.failures import OneLineGroup
from palpate.robot_io.errors import InputError

COMMANDS: Mapping[str, tuple[str, str]] = {  # module and one-line help, in the order of the list
    "demo": ("demo", "Run the whole workflow once on simulated objects."),
    "probe": ("probe", "Press an object at several speeds and log every tick."),
    "replay": ("probe", "Repeat the motion of a session, in simulation or with an arm."),
    "estimate": ("diagnose", "Estimate stiffness and damping with confidence intervals."),
    "inspect": ("inspect", "Show a session in Rerun."),
    "compare": ("compare", "Show how large the model's error is, and where it is largest."),
    "diagnose": ("diagnose", "Find out which physical effect the model lacks, if any."),
    "resolve": ("probe", "Probe and diagnose repeatedly until one explanation is left."),
    "add": ("revisions", "Add effects to the model, and show how the error falls."),
    "remove": ("revisions", "Remove an effect from the newest model."),
    "revisions": ("revisions", "List the saved models of a measurement."),
    "effects": ("effects", "Describe the effects that palpate knows, with equations and drawings."),
    "workbench": ("workbench", "Tick effects on a local web page and see how the fit changes."),
    "report": ("export", "Write the measurement, its models and its diagnosis to one HTML page."),
    "export": ("export", "Export a model to a simulator or as a feedforward, or a stream as a table."),
    "reveal": ("sessions", "Show which effects were hidden in a simulated session."),
    "import": ("import_", "Import measurements from data files."),
    "merge": ("sessions", "Merge several sessions into one."),
    "info": ("info", "Show what is in a session file."),
    "sweep": ("sweep", "Probe many simulated objects and compare all estimators."),
    "batch": ("batch", "Estimate, compare and diagnose many recordings at once."),
    "trend": ("trend", "Find parameters that step or drift over time."),
    "teleop": ("teleop", "Teleoperate through a virtual object that is updated from the real one."),
    "calibrate": ("calibrate", "Calibrate the force sensor, encoders, drives and base."),
    "doctor": ("doctor", "Check this machine, and whether an arm matches its robot file."),
}

_ALIASES = {"study": "sweep"}  # earlier names, for one release
_WITHOUT_VALUE = re.compile(r"--[a-z-]+=")  # an option with an empty value


class CommandGroup(OneLineGroup):
    """Group of all commands by name and first line; a command's module is imported only when it runs.

    The libraries behind a command (simulator, viewer, statistics) take a second or two to import, which would
    delay every `--help`.
    """

    def __init__(self, **attributes: Any) -> None:  # noqa: ANN401
        super().__init__(**attributes)
        self.commands = {name: TyperCommand(name, help=text) for name, (_, text) in COMMANDS.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:  # noqa: ANN401
        """Find and load the command that is called; see `TyperGroup.resolve_command`."""
        # An unset shell variable becomes an empty argument, and "" would mean the current folder.
        before = ["", *args]
        for number, argument in enumerate(args):
            if not argument or _WITHOUT_VALUE.fullmatch(argument):
                place = argument or before[number]
                raise InputError(f"an argument is empty{f' ({place} ...)' if place else ''}; give it a value")
        if args and args[0] in _ALIASES:
            args = [_ALIASES[args[0]], *args[1:]]
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else load_command(name), rest


app = typer.Typer(
    name="palpate",
    cls=CommandGroup,
    rich_markup_mode="rich",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version  # noqa: PLC0415, it reads mail headers

        typer.echo(f"palpate {version('palpate')}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    _version: Annotated[
        bool, Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Probe compliant objects with a robot arm, and find out which physical effect the model is missing.

    Start with [bold]palpate demo[/bold]. Every command has its own [bold]--help[/bold].
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def load_command(name: str) -> Any:  # noqa: ANN401, typer's own command
    """Import a command: `NAME_command` of its module, or the module's `group` of commands.

    Its help is its docstring. Arguments are documented once, by the help of each option.

    Args:
        name: name of the command, one of `COMMANDS`.
    """
    module = importlib.import_module(f"palpate.commands.{COMMANDS[name][0]}")
    if hasattr(module, "group"):
        loaded = get_command(module.group)
        for command in getattr(loaded, "commands", {}).values():
            command.help = _join_lines(command.help)
    else:
        single = typer.Typer(rich_markup_mode="rich", add_completion=False)
        settings = {"help_option_names": ["-h", "--help"]}
        single.command(name=name, context_settings=settings)(getattr(module, f"{name}_command"))
        loaded = get_command(single)
    loaded.help = _join_lines(loaded.help)
    return loaded


def _join_lines(text: str | None) -> str:
    """Join the lines of each paragraph, so that the terminal wraps it; indented lines stay as they are."""
    return re.sub(r"(?<=\S)\n(?=\S)", " ", cleandoc(text or ""))
