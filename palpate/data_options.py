"""Options of every command that reads somebody's data file."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimation.data.import_options import ImportOptions, parse_pairs
from estimation.models import MODELS
from palpate import console
from palpate.files import existing_data
from palpate.words import as_shell_word, safe, typed
from robot_io.errors import InputError

if TYPE_CHECKING:
    from palpate.study import Study

FileArgument = Annotated[
    Path,
    typer.Argument(help="Session (.mcap), folder of sessions, or data file (.csv, .csv.gz, .parquet, .npz)."),
]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        help="What a column is called in the file, such as force_N=load, run=trial or phase=state.",
        metavar="NAME=COLUMN",
    ),
]
UnitOption = Annotated[
    list[str] | None,
    typer.Option(help="Unit of a quantity or column, such as force=mN or time=ms.", metavar="NAME=UNIT"),
]
WhereOption = Annotated[
    list[str] | None,
    typer.Option(help="Only rows with this text in a column, such as specimen=P002.", metavar="COLUMN=TEXT"),
]
ContextOption = Annotated[
    list[str] | None, typer.Option(help="Further column of numbers to keep.", metavar="COLUMN")
]
FreshOption = Annotated[
    bool,
    typer.Option("--fresh-runs", help="Each run met a fresh specimen or spot: none remembers another."),
]
FolderOption = Annotated[
    Path | None,
    typer.Option(help="Where the revisions are kept, if not in the usual place.", metavar="FOLDER"),
]
ForceOption = Annotated[
    bool,
    typer.Option("--force", help="Replace files of the same names in the folder that --out names."),
]
ModelOption = Annotated[
    str | None, typer.Option(help=f"One of {', '.join(MODELS)}; default: what suits each channel.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
_UrdfOption = Annotated[
    Path | None,
    typer.Option(help="The arm's URDF, for models that need it and data files.", metavar="FILE"),
]
_TipFrameOption = Annotated[
    str | None, typer.Option(help="The tip's frame in that URDF.", show_default="tip")
]
_EffectOption = Annotated[
    list[str] | None,
    typer.Option(help="Effect of your own that may be used; its file is run.", metavar="FILE.py:CLASS"),
]


@dataclass(frozen=True)
class DataArguments:
    """The file that a command is about, and how to read it, as the user typed that."""

    file: Path
    column: list[str] | None
    unit: list[str] | None
    where: list[str] | None
    context: list[str] | None
    fresh_runs: bool
    urdf: Path | None
    tip_frame: str | None
    effect: list[str] | None

    @property
    def options(self) -> ImportOptions:
        """How to read a data file.

        Raises:
            InputError: one is not of the form NAME=VALUE, or is given twice.
        """
        return import_options(self.column, self.unit, self.where, self.context, self.fresh_runs)

    def study(self, model: str | None = None, folder: Path | None = None) -> "Study":
        """The study of this file.

        Args:
            model: base model; None for what suits each channel.
            folder: where revisions are kept; None for the usual place.

        Raises:
            InputError: the data cannot be used.
        """
        from palpate.study import Study, arm_from_urdf  # noqa: PLC0415, takes a second

        existing_data(self.file)
        if self.urdf is None and self.tip_frame is not None:
            raise InputError(f"--tip-frame {self.tip_frame}: says nothing without --urdf FILE")
        arm = None if self.urdf is None else arm_from_urdf(self.urdf, self.tip_frame)
        study = Study(
            self.file, model, arm=arm, effects=self.effect or (), folder=folder, **vars(self.options)
        )
        for note in study.source.notes:
            console.stderr().print(f"[yellow]{safe(note)}[/yellow]")
        return study

    def typed(self, **more: str | Path | list[str] | bool | None) -> str:
        """The file with these and all further options as one would type them again; see `retyped`."""
        given = {"effect": self.effect, "urdf": self.urdf, "tip-frame": self.tip_frame}
        given |= {"column": self.column, "unit": self.unit, "where": self.where, "context": self.context}
        return retyped(self.file, **{**given, "fresh-runs": self.fresh_runs, **more})


def may_take_data(command: Callable[..., None]) -> Callable[..., None]:
    """As `takes_data`, for a command that works without a file, too: `data.file` is then the folder."""
    return takes_data(command, file=Path())


def takes_data(command: Callable[..., None], file: Any = inspect.Parameter.empty) -> Callable[..., None]:  # noqa: ANN401
    """A command whose first parameter `data: DataArguments` is made of one argument and the options above.

    Typer reads the signature of the function that is returned: the file, the command's own parameters, then
    the options that say how to read the file.
    """

    def run(**values: Any) -> None:  # noqa: ANN401, whatever the command takes
        data = DataArguments(**{name: values.pop(name) for name in options})
        command(data, **values)

    options: dict[str, tuple[Any, Any]] = {
        "file": (FileArgument, file),
        "effect": (_EffectOption, None),
        "urdf": (_UrdfOption, None),
        "tip_frame": (_TipFrameOption, None),
        "column": (ColumnOption, None),
        "unit": (UnitOption, None),
        "where": (WhereOption, None),
        "context": (ContextOption, None),
        "fresh_runs": (FreshOption, False),
    }
    made = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (kind, default) in options.items()
    ]
    own = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in list(inspect.signature(command).parameters.values())[1:]
    ]
    signature = inspect.Signature([made[0], *own, *made[1:]])
    run.__signature__ = signature  # type: ignore[attr-defined]
    run.__annotations__ = {name: one.annotation for name, one in signature.parameters.items()}
    run.__doc__, run.__name__ = command.__doc__, command.__name__
    return run


def import_options(
    column: list[str] | None,
    unit: list[str] | None,
    where: list[str] | None,
    context: list[str] | None,
    fresh: bool = False,
) -> ImportOptions:
    """The options together.

    Raises:
        InputError: one is not of the form NAME=VALUE, or is given twice.
    """
    return ImportOptions(
        columns=parse_pairs(column or (), "--column"),
        units=parse_pairs(unit or (), "--unit"),
        where=parse_pairs(where or (), "--where"),
        context=tuple(context or ()),
        fresh=fresh,
    )


def retyped(file: Path, **options: str | Path | list[str] | bool | None) -> str:
    """The file with its options as one would type them again, for commands to try next.

    Args:
        file: session or data file.
        options: values by the name of the option; None, or False for a flag, where it was not given.
    """
    words = [typed(file)]
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            if each is True:
                words.append(f"--{name}")
            elif each is not None and each is not False:
                words += [f"--{name}", as_shell_word(str(each))]
    return " ".join(words)
