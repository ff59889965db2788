"""Data files dropped on the page, and a form for the roles of their columns."""

import asyncio
import re
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui

from palpate.common.files import atomic_write, output_folder
from palpate.estimation.data.assign_columns import propose_columns
from palpate.estimation.data.column_names import QUANTITIES, RUN
from palpate.estimation.data.file_columns import is_session
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import Table, read_table
from palpate.estimation.data.units import SI
from palpate.robot_io.errors import InputError, PalpateError
from palpate.workbench.elements import set_props

DROPPED = Path("sessions")  # folder of dropped files
MOST_BYTES = 500_000_000
NOTHING = "not used"
_SELECT = "dense outlined options-dense"
_SHOWN = 4  # number of values of a column that are shown
_HERE = " (on this page, choose quantities and units in the table)"


@dataclass
class ColumnGuess:
    """Guessed role of a column; `quantity` may number a joint, as in position_2."""

    name: str
    quantity: str
    unit: str  # empty if the file states none; inferred for time, otherwise the user is asked
    why: str
    values: str
    stated: str = ""  # unit stated in the file

    def assign(self, quantity: str) -> None:
        """Assign another quantity to the column, in its present unit or the unit stated in the file.

        Args:
            quantity: quantity, such as force; empty if the column is not used.
        """
        known = _units_of(quantity)
        self.unit = next((unit for unit in (self.unit, self.stated) if unit in known), "")
        self.quantity = quantity


def _suggest_columns(table: Table) -> list[ColumnGuess]:
    """Propose roles of the numeric columns: those that are read without options, or else by their names."""
    proposed = dict[str, tuple[str, str]]()
    with suppress(InputError):  # the form lets the user resolve what the names leave open
        proposed = propose_columns(table)
    if not proposed:
        best = {each.key: each for each in sorted(table.guesses, key=lambda each: each.fit)}
        proposed = {each.column: (each.numbered, each.unit) for each in best.values()}
    columns = []
    for each in table.guesses:
        if table.numeric_share(each.column) == 1.0:
            quantity, unit = proposed.get(each.column, ("", ""))
            values = ", ".join(f"{value:.4g}" for value in table.head(_SHOWN).numbers(each.column))
            why = each.why if unit or not quantity else f"{each.why}; unit not stated"
            known = unit if unit in _units_of(quantity) else ""  # none with a factor, as in "[0.1 N]"
            columns.append(ColumnGuess(each.column, quantity, known, why, values, each.unit))
    if not any(column.quantity == "time" for column in columns):
        for column in columns:
            if not column.quantity and np.all(np.diff(table.numbers(column.name)) > 0.0):
                column.quantity, column.why = "time", "rises all along"
                break
    return columns


def _options_of(columns: Sequence[ColumnGuess]) -> ImportOptions:
    """Return the import options for these roles; raise `InputError` if two columns have the same role."""
    used = [column for column in columns if column.quantity]
    names = [column.quantity for column in used]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"several columns are assigned to {twice[0]}; assign only one")
    units = {column.name: column.unit for column in used if column.unit and column.quantity != RUN}
    return ImportOptions(columns={column.quantity: column.name for column in used}, units=units)


def _units_of(quantity: str) -> list[str]:
    """Return the units that a quantity, such as force or position_2, may have."""
    return [
        unit for dimension in QUANTITIES.get(re.sub(r"_\d+$", "", quantity), ()) for unit in SI[dimension]
    ]


OpenFile = Callable[[Path, ImportOptions], Awaitable[None]]


