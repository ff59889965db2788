"""Writes what a sweep shows: figures (PNG and SVG), tables (CSV), and one page that stands alone (HTML)."""

import base64
import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from palpate.files import output_folder, whole_file, write_text
from palpate.render.page import rendered
from palpate.sweep.figures import Drawing
from palpate.sweep.summary import Table

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
_PIXELS_PER_INCH = 132
_TEMPLATE = Path(__file__).parent / "page.html"


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    title: str  # heading
    drawing: Drawing | None  # its figure, or None
    words: tuple[str, ...] = ()  # paragraphs
    tables: tuple[Table, ...] = ()  # shown, and written as CSV
    more: tuple[Table, ...] = ()  # written as CSV only


def write_page(
    folder: Path, title: str, summary: str, facts: Mapping[str, str], sections: Sequence[Section]
) -> Path:
    """Write everything; returns the page. InputError: a file cannot be written."""
    for name in (FIGURES, TABLES):
        output_folder(folder / name)
    pictures = {}
    for section in sections:
        if section.drawing is not None:
            pictures[section.title] = _save(section.drawing, folder / FIGURES)
        for table in (*section.tables, *section.more):
            write_text(folder / TABLES / f"{table.name}.csv", as_csv(table))
    page = rendered(
        _TEMPLATE,
        {"cell": cell},
        title=title,
        summary=summary,
        facts=facts,
        sections=sections,
        pictures=pictures,
    )
    write_text(folder / PAGE, page)
    return folder / PAGE


def as_csv(table: Table) -> str:
    """The table as CSV, with all digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(table.rows)
    return text.getvalue()


def cell(value: Any) -> str:  # noqa: ANN401, whatever stands in a table
    """A cell as it is printed."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if not isinstance(value, float):
        return str(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.2g}"
    return f"{value:.4g}" if abs(value) >= 1000 else f"{value:.3g}"


def _save(drawing: Drawing, folder: Path) -> tuple[Markup, int]:
    """Write PNG and SVG; returns the PNG as a data URL, and how wide to show it [pixels]."""
    figure = drawing.figure()
    for ending in ("svg", "png"):
        with whole_file(folder / f"{drawing.name}.{ending}") as path:
            drawing.save(figure, str(path))
    data = base64.b64encode((folder / f"{drawing.name}.png").read_bytes()).decode()
    url = Markup("data:image/png;base64," + data)  # noqa: S704, digits and letters
    return url, round(_PIXELS_PER_INCH * figure.get_figwidth())
