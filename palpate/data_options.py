"""Options of every command that reads somebody's data file."""

from pathlib import Path
from typing import Annotated

import typer

from control.arm.rigid_body import RigidBody
from estimation.data.import_options import ImportOptions, parse_pairs
from palpate.files import existing_file
from palpate.findings.estimation_run import Arm
from palpate.words import as_shell_word, typed
from robot_io.errors import InputError
from robot_io.files.safe_yaml import read_text

FileArgument = Annotated[
    Path, typer.Argument(help="Session (.mcap) or data file (.csv, .csv.gz, .parquet, .npz).")
]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(help="What a column is called in the file, such as force_N=load.", metavar="NAME=COLUMN"),
]
UnitOption = Annotated[
    list[str] | None,
    typer.Option(help="Unit of a quantity or column, such as force=mN.", metavar="NAME=UNIT"),
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
UrdfOption = Annotated[
    Path | None,
    typer.Option(help="The arm's URDF, for models that need it and data files.", metavar="FILE"),
]
TIP_FRAME = "tip"
TipFrameOption = Annotated[
    str | None, typer.Option(help="The tip's frame in that URDF.", show_default=TIP_FRAME)
]


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


def given_arm(urdf: Path | None, tip_frame: str | None, otherwise: Arm) -> Arm:
    """The arm that the user names, or the one that the data came with.

    Raises:
        InputError: the file is not there, is no URDF or has no such frame, or there is a frame and no URDF.
    """
    if urdf is None:
        if tip_frame is not None:
            raise InputError(f"--tip-frame {tip_frame}: says nothing without --urdf FILE")
        return otherwise
    tip_frame = tip_frame or TIP_FRAME
    RigidBody.from_urdf(existing_file(urdf, "URDF"), tip_frame)  # also where no model asks for it
    return Arm(read_text(urdf), tip_frame, str(urdf))
