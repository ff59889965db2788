"""Find steps and drifts of parameters over time that exceed the scatter between measurements."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np
import pyarrow as pa

from palpate.batches.piecewise import LEAST, SIDE, PiecewiseFit
from palpate.batches.statistics import neighbor_spread_squared
from palpate.batches.table import BUDGET, floats, parameter_columns, texts
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray

LEVEL = 0.01  # probability of a false alarm in a whole table
_PERMUTATIONS = 1_000  # least number of permutations of a series that may have changed
_MOST_VALUES = 100_000  # values of all permutations at a time, few enough for the processor's cache
_MOST_LARGER = 20  # permutations with as large a change that end the test (Besag and Clifford, 1991)
_BESIDE = 2  # neighbors on each side with which a value is compared
_ISOLATED = 8.0  # robust standard deviations from the nearest neighbor beyond which a value is left out
_MOST_ISOLATED = 0.1  # largest share of such values
_SECONDS_A_DAY = 86_400.0
_MONTH = re.compile(r"\d{4}-\d\d")
DATES = ("date", "day", "night", "time", "datetime", "timestamp")  # fields that are taken for a time


@dataclass(frozen=True, eq=False)
class Series:
    """One quantity of a channel over time."""

    group: str
    channel: str
    name: str  # "effect.parameter", "times_noise", or "budget KIND"
    unit: str  # empty for a share or ratio
    rows: np.ndarray[Any, np.dtype[np.int64]]  # rows of the table in the order of time, shape (n,)
    times: FloatArray  # days or counts, shape (n,)
    values: FloatArray  # shape (n,), in the unit
    std_errs: FloatArray  # shape (n,), in the unit; zero where unknown
    left_out: tuple[tuple[int, float], ...] = ()  # rows of the table with isolated values, and these values

    @property
    def is_constant(self) -> bool:
        """Whether all values are equal, so that there is nothing to test."""
        return bool(np.ptp(self.values) == 0.0)


@dataclass(frozen=True)
class TrendChange:
    """A step or a drift of a series."""

    kind: str  # "step" or "drift"
    first: int  # place in the series: first measurement after a step, or at which a drift begins
    last: int  # last measurement of a drift, or of the level after a step, which may itself drift
    before: float  # value before a step, or at the beginning of a drift
    after: float  # value after a step, or at the end of a drift
    std_err: float  # standard error of the difference
    p_value: float  # probability of as large a change by chance, in this series alone


def time_axis(table: pa.Table, field: str | None = None) -> tuple[FloatArray, list[str], str]:
    """Return times of the rows, their labels, and the kind of time.

    Args:
        table: table of a batch.
        field: column of dates (ISO 8601) or numbers; None for a column with a usual name, else the row order.

    Returns:
        Times (n,), in days where they are dates; labels; "date", "count", or the name of a column of numbers.

    Raises:
        InputError: there is no such column, a cell in it is neither date nor number, only some dates have a
            time zone, or all measurements have the same time.
    """
    usual = [name for name in table.column_names if name.lower() in DATES]
    names = [field] if field else sorted(usual, key=lambda name: len(set(texts(table, name))) == 1)
    measurement = texts(table, "measurement")
    for name in names:
        if name not in table.column_names:
            raise InputError(f"--date {name}: no such column. Available: {', '.join(table.column_names)}")
        labels = texts(table, name)
        unread = [len(labels)]  # first row that each reader cannot read
        for read, what in ((_days, "date"), (_number, name)):
            times = [read(label) for label in labels]
            known = [time for time in times if time is not None]
            if len(known) == len(labels):
                zoned = [_moment(label).tzinfo is not None for label in labels] if what == "date" else []
                if len(set(zoned)) == 2:  # their order is unknown
                    with_zone, without = zoned.index(True), zoned.index(False)
                    raise InputError(
                        f"column {name}: {labels[with_zone]!r} in row {with_zone + 1} has a time zone, but "
                        f"{labels[without]!r} in row {without + 1} has none; give all dates with a time "
                        "zone, or none"
                    )
                if len(set(known)) == 1 and (several := len(set(measurement))) >= LEAST:
                    raise InputError(
                        f"column {name}: all {several} measurements have the same value, {labels[0]}, so "
                        "they have no order in time; choose another column with --date"
                    )
                return np.array(known), labels, what
            if known:
                unread.append(times.index(None))
        if (row := min(unread)) < len(labels):
            raise InputError(
                f"column {name}, row {row + 1}: {labels[row]!r} is not a date or number like the others; "
                "give dates such as 2026-11-23, or numbers"
            )
        if field:
            raise InputError(f"--date {field}: give dates such as 2026-11-23, or numbers (not {labels[0]!r})")
    number = {name: float(place) for place, name in enumerate(dict.fromkeys(measurement), 1)}
    return np.array([number[name] for name in measurement]), measurement, "count"


def _moment(text: str) -> datetime:
    """Return a date or time (ISO 8601), also a month such as 2026-03; raise `ValueError` for other texts."""
    return datetime.fromisoformat(f"{text}-01" if _MONTH.fullmatch(text) else text)


def _days(text: str) -> float | None:
    """Return the days since 1970 of a date or time; None for other texts."""
    try:
        moment = _moment(text)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp() / _SECONDS_A_DAY


def _number(text: str) -> float | None:
    """Return a finite number; None for other texts."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def all_series(table: pa.Table, times: FloatArray) -> Iterator[Series]:
    """Yield each parameter, the ratio of error to noise, and each kind's share, by channel and group.

    Series with fewer than `LEAST` values are omitted. Isolated values of a parameter are left out, since one
    of them would inflate the scatter and hide a step.

    Args:
        table: table of a batch.
        times: times of its rows, shape (n,).
    """
    group, channel = np.array(texts(table, "group")), np.array(texts(table, "channel"))
    columns = [
        (column.channel, column.name, column.unit, column.rows, column.values, column.std_errs)
        for column in parameter_columns(table)
    ]
    times_noise = floats(table, "times_noise")
    shares = [name for name in table.column_names if name.startswith(BUDGET)]
    for item in filter(None, dict.fromkeys(channel.tolist())):
        for name in ("times_noise", *shares):
            judged = np.flatnonzero((channel == item) & np.isfinite(times_noise))
            values = np.nan_to_num(floats(table, name)[judged])  # no share: the error passes for noise
            columns.append((item, name, "", judged, values, np.zeros(len(judged))))
    for item, name, unit, rows, values, std_errs in columns:
        for part in dict.fromkeys(group[rows].tolist()):
            own = np.flatnonzero(group[rows] == part)
            own = own[np.argsort(times[rows[own]], kind="stable")]
            if len(own) < LEAST:
                continue
            left_out: tuple[tuple[int, float], ...] = ()
            if np.any(std_errs[own]):  # the ratio to the noise and shares have none; their scatter is skewed
                isolated = is_isolated(values[own])
                alone, own = own[isolated], own[~isolated]
                left_out = tuple(zip(rows[alone].tolist(), values[alone].tolist(), strict=True))
            at = rows[own]
            yield Series(part, item, name, unit, at, times[at], values[own], std_errs[own], left_out)


