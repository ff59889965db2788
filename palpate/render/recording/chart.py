"""A plot made of lines, for curves that change with a revision and not with time.

Rerun's own plots run along a timeline; here the timeline is the revision, and each revision has whole curves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from palpate.render import palette
from robot_io.types import FloatArray

WIDTH, HEIGHT = 160.0, 90.0  # of the frame in the view's own units
_RULE, _INK = (62, 72, 84), (190, 200, 210)
_TICKS = 5
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
_LABEL_DROP = 3.5  # Rerun writes words below their point
_FILL = 0.6  # height of the lines that fill a bar: Rerun only outlines boxes
_BAR_WIDTH = 24.0


@dataclass(frozen=True)
class Chart:
    """A frame with axes."""

    entity: str  # path below which everything of it lies
    x: tuple[float, float]  # least and largest value of the horizontal axis
    y: tuple[float, float]  # the same for the vertical one
    x_label: str  # what runs along it, with unit
    y_label: str  # the same for the vertical one
    width: float = WIDTH  # of the frame, in the view's own units

    def place(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Points (n, 2) in the view, whose vertical axis runs downwards; cut off at the frame."""
        across = (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0])
        up = np.clip((np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]), -0.02, 1.02)
        placed: FloatArray = np.column_stack([self.width * across, HEIGHT * (1.0 - up)])
        return placed

    def draw_frame(self, recording: rr.RecordingStream, *, upright: bool = True) -> None:
        """Draw rules and labels, once for all revisions; of the vertical axis alone without `upright`."""
        rules = [self.place(np.array(self.x), np.full(2, value)) for value in ticks(*self.y)]
        words = [
            ((-7.0, float(rule[0, 1]) - _LABEL_DROP), f"{value:g}")
            for rule, value in zip(rules, ticks(*self.y), strict=True)
        ]
        words.append(((14.0, -11.0), self.y_label))
        if upright:
            across = [self.place(np.full(2, value), np.array(self.y)) for value in ticks(*self.x)]
            below = zip(across, ticks(*self.x), strict=True)
            words += [((float(rule[0, 0]), HEIGHT + 1.0), f"{value:g}") for rule, value in below]
            words.append(((self.width / 2, HEIGHT + 8.0), self.x_label))
            rules += across
        lines = rr.LineStrips2D(rules, colors=_RULE, radii=rr.Radius.ui_points(0.5))
        recording.log(f"{self.entity}/frame", lines, static=True)
        places, labels = zip(*words, strict=True)
        written = rr.Points2D(places, labels=labels, colors=_INK, radii=0.0, show_labels=True)
        recording.log(f"{self.entity}/words", written, static=True)

    def strips(
        self, curves: Sequence[tuple[FloatArray, FloatArray]], color: str, width: float
    ) -> rr.LineStrips2D:
        """Curves (x, y) of one colour; values that are not finite are left out."""
        finite = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in curves]
        placed = [self.place(x, y) for x, y in finite if len(x) > 1]
        return rr.LineStrips2D(placed, colors=palette.rgb(color), radii=rr.Radius.ui_points(width / 2))

    def log_bar(  # noqa: PLR0917, what a bar is drawn from
        self,
        recording: rr.RecordingStream,
        name: str,
        middle: float,
        height: float,
        color: str,
        text: str,
        *,
        static: bool,
    ) -> None:
        """A bar from zero up to a value, with its words above."""
        entity, top = f"{self.entity}/{name}", float(self.place(np.zeros(1), np.array([height]))[0, 1])
        left, right = middle - _BAR_WIDTH / 2, middle + _BAR_WIDTH / 2
        heights = np.linspace(HEIGHT, top, max(2, round((HEIGHT - top) / _FILL)))
        lines = [[[left, y], [right, y]] for y in heights]
        filled = rr.LineStrips2D(lines, colors=palette.rgb(color), radii=_FILL / 2 + 0.1)
        recording.log(entity, filled, static=static)
        recording.log(f"{entity}/word", label((middle, top - 9.0), text, color), static=static)


def label(place: tuple[float, float], text: str, color: str) -> rr.Points2D:
    """Words at a place in a chart."""
    return rr.Points2D([place], labels=[text], colors=palette.rgb(color), radii=0.0, show_labels=True)


def span_of(values: FloatArray, margin: float = 0.06) -> tuple[float, float]:
    """Least and largest of finite values, with room around them."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    room = margin * (high - low) or 1.0
    return low - room, high + room


def ticks(low: float, high: float) -> list[float]:
    """Round values from low to high, about five."""
    least = (high - low) / _TICKS
    unit = 10.0 ** np.floor(np.log10(least))
    step = next(factor * unit for factor in _STEPS if factor * unit >= least * (1.0 - 1e-9))
    counts = np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)
    return [round(float(value), 12) + 0.0 for value in counts * step]  # no -0
