"""A data file by drop: columns and units guessed, shown, and corrected before anything is read as what."""

import asyncio
import re
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import events, ui

from estimation.data.clock_times import clocks_of
from estimation.data.column_guess import Guess, guess_columns
from estimation.data.file_kind import is_session
from estimation.data.import_options import ImportOptions
from estimation.data.quantities import QUANTITIES, RUN, si_unit
from estimation.data.table import Table, read_table
from estimation.data.units import SI
from palpate.common.files import output_folder, whole_file
from palpate.workbench.elements import set_props
from robot_io.errors import InputError, PalpateError

DROPPED = Path("sessions")  # where a dropped file is kept, beside what is probed and imported
MOST_BYTES = 500_000_000
NOTHING = "not used"
_SELECT = "dense outlined options-dense"
_SHOWN = 4  # values of a column that are shown


@dataclass
class ColumnGuess:
    """What a column is taken for; `quantity` may number a joint, as in position_2."""

    name: str
    quantity: str
    unit: str
    why: str
    values: str


def guess(table: Table) -> list[ColumnGuess]:
    """What each column of numbers seems to hold, as every command guesses it; the time also by its values."""
    guesses = guess_columns(table.names, clocks_of(table.columns))
    guesses = [one for one in guesses if table.is_numeric(one.column)]
    best = {(one.quantity, one.joint): one for one in sorted(guesses, key=lambda one: one.fit)}
    found = [
        _column(table, one if best[one.quantity, one.joint] is one else Guess(one.column, ""))
        for one in guesses
    ]
    if not any(one.quantity == "time" for one in found):
        rising = (one for one in found if not one.quantity and np.all(np.diff(table.numbers(one.name)) > 0.0))
        for one in list(rising)[:1]:
            one.quantity, one.unit, one.why = "time", "s", "rises all along"
    return found


def options_of(columns: Sequence[ColumnGuess]) -> ImportOptions:
    """How to read the file, as the page has it. InputError: two columns hold the same."""
    used = [column for column in columns if column.quantity]
    names = [one.quantity for one in used]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"several columns are taken for {twice[0]}; choose one")
    units = {one.name: one.unit for one in used if one.unit and one.quantity != RUN}
    return ImportOptions(columns={one.quantity: one.name for one in used}, units=units)


def units_of(quantity: str) -> list[str]:
    """Units that a quantity may have."""
    return [
        unit for dimension in QUANTITIES.get(re.sub(r"_\d+$", "", quantity), ()) for unit in SI[dimension]
    ]


def _column(table: Table, guessed: Guess) -> ColumnGuess:
    quantity = f"{guessed.quantity}_{guessed.joint}" if guessed.joint is not None else guessed.quantity
    values = ", ".join(f"{value:.4g}" for value in table.head(_SHOWN).numbers(guessed.column))
    why = guessed.why if guessed.unit or not quantity else f"{guessed.why}; unit assumed"
    return ColumnGuess(guessed.column, quantity, guessed.unit or _usual(quantity), why, values)


def _usual(quantity: str) -> str:
    dimensions = QUANTITIES.get(re.sub(r"_\d+$", "", quantity), ())
    return si_unit(dimensions[0]) if dimensions else ""


def _warn(error: PalpateError) -> None:
    ui.notify(str(error), type="warning", multi_line=True, timeout=0, close_button=True)


Opened = Callable[[Path, ImportOptions], Awaitable[None]]


class FileDrop:
    """The place to drop a file, and then the columns of it."""

    def __init__(self, opened: Opened) -> None:
        self._opened = opened

    def build(self) -> None:
        """Put the elements."""
        ui.upload(
            label="Drop a data file or a session here, or choose one",
            auto_upload=True,
            max_files=1,
            max_file_size=MOST_BYTES,
            on_upload=self._uploaded,
        ).props("flat bordered").classes("drop").mark("drop")
        self._review = ui.element("div").classes("dropped")

    async def _uploaded(self, event: events.UploadEventArguments) -> None:
        try:
            path, is_new = await self._kept(event)
        except PalpateError as error:
            _warn(error)
            return
        if not await self.begin(path) and is_new:
            path.unlink()

    async def begin(self, path: Path) -> bool:
        """Open a session at once, and a data file after a look at its columns; whether it can be read."""
        try:
            if is_session(path) or path.is_dir():
                await self._opened(path, ImportOptions())
            else:
                self._ask(path, await asyncio.to_thread(lambda: guess(read_table(path))))
        except PalpateError as error:
            _warn(error)
            return False
        return True

    async def _kept(self, event: events.UploadEventArguments) -> tuple[Path, bool]:
        """The file, kept under its own name, and whether it was not there; another of that name stays."""
        name = Path(event.file.name).name
        if event.file.size() > MOST_BYTES:  # the browser refuses it, but whoever sends it need not be one
            raise InputError(f"{name}: larger than {MOST_BYTES // 10**6} MB; open it by its name instead")
        folder, content = output_folder(DROPPED), await event.file.read()
        stem, dot, ending = name.partition(".")
        for number in range(1, 1000):
            path = folder / (name if number == 1 else f"{stem}-{number}{dot}{ending}")
            try:
                if not path.exists():
                    with whole_file(path) as writing:
                        writing.write_bytes(content)
                    return path, True
                if path.is_file() and path.read_bytes() == content:
                    return path, False
            except (OSError, ValueError) as error:
                raise InputError(f"{name[:80]!r}: cannot be kept in {folder} ({error})") from error
        raise InputError(f"{folder}: too many files are called {name}")

    def _ask(self, path: Path, columns: list[ColumnGuess]) -> None:
        self._review.clear()
        choices = [NOTHING, *QUANTITIES, RUN]
        with self._review:
            ui.label(f"{path.name}: is this right?").classes("text-bold")
            with ui.element("table"):
                with ui.element("tr"):
                    for heading in ("column", "holds", "in", "first values"):
                        with ui.element("th"):
                            ui.label(heading)
                for column in columns:
                    self._column_row(column, choices)

            async def use() -> None:
                try:
                    options = options_of(columns)
                    await self._opened(path, options)
                except PalpateError as error:
                    _warn(error)

            ui.button("Use these columns", on_click=use).props("unelevated dense no-caps").mark("use")

    @staticmethod
    def _column_row(one: ColumnGuess, choices: list[str]) -> None:
        with ui.element("tr"):
            with ui.element("td"):
                set_props(ui.label(one.name), title=one.why)
            with ui.element("td"):
                known = choices if one.quantity in {*choices, ""} else [*choices, one.quantity]
                quantity = ui.select(known, value=one.quantity or NOTHING).props(_SELECT)
                set_props(quantity, aria_label=f"quantity of {one.name}")
            with ui.element("td"):
                unit = ui.select(units_of(one.quantity), value=one.unit or None).props(_SELECT)
                set_props(unit, aria_label=f"unit of {one.name}")
            with ui.element("td"):
                ui.label(one.values).classes("quiet")

        def chose_quantity(event: events.ValueChangeEventArguments[Any]) -> None:
            one.quantity = "" if event.value == NOTHING else event.value
            one.unit = _usual(one.quantity)
            unit.set_options(units_of(one.quantity), value=one.unit or None)

        def chose_unit(event: events.ValueChangeEventArguments[Any]) -> None:
            one.unit = event.value or ""

        quantity.on_value_change(chose_quantity)
        unit.on_value_change(chose_unit)
