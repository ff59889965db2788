"""A plot made of lines, for curves that change with a revision and not with time.

Rerun's own plots run along a timeline; here the timeline is the revision, and each revision has whole curves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from matplotlib.ticker import MaxNLocator

from palpate.views.colors import Color
from robot_io.types import FloatArray

WIDTH, HEIGHT = 160.0, 90.0  # of the frame in the view's own units
RULE: Color = (62, 72, 84)
INK: Color = (190, 200, 210)
TICKS = 5
LABEL_DROP = 3.5  # Rerun writes words below their point
Word = tuple[tuple[float, float], str]  # place and text


@dataclass(frozen=True)
class Chart:
    """A frame with axes.

    Attributes:
        entity: path below which everything of it lies.
        x: least and largest value of the horizontal axis.
        y: the same for the vertical one.
        x_label: what runs along it, with unit.
        y_label: the same for the vertical one.
        width: of the frame, in the view's own units.
    """

    entity: str
    x: tuple[float, float]
    y: tuple[float, float]
    x_label: str
    y_label: str
    width: float = WIDTH

    def place(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Points (n, 2) in the view, whose vertical axis runs downwards; cut off at the frame."""
        across = (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0])
        up = np.clip((np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]), -0.02, 1.02)
        placed: FloatArray = np.column_stack([self.width * across, HEIGHT * (1.0 - up)])
        return placed

    def draw_frame(self, recording: rr.RecordingStream) -> None:
        """Draw rules and labels, once for all revisions."""
        rules, words = self._upright_rules()
        self._send(recording, [*self._level_rules(), *rules], [*self._scale_words(), *words])

    def draw_scale(self, recording: rr.RecordingStream) -> None:
        """Draw only what belongs to the vertical axis."""
        self._send(recording, self._level_rules(), self._scale_words())

    def _level_rules(self) -> list[FloatArray]:
        return [self.place(np.array(self.x), np.array([value, value])) for value in _ticks(self.y)]

    def _scale_words(self) -> list[Word]:
        beside = [(-7.0, float(rule[0, 1]) - LABEL_DROP) for rule in self._level_rules()]
        words = [(place, f"{value:g}") for place, value in zip(beside, _ticks(self.y), strict=True)]
        return [*words, ((14.0, -11.0), self.y_label)]

    def _upright_rules(self) -> tuple[list[FloatArray], list[Word]]:
        values = _ticks(self.x)
        rules = [self.place(np.array([value, value]), np.array(self.y)) for value in values]
        below = [((float(r[0, 0]), HEIGHT + 1.0), f"{v:g}") for r, v in zip(rules, values, strict=True)]
        return rules, [*below, ((self.width / 2, HEIGHT + 8.0), self.x_label)]

    def _send(self, recording: rr.RecordingStream, rules: list[FloatArray], words: list[Word]) -> None:
        lines = rr.LineStrips2D(rules, colors=RULE, radii=rr.Radius.ui_points(0.5))
        recording.log(f"{self.entity}/frame", lines, static=True)
        places, labels = zip(*words, strict=True)
        written = rr.Points2D(places, labels=labels, colors=INK, radii=0.0, show_labels=True)
        recording.log(f"{self.entity}/words", written, static=True)

    def strips(
        self, curves: Sequence[tuple[FloatArray, FloatArray]], color: Color, width: float
    ) -> rr.LineStrips2D:
        """Curves (x, y) of one colour; values that are not finite are left out."""
        finite = [(x[np.isfinite(y)], y[np.isfinite(y)]) for x, y in curves]
        placed = [self.place(x, y) for x, y in finite if len(x) > 1]
        return rr.LineStrips2D(placed, colors=color, radii=rr.Radius.ui_points(width / 2))


def span_of(values: FloatArray, margin: float = 0.06) -> tuple[float, float]:
    """Least and largest of finite values, with room around them."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    room = margin * (high - low) or 1.0
    return low - room, high + room


def _ticks(span: tuple[float, float]) -> list[float]:
    values = MaxNLocator(TICKS).tick_values(*span)
    return [round(float(v), 12) for v in values if span[0] <= v <= span[1]]