def is_isolated(values: FloatArray) -> BoolArray:
    """Return which values are far from each of their neighbors, as after a failed measurement, shape (n,).

    Values after a step or in an excursion have a close neighbor. If more than a tenth of the values has none,
    the series scatters in this way, and none is isolated.

    Args:
        values: series in the order of time, shape (n,).
    """
    count, none = len(values), np.zeros(len(values), dtype=np.bool_)
    if count < LEAST:
        return none
    places = np.arange(count)[:, None] + np.delete(np.arange(-_BESIDE, _BESIDE + 1), _BESIDE)
    away = np.abs(values[:, None] - values[places.clip(0, count - 1)])
    away[(places < 0) | (places >= count)] = np.inf
    scale = MAD_TO_SIGMA * float(np.median(np.abs(np.diff(values)))) / np.sqrt(2.0)
    alone = (away.min(axis=1) > _ISOLATED * scale) & (scale > 0.0)
    return alone if np.count_nonzero(alone) <= _MOST_ISOLATED * count else none


def find_changes(series: Series, level: float) -> list[TrendChange]:
    """Find steps and drifts of a series, in order of time; an excursion is two steps.

    The largest step, excursion and slope are tested together by permutation of the values (circular binary
    segmentation, A. B. Olshen et al., Biostatistics 5 (2004) 557). A step or excursion that is significant
    divides the series, and its parts are searched in the same way. A drift does not: steps and excursions
    beside it are then searched. The scale comes from differences between neighbors, which neither a step nor
    a drift changes much. `PiecewiseFit` chooses among all of these, dates them again and fits their sizes
    jointly. A change must exceed its standard error (95 %).

    Args:
        series: n values.
        level: probability of a false alarm.
    """
    rng = np.random.default_rng(1)
    borders: dict[int, float] = {}
    slopes: dict[tuple[int, int], float] = {}
    stepped: set[tuple[int, int]] = set()
    parts = [(0, len(series.values))]
    while parts:
        begin, end = parts.pop()
        if end - begin < LEAST:
            continue
        part = slice(begin, end)
        own = series.times[part], series.values[part], series.std_errs[part]
        p_value, places = _largest_change(*own, level, rng, beside_slope=False)
        if p_value <= level and not places:
            slopes[begin, end] = p_value
            p_value, places = _largest_change(*own, level, rng, beside_slope=True)
        elif p_value <= level:
            stepped.add((begin, end))
        if p_value <= level:
            edges = [begin, *(begin + place for place in places), end]
            borders |= dict.fromkeys(edges[1:-1], p_value)
            parts += pairwise(edges)
    if not borders and not slopes:
        return []
    fit = PiecewiseFit(series.times, series.values, series.std_errs, borders, slopes, stepped)
    changes = []
    for begin, end, sloped in fit.segments:
        if begin:
            last = begin if sloped else end - 1
            sizes = fit.difference(begin - 1, begin)
            changes.append(TrendChange("step", begin, last, *sizes, fit.p_values[begin]))
        if sloped:
            sizes = fit.difference(begin, end - 1)
            changes.append(TrendChange("drift", begin, end - 1, *sizes, fit.slope_p_value(begin, end)))
    return [change for change in changes if abs(change.after - change.before) > SIGMAS_95 * change.std_err]


