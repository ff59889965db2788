"""What any grid of one's own shows: errors by estimator and condition, or what the diagnosis said."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from palpate.sweep import figures
from palpate.sweep.case import Row
from palpate.sweep.grid import GridFile
from palpate.sweep.page import Section, write_page
from palpate.sweep.summary import Table, error_table, grouped

_NOT_SHOWN = ("seconds", "error")
_WORDS = (
    "Ticks are single estimates, dots are medians. “Over bound” is the root mean square error over the "
    "Cramér-Rao bound for this noise, the surface being unknown; it means nothing where something is hidden "
    "that the model lacks."
)


def write_grid(
    folder: Path, title: str, grid: GridFile, rows: Sequence[Row], facts: Mapping[str, str]
) -> Path:
    """Write figure, tables and page of a grid; returns the page. InputError: a file cannot be written."""
    sections = [_verdicts(rows)] if grid.diagnose else _estimates(rows)
    sections.append(_failures(rows))
    sections[0] = Section(**vars(sections[0]) | {"more": (_all_rows(rows),)})
    return write_page(
        folder, title, grid.description, facts, [one for one in sections if one.words or one.tables]
    )


def _estimates(rows: Sequence[Row]) -> list[Section]:
    first = Section(
        "Errors by estimator",
        figures.error_spread(rows),
        (_WORDS,),
        (error_table("errors", "All cases", rows),),
    )
    keys = ("law", "speeds_mm_s", "noise_std_n", "noise_percent", "hidden")
    groups = grouped((row for row in rows if not row["error"]), lambda row: tuple(row[key] for key in keys))
    if len(groups) < 2:
        return [first]
    tables = tuple(
        error_table(
            f"errors_{number}",
            f"{law}, {speeds} mm/s, noise {std:g} N and {percent:g} %, hidden: {hidden}",
            own,
        )
        for number, ((law, speeds, std, percent, hidden), own) in enumerate(groups.items(), 1)
    )
    return [first, Section("By condition", None, (), tables)]


def _verdicts(rows: Sequence[Row]) -> Section:
    said = grouped(
        (row for row in rows if not row["error"]),
        lambda row: (row["truth"], row["channel"], row["verdict"], row["accepted"]),
    )
    lines = tuple((*key, len(own)) for key, own in sorted(said.items()))
    table = Table(
        "verdicts",
        "What the diagnosis said",
        ("hidden", "channel", "verdict", "effects named", "cases"),
        lines,
    )
    return Section("Diagnosis", None, (), (table,))


def _failures(rows: Sequence[Row]) -> Section:
    why = grouped(
        (row for row in rows if row["error"] or row.get("problem")),
        lambda row: row["error"] or f"{row['estimator']}: {row['problem']}",
    )
    lines = tuple((text, len(own)) for text, own in why.items())
    tables = (Table("failures", "Why a case has no result", ("why", "cases"), lines),) if lines else ()
    return Section("Cases without a result", None, (), tables)


def _all_rows(rows: Sequence[Row]) -> Table:
    names = tuple(dict.fromkeys(key for row in rows for key in row if key not in _NOT_SHOWN))
    return Table("cases", "Every row", names, tuple(tuple(row.get(name) for name in names) for row in rows))
