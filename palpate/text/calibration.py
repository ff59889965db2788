"""A calibration in words and numbers, for the terminal."""

from collections.abc import Iterator

from palpate import console
from palpate.words import safe, significant
from robot_io.calibration import Calibration, Quantities, Quantity, doubtful


def print_calibration(calibration: Calibration, remarks: list[str]) -> None:
    """Values that are applied, and what else was found."""
    out = console.stdout()
    title = f"Calibration of {calibration.kind}, robot {safe(calibration.robot)}"
    table = console.table(title, "what", "value", "± (1 std)", "unit", "", right=("value", "± (1 std)"))
    values = getattr(calibration, "values")  # noqa: B009, each kind has its own
    for name in type(values).model_fields:
        quantity = getattr(values, name)
        if quantity is not None:
            for row in _rows(name, quantity):
                table.add_row(*row, "applied")
    for name, quantity in calibration.findings.items():
        for row in _rows(name, quantity):
            table.add_row(*(f"[dim]{cell}[/dim]" for cell in row), "[dim]found, not applied[/dim]")
    out.print(table)
    if doubt := doubtful(calibration):
        out.print(f"[bold red]look twice:[/bold red] {safe(doubt)}", soft_wrap=True)
    for remark in remarks:
        out.print(f"[yellow]{safe(remark)}[/yellow]")


def _rows(name: str, quantity: Quantity | Quantities) -> Iterator[tuple[str, str, str, str]]:
    what = name.replace("_", " ")
    if isinstance(quantity, Quantity):
        yield _row(what, quantity.value, quantity.std_err, quantity.unit)
        return
    label = ("from", "to") if name == "range" else [f"joint {j}" for j in range(1, len(quantity.value) + 1)]
    for joint, value, std_err in zip(label, quantity.value, quantity.std_err, strict=True):
        yield _row(f"{what}, {joint}", value, std_err, quantity.unit)


def _row(what: str, value: float, std_err: float, unit: str) -> tuple[str, str, str, str]:
    shown_err = f"{std_err:.2g}" if std_err else ""
    return what, significant(value, std_err or None), shown_err, "" if unit == "1" else unit
