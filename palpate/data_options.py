"""Options of every command that reads somebody's data file."""

from typing import Annotated

import typer

from estimation.data.import_options import ImportOptions, parse_pairs

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


def import_options(
    column: list[str] | None, unit: list[str] | None, where: list[str] | None, context: list[str] | None
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
    )
