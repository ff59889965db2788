"""Curves drawn with characters, for a terminal: the dots of Braille, two across and four down a character."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.text import Text

from robot_io.types import BoolArray, FloatArray

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # Unicode, block Braille Patterns
_BLANK = 0x2800
Curve = tuple[FloatArray, FloatArray, str]  # x (n,), y (n,), colour


def drawing(first: Curve, second: Curve, width: int, height: int) -> list[Text]:
    """Two curves over one frame, line by line: the first as points "·", the second over it in Braille.

    Args:
        first: what is compared with, drawn so that it is told apart without colours too.
        second: what is shown.
        width: in characters.
        height: in lines.
    """
    frame = [_span(np.concatenate([first[axis], second[axis]])) for axis in (0, 1)]
    behind = _raster(first, frame, width, height).reshape(height, 4, width, 2).max(axis=(1, 3))
    dots = _raster(second, frame, width, height).reshape(height, 4, width, 2)
    codes = np.einsum("hdwc,dc->hw", dots.astype(np.int64), _DOTS)
    return [_line(row, under, first[2], second[2]) for row, under in zip(codes, behind, strict=True)]


def beside(titles: Sequence[str], drawings: Sequence[Sequence[Text]], gap: int = 3) -> Iterator[Text]:
    """Drawings of the same height beside each other, each below its title."""
    width = max(len(line) for lines in drawings for line in lines)
    yield Text((" " * gap).join(title.ljust(width) for title in titles), style="dim")
    for lines in zip(*drawings, strict=True):
        yield Text(" " * gap).join(lines)


def _line(codes: np.ndarray, behind: BoolArray, color_behind: str, color: str) -> Text:
    line = Text()
    for code, under in zip(codes.tolist(), behind.tolist(), strict=True):
        if code:
            line.append(chr(_BLANK + code), style=color)
        else:
            line.append("·" if under else " ", style=color_behind)
    return line


def _span(values: FloatArray) -> tuple[float, float]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return low, high if high > low else low + 1.0


def _raster(curve: Curve, frame: Sequence[tuple[float, float]], width: int, height: int) -> BoolArray:
    """Which dots (4 height, 2 width) a curve meets, with as many points between its samples as needed."""
    dots = np.zeros((4 * height, 2 * width), dtype=np.bool_)
    shares = [(values - low) / (high - low) for values, (low, high) in zip(curve[:2], frame, strict=True)]
    across, up = shares[0] * (2 * width - 1), shares[1] * (4 * height - 1)
    steps = np.maximum(np.abs(np.diff(across)), np.abs(np.diff(up)))
    place = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-9))])
    fine = np.linspace(0.0, place[-1], 2 * int(np.ceil(place[-1])) + 2)
    columns, rows = (np.rint(np.interp(fine, place, values)).astype(int) for values in (across, up))
    dots[4 * height - 1 - rows, columns] = True
    return dots
