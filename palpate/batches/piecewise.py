"""Fit constants and lines between the dates of change of a series."""

from collections.abc import Mapping, Set
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from palpate.batches.statistics import neighbor_spread_squared
from palpate.robot_io.types import FloatArray

LEAST = 10  # smallest number of measurements of a tested series, and of a line
SIDE = 3  # smallest number of measurements of a constant
_ROUNDS = 3
_SWEEPS = 10


class Segment(NamedTuple):
    """Part of a series in which its level is constant or a line."""

    begin: int  # first place
    end: int  # place after the last
    sloped: bool  # whether it is a line


class PiecewiseFit:
    """Weighted least squares of constants and lines, with the places of their borders.

    Schwarz's criterion (Ann. Stat. 6 (1978) 461; for dates of change Y.-C. Yao, Stat. Probab. Lett. 6 (1988)
    181) selects among the borders that tests found significant, so that one line replaces many small steps.
    Each border is then moved to the best place between its neighbors, since the changes found later disturbed
    the first choice (J. Bai, Econom. Theory 13 (1997) 315).

    Args:
        times: shape (n,).
        values: shape (n,).
        std_errs: standard errors of the values, shape (n,); zero where unknown.
        borders: p-value of a step at each place that a test found.
        slopes: p-value of a slope in each part, from its begin to its end, that a test found.
        stepped: parts in which a test found a step or an excursion to explain more than a slope.
    """

    def __init__(  # noqa: PLR0917, a series and what tests found in it
        self,
        times: FloatArray,
        values: FloatArray,
        std_errs: FloatArray,
        borders: Mapping[int, float],
        slopes: Mapping[tuple[int, int], float],
        stepped: Set[tuple[int, int]],
    ) -> None:
        self._times, self._values, self._std_errs = times, values, std_errs
        self._slopes, self._stepped = slopes, stepped
        self.p_values = dict(borders)  # by border
        self.segments = [Segment(*ends, self._may_slope(*ends)) for ends in pairwise(self._places())]
        for _ in range(_ROUNDS):
            self._fit()
            self._move_borders()
            self._select()
        self._fit()

    def difference(self, first: int, second: int) -> tuple[float, float, float]:
        """Return the levels at two places, and the standard error of their difference.

        Args:
            first: first place.
            second: second place.
        """
        before, after = self._columns[first], self._columns[second]
        variance = (after - before) @ self._information @ (after - before)
        return float(before @ self._coefficients), float(after @ self._coefficients), float(np.sqrt(variance))

    def slope_p_value(self, begin: int, end: int) -> float:
        """Return the smallest p-value of the slopes found around a line, or of the steps that it replaces.

        Args:
            begin: first place of a line.
            end: place after its last.
        """
        around = [p for ends, p in self._slopes.items() if ends[0] < end and begin < ends[1]]
        return min(around or [p for border, p in self.p_values.items() if begin < border < end], default=1.0)

    def _places(self) -> list[int]:
        return [0, *sorted(self.p_values), len(self._values)]

    def _may_slope(self, begin: int, end: int) -> bool:
        """Return whether a test found a slope around a segment, or borders that a line may replace."""
        found = any(ends[0] < end and begin < ends[1] for ends in self._slopes)
        found |= any(begin < border < end for border in self.p_values)
        return found and end - begin >= LEAST and (begin, end) not in self._stepped

    def _fit(self) -> None:
        """Fit all segments jointly, and set the weights from the scatter of the residual."""
        columns = []
        for begin, end, sloped in self.segments:
            inside = np.zeros(len(self._values))
            inside[begin:end] = 1.0
            columns += [inside, inside * (self._times - self._times[begin])][: 1 + sloped]
        self._columns = np.column_stack(columns)
        weights = np.ones(len(self._values))
        tiny = 1e-12 * float(np.mean(self._values**2))
        for _ in range(3):  # the residual shows the scatter, and so the weights of the next fit
            weighted = weights[:, None] * self._columns
            self._information = np.linalg.pinv(self._columns.T @ weighted, hermitian=True)
            self._coefficients = self._information @ weighted.T @ self._values
            residual = self._values - self._columns @ self._coefficients
            scatter = neighbor_spread_squared(residual, self._std_errs)
            weights = 1.0 / (max(scatter, tiny) + self._std_errs**2)
        t, y = self._times - self._times.mean(), self._values - self._values.mean()
        products = np.column_stack([np.ones(len(t)), t, t * t, y, t * y, y * y])
        self._sums = np.pad(np.cumsum(weights[:, None] * products, axis=0), ((1, 0), (0, 0)))

    def _misfit(self, begin: Any, end: Any, sloped: bool) -> FloatArray:  # noqa: ANN401
        """Weighted sums of squared residuals of segments, given the arrays or numbers of their ends."""
        w, wt, wtt, wy, wty, wyy = np.atleast_2d(self._sums[end] - self._sums[begin]).T
        misfit = wyy - wy**2 / w
        if sloped:
            misfit -= (wty - wt * wy / w) ** 2 / np.maximum(
                wtt - wt**2 / w, 1e-12 * wtt + np.finfo(float).tiny
            )
        return np.asarray(np.maximum(misfit, 0.0))

    def _move_borders(self) -> None:
        """Move each border to its best place between its neighbors, until none moves."""
        for _ in range(_SWEEPS):
            before = list(self.segments)
            for number, ((_, border, first), (_, end, second)) in enumerate(pairwise(before)):
                begin = self.segments[number].begin  # which may have just moved
                least = [LEAST if sloped else SIDE for sloped in (first, second)]
                places = np.arange(begin + least[0], end - least[1] + 1)
                if not len(places):
                    continue
                misfits = self._misfit(begin, places, first) + self._misfit(places, end, second)
                best = int(places[np.argmin(misfits)])
                self.p_values[best] = self.p_values.pop(border)
                self.segments[number : number + 2] = Segment(begin, best, first), Segment(best, end, second)
            if self.segments == before:
                break

    def _select(self) -> None:
        """Choose the borders and lines with the least misfit and penalty (dynamic programming)."""
        penalty = float(np.log(len(self._values)))
        places = self._places()
        best: dict[int, tuple[float, list[Segment]]] = {0: (0.0, [])}
        for number, end in enumerate(places[1:], 1):
            options: list[tuple[float, list[Segment]]] = []
            for begin in places[:number]:
                for sloped in (False, True)[: 1 + self._may_slope(begin, end)]:
                    parameters = 1 + sloped + (begin > 0)  # level, slope, and place of the border
                    misfit = best[begin][0] + float(self._misfit(begin, end, sloped)[0])
                    segment = Segment(begin, end, sloped)
                    options.append((misfit + penalty * parameters, [*best[begin][1], segment]))
            best[end] = min(options)
        self.segments = best[places[-1]][1]
