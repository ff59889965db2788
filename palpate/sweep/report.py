"""Write the results of a sweep: figures (PNG and SVG), tables (CSV), and one page (HTML)."""

import base64
import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from palpate.common.files import atomic_write, output_folder, write_text
from palpate.render.report import rendered
from palpate.sweep import figures
from palpate.sweep.case import Row
from palpate.sweep.grid import GridFile
from palpate.sweep.rows import SweepTable, error_table, grouped

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
_PIXELS_PER_INCH = 132
_TEMPLATE = Path(__file__).parent / "page.html"


@dataclass(frozen=True)
class ReportSection:
    """Section of the page."""

    title: str  # heading
    drawing: Figure | None  # figure, whose label is the name of its files, or None
    words: tuple[str, ...] = ()  # paragraphs
    tables: tuple[SweepTable, ...] = ()  # tables shown on the page and written as CSV
    more: tuple[SweepTable, ...] = ()  # tables written as CSV only


def write_page(
    folder: Path, title: str, summary: str, facts: Mapping[str, str], sections: Sequence[ReportSection]
) -> Path:
    """Write all files, and return the page; raise `InputError` if a file cannot be written.

    Args:
        folder: destination.
        title: title of the page.
        summary: text below the title.
        facts: facts to list, by name.
        sections: sections in order.
    """
    for name in (FIGURES, TABLES):
        output_folder(folder / name)
    pictures = {}
    for section in sections:
        if section.drawing is not None:
            figure, name = section.drawing, str(section.drawing.get_label())
            for ending in ("svg", "png"):
                with atomic_write(folder / FIGURES / f"{name}.{ending}") as path:
                    figures.save(figure, str(path))
            data = base64.b64encode((folder / FIGURES / f"{name}.png").read_bytes()).decode()
            url = Markup("data:image/png;base64," + data)  # noqa: S704, digits and letters
            pictures[section.title] = url, round(_PIXELS_PER_INCH * figure.get_figwidth())
        for table in (*section.tables, *section.more):
            text = io.StringIO()
            csv.writer(text, lineterminator="\n").writerows([table.columns, *table.rows])
            write_text(folder / TABLES / f"{table.name}.csv", text.getvalue())
    about = {"title": title, "summary": summary, "facts": facts}
    page = rendered(_TEMPLATE, {"cell": cell}, **about, sections=sections, pictures=pictures)
    write_text(folder / PAGE, page)
    return folder / PAGE


def cell(value: Any) -> str:  # noqa: ANN401, any value of a table
    """Format a cell.

    Args:
        value: text, number or None.
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if not isinstance(value, float):
        return str(value)
    if value and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.2g}"
    return f"{value:.0f}" if abs(value) >= 999.5 else f"{value:.3g}"


_NOT_SHOWN = ("seconds", "error")
_WORDS = (
    "Ticks are single estimates, dots are medians. “Over bound” is the root mean square error over the "
    "Cramér-Rao bound for this noise and an unknown surface; it is meaningless if the model lacks a hidden "
    "effect."
)


def write_grid(
    folder: Path, title: str, grid: GridFile, rows: Sequence[Row], facts: Mapping[str, str]
) -> Path:
    """Write figures, tables and page of a grid; return the page, or raise `InputError` on failure.

    Args:
        folder: destination.
        title: title of the page.
        grid: the sweep's file.
        rows: rows of all finished cases.
        facts: facts to list, by name.
    """
    good = [row for row in rows if not row["error"]]
    if grid.diagnose:
        columns = ("truth", "truth_channel", "channel", "verdict", "accepted")
        # rows of older sweeps do not state the channel of the hidden effect
        verdicts = grouped(good, lambda row: tuple(row.get(name, "") for name in columns))
        names = ("hidden", "hidden in", "channel", "verdict", "effects named", "cases")
        counts = tuple((*key, len(own)) for key, own in sorted(verdicts.items()))
        table = SweepTable("verdicts", "What the diagnosis said", names, counts)
        sections = [ReportSection("Diagnosis", None, (), (table,))]
    else:
        table = error_table("errors", "All cases", rows)
        sections = [ReportSection("Errors by estimator", figures.error_spread(rows), (_WORDS,), (table,))]
        groups = grouped(good, itemgetter("law", "speeds_mm_s", "noise_std_n", "noise_percent", "hidden"))
        if len(groups) > 1:
            by_condition = []
            for number, ((law, speeds, std, percent, hidden), own) in enumerate(groups.items(), 1):
                heading = f"{law}, {speeds} mm/s, noise {std:g} N and {percent:g} %, hidden: {hidden}"
                by_condition.append(error_table(f"errors_{number}", heading, own))
            sections.append(ReportSection("By condition", None, (), tuple(by_condition)))
    why = grouped(
        (row for row in rows if row["error"] or row.get("problem")),
        lambda row: row["error"] or f"{row['estimator']}: {row['problem']}",
    )
    lines = tuple((text, len(own)) for text, own in why.items())
    tables = (SweepTable("failures", "Why a case has no result", ("why", "cases"), lines),) if lines else ()
    sections.append(ReportSection("Cases without a result", None, (), tables))
    keys = tuple(dict.fromkeys(key for row in rows for key in row if key not in _NOT_SHOWN))
    every = SweepTable("cases", "Every row", keys, tuple(tuple(row.get(key) for key in keys) for row in rows))
    sections[0] = replace(sections[0], more=(every,))
    shown = [section for section in sections if section.words or section.tables]
    return write_page(folder, title, grid.description, facts, shown)
