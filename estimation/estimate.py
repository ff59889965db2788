"""Result of an estimator: parameters with uncertainty."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from html import escape
from textwrap import wrap
from typing import NamedTuple, TypeVar

import numpy as np

from palpate.robot_io.types import BoolArray, FloatArray

_WIDTH = 110  # width of the text in characters
_LARGE = 1e6  # size from which a value is written with an exponent
_MIN_WIDTH = 30  # columns for the last cell of a row, which is wrapped


class Identifiability(StrEnum):
    """Degree to which the data determine all parameters; it does not assess the model."""

    GOOD = "good"
    WEAK = "weak"  # some parameter is known only roughly; `note` says which and what to do
    NONE = "none"  # the data do not determine some parameter


class Determined(StrEnum):
    """Whether the data determine one parameter."""

    YES = "yes"
    ROUGHLY = "roughly"  # the standard error is more than a quarter of the value
    NO = "no"  # the 95 % interval contains zero, or there is none


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter's value with its uncertainty."""

    name: str  # such as "stiffness"
    unit: str  # SI
    value: float  # best estimate
    std_err: float  # standard error, NaN if the method has none
    interval: tuple[float, float]  # 95 % confidence interval (lower, upper)
    at_bound: bool = False  # whether an inner parameter ended at a search bound, so the data give no value
    determined: Determined = Determined.YES  # whether the data determine the value

    @property
    def half_interval(self) -> float:
        """Half the length of the 95 % interval; NaN if there is none."""
        return (self.interval[1] - self.interval[0]) / 2.0


@dataclass(frozen=True)
class Estimate:
    """Result of one estimation: parameters, residuals and diagnostics."""

    estimator: str  # its registered name
    parameters: tuple[ParameterEstimate, ...]  # in the order of the model
    inliers: BoolArray  # samples used in the final fit, shape (n,)
    residuals: FloatArray  # effort minus prediction, shape (n,)
    condition_number: float  # of the scaled columns
    identifiability: Identifiability  # see `Identifiability`
    note: str  # one sentence for the reader
    covariance: FloatArray  # of the parameters, shape (m, m); NaN where unknown
    # Method-specific figures, such as trials or skipped subsets.
    details: dict[str, float] = field(default_factory=dict)
    unphysical: tuple[str, ...] = ()  # gains whose whole interval lies outside the physical bounds

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return the parameter with this name.

        Raises:
            KeyError: there is no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def rmse(self) -> float:
        """Root mean square of the residuals over all samples, with outliers."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def rmse_inliers(self) -> float:
        """Root mean square of the residuals over the inliers."""
        return float(np.sqrt(np.mean(self.residuals[self.inliers] ** 2)))


class DisplayTable(NamedTuple):
    """Table for display: caption, column names and rows of printable values."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]


def interval_text(estimated: ParameterEstimate) -> str:
    """Format a parameter's 95 % interval, and state whether it is at its search bound or not determined.

    Args:
        estimated: parameter with its interval, in its unit; an unknown interval is NaN.

    Returns:
        Both ends with five digits, such as "1.2 to 3.4", or a remark instead of them or after them.
    """
    lower, upper = estimated.interval
    if estimated.at_bound or np.isnan(lower):
        return "at its bound" if estimated.at_bound else "not determined"
    note = " (not determined)" if estimated.determined is Determined.NO else ""
    return f"{lower:.5g} to {upper:.5g}{note}"


class TableDisplay(ABC):
    """A result that prints as one table, also in a notebook."""

    __slots__ = ()

    @abstractmethod
    def _table(self) -> DisplayTable:
        """Return the table to display."""

    def _repr_html_(self) -> str:
        caption, columns, rows = self._table()
        left = ' style="text-align: left"'  # Jupyter would align text right
        head = "".join(f"<th{left}>{escape(name)}</th>" for name in columns)
        body = "".join(
            "<tr>" + "".join(f"<td{left}>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
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
            first, *rest = wrap(row[-1], max(_WIDTH - start, _MIN_WIDTH)) or [""]
            prefix = "".join(f"{cell:<{width}}  " for cell, width in zip(row, widths, strict=False))
            lines += [(prefix + first).rstrip(), *(" " * start + continuation for continuation in rest)]
        return "\n".join(lines)

    __repr__ = __str__


_Result = TypeVar("_Result", bound=TableDisplay)


class TableTuple(tuple[_Result, ...]):
    """Results that print as their tables, one below the other, also in a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return "".join(result._repr_html_() for result in self)

    def __str__(self) -> str:
        return "\n\n".join(map(str, self))

    __repr__ = __str__


def rounded(value: float, digits: int = 3) -> str:
    """Format a value with significant digits, zeros included; from 1 to a million without an exponent.

    Args:
        value: the value.
        digits: number of significant digits.
    """
    text = f"{value:#.{digits}g}".rstrip(".") if value else "0"
    return text if "e+" not in text or abs(value) >= _LARGE else f"{float(text):.0f}"


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """Format a value with its unit, which is omitted if it is "1"; see `rounded`.

    Args:
        value: the value.
        unit: its unit.
        digits: number of significant digits.
    """
    return text_with_unit(rounded(value, digits), unit)


def text_with_unit(text: str, unit: str) -> str:
    """Append a unit to a number in words, unless it is "1".

    Args:
        text: the number.
        unit: its unit.
    """
    return text if unit == "1" else f"{text} {unit}"