class FileDrop:
    """Area to drop a file on, and a form for its columns."""

    def __init__(self, opened: OpenFile) -> None:
        self._opened = opened

        async def upload(event: events.UploadEventArguments) -> None:
            with self._errors_shown():
                path, is_new = await self._keep(event)
                if not await self.begin(path) and is_new:
                    path.unlink()
            box.reset()  # for the next file

        text = "Drop a data file or a session here, or choose one"
        box = ui.upload(on_upload=upload, label=text, auto_upload=True, max_files=1, max_file_size=MOST_BYTES)
        box.props("flat bordered").classes("drop")
        self._review = ui.element("div").classes("dropped")
        self._problem = ui.label().classes("bad").mark("problem")

    @contextmanager
    def _errors_shown(self) -> Iterator[None]:
        """Show an error of the context's body until the next attempt."""
        self._problem.set_text("")
        try:
            yield
        except PalpateError as error:
            advises_options = "--unit" in str(error) or "--column" in str(error)
            self._problem.set_text(f"{error}{_HERE * advises_options}")

    async def begin(self, path: Path) -> bool:
        """Open a session at once, a data file after a review of its columns; return whether it is readable.

        Args:
            path: a session, a folder of sessions or a data file.
        """
        is_readable = False
        with self._errors_shown():
            if is_session(path) or path.is_dir():
                await self._opened(path, ImportOptions())
            else:
                columns = await asyncio.to_thread(lambda: _suggest_columns(read_table(path)))
                choices = [NOTHING, *QUANTITIES, RUN]

                async def use() -> None:
                    with self._errors_shown():
                        await self._opened(path, _options_of(columns))

                self._review.clear()
                with self._review:
                    ui.label(f"{path.name}: is this right?").classes("text-bold")
                    with ui.element("table"):
                        with ui.element("tr"):
                            for heading in ("column", "holds", "in", "first values"):
                                with ui.element("th"):
                                    ui.label(heading)
                        for column in columns:
                            self._column_row(column, choices)
                    ui.button("Use these columns", on_click=use).props("unelevated dense no-caps")
            is_readable = True
        return is_readable

    async def _keep(self, event: events.UploadEventArguments) -> tuple[Path, bool]:
        """Store the file under its own name; return its path, and whether it is new."""
        name = Path(event.file.name).name
        if event.file.size() > MOST_BYTES:  # the browser rejects it, but other clients may send it
            raise InputError(
                f"{name}: larger than {MOST_BYTES // 10**6} MB; open it with palpate workbench FILE instead"
            )
        folder, content = output_folder(DROPPED), await event.file.read()
        stem, dot, ending = name.partition(".")
        for number in range(1, 1000):
            path = folder / (name if number == 1 else f"{stem}-{number}{dot}{ending}")
            try:
                if not path.exists():
                    with atomic_write(path) as writing:
                        writing.write_bytes(content)
                    return path, True
                if path.is_file() and path.read_bytes() == content:
                    return path, False
            except (OSError, ValueError) as error:
                raise InputError(f"{name[:80]!r}: cannot be saved in {folder} ({error})") from error
        raise InputError(f"{folder}: too many files are called {name}")

    @staticmethod
    def _column_row(column: ColumnGuess, choices: list[str]) -> None:
        with ui.element("tr"):
            with ui.element("td"):
                set_props(ui.label(column.name), title=column.why)
            with ui.element("td"):
                known = choices if column.quantity in {*choices, ""} else [*choices, column.quantity]
                quantity = ui.select(known, value=column.quantity or NOTHING).props(_SELECT)
                set_props(quantity, aria_label=f"quantity of {column.name}")
            with ui.element("td"):
                known_units = _units_of(column.quantity)
                label = "unit?" if known_units and not column.unit else None
                unit = ui.select(known_units, value=column.unit or None, label=label).props(_SELECT)
                set_props(unit, aria_label=f"unit of {column.name}")
            with ui.element("td"):
                ui.label(column.values).classes("quiet")

        def chose_quantity(event: events.ValueChangeEventArguments[Any]) -> None:
            column.assign("" if event.value == NOTHING else event.value)
            unit.set_options(_units_of(column.quantity), value=column.unit or None)

        def chose_unit(event: events.ValueChangeEventArguments[Any]) -> None:
            column.unit = event.value or ""

        quantity.on_value_change(chose_quantity)
        unit.on_value_change(chose_unit)