def _largest_change(
    times: FloatArray,
    values: FloatArray,
    std_errs: FloatArray,
    level: float,
    rng: np.random.Generator,
    *,
    beside_slope: bool,
) -> tuple[float, list[int]]:
    """Return the p-value of the largest change in n values, and the borders that it has; a drift has none."""
    count, away = len(values), times - times.mean()
    root = (neighbor_spread_squared(values, std_errs) + std_errs**2) ** -0.5
    null = np.vander(away, 1 + beside_slope)  # what is there without the change
    scaled = root * (values - null @ np.linalg.lstsq(root[:, None] * null, root * values)[0])
    basis = np.linalg.qr(null)[0]
    begins, ends = _stretches(count)
    # An excursion has so many more places than a step that chance alone would make it the largest.
    steps = np.count_nonzero(ends == count)
    advantage = np.where(ends < count, 2.0 * np.log(max(len(ends) / steps - 1.0, 1.0)), 0.0)
    drift = away / max(float(np.linalg.norm(away)), np.finfo(float).tiny) * (not beside_slope)

    known = np.pad(np.cumsum(basis, axis=0), ((1, 0), (0, 0)))
    size = ends - begins - np.sum((known[ends] - known[begins]) ** 2, axis=1)

    def statistics(scaled: FloatArray) -> FloatArray:
        """Return squared z values (K + 1, m) of m series (n, m): a row for each stretch, one for a drift."""
        rest = scaled - basis @ (basis.T @ scaled)
        # Half the mean squared difference of neighbors (von Neumann, Ann. Math. Stat. 12 (1941) 367).
        variance = 1e-200 + 0.5 * np.mean(np.diff(scaled, axis=0) ** 2, axis=0)
        sums = np.pad(np.cumsum(rest, axis=0), ((1, 0), (0, 0)))
        stretches = (sums[ends] - sums[begins]) ** 2 / (size[:, None] * variance) - advantage[:, None]
        return np.vstack([stretches, (drift @ rest) ** 2 / variance])

    observed = statistics(scaled[:, None])
    larger = tried = 0
    several = max(1, min(_PERMUTATIONS, _MOST_VALUES // len(begins)))
    while larger < _MOST_LARGER and tried < max(_PERMUTATIONS, 4.0 / level):
        shuffled = rng.permuted(np.broadcast_to(scaled[:, None], (count, several)), axis=0)
        larger += int(np.count_nonzero(statistics(shuffled).max(axis=0) >= observed.max()))
        tried += several
    best = int(np.argmax(observed))
    borders = [int(begins[best]), int(ends[best])] if best < len(begins) else []
    return (1 + larger) / (1 + tried), [border for border in borders if border < count]


@cache
def _stretches(count: int) -> tuple[np.ndarray[Any, np.dtype[np.int64]], np.ndarray[Any, np.dtype[np.int64]]]:
    """Return begins and ends of the stretches in which n values may have another level.

    Steps come first and last to the end. Excursions longer than eight have lengths and begins on a grid of an
    eighth of their length; their borders are dated exactly later.
    """
    begins = [np.arange(SIDE, count - SIDE + 1)]
    ends = [np.full(len(begins[0]), count)]
    length = SIDE
    while length <= count - 2 * SIDE:
        begins.append(np.arange(SIDE, count - SIDE - length + 1, 1 + length // 8))
        ends.append(begins[-1] + length)
        length += 1 + length // 8
    return np.concatenate(begins), np.concatenate(ends)


def least_for_step(tested: int) -> int:
    """Return how many measurements a series needs for a step in its middle to be significant.

    Of the binomial(n, n/2) ways to divide n values into halves, only two separate them as completely as a
    step in the middle. The p-value of a permutation test is therefore at least 2 / binomial(n, n/2).

    Args:
        tested: number of series of the table that are tested.
    """
    return next(
        count for count in range(LEAST, 1_000) if 2.0 / comb(count, count // 2) <= LEVEL / max(tested, 1)
    )
