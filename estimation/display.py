"""Display results as small tables: HTML in a notebook, text in a terminal, both from the same rows."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from textwrap import wrap
from typing import NamedTuple

from palpate.estimation.estimate import ParameterEstimate

_WIDTH = 110  # columns of a terminal that the text fills
_NARROWEST = 30  # columns for the last cell of a row, which is wrapped


class DisplayTable(NamedTuple):
    """A caption, the names of the columns, and rows of what can be printed."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


def interval_text(estimated: ParameterEstimate) -> str:
    """A parameter's 95 % interval, or that it is at the bound of its search."""
    lower, upper = estimated.interval
    return "at its bound" if estimated.at_bound else f"{lower:.5g} to {upper:.5g}"


class TableDisplay(ABC):
    """A result that prints as one table, also in a notebook."""

    __slots__ = ()

    @abstractmethod
    def _table(self) -> DisplayTable:
        """The table to display."""

    def _repr_html_(self) -> str:
        caption, columns, rows = self._table()
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
        )
        title = f"<caption>{escape(caption.strip())}</caption>"
        return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"

    def __str__(self) -> str:
        caption, columns, rows = self._table()
        cells = [list(columns), *([str(cell) for cell in row] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)][:-1]
        start = sum(widths) + 2 * len(widths)
        lines = wrap(caption.strip(), _WIDTH)
        for row in cells:
            first, *rest = wrap(row[-1], max(_WIDTH - start, _NARROWEST)) or [""]
            begin = "".join(f"{cell:<{width}}  " for cell, width in zip(row, widths, strict=False))
            lines += [(begin + first).rstrip(), *(" " * start + more for more in rest)]
        return "\n".join(lines)

    __repr__ = __str__
