"""Find steps and drifts of parameters over time that exceed the scatter between measurements."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np
import pyarrow as pa
import scipy

from palpate.batches.table import BUDGET, floats, parameter_columns, texts
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray

LEVEL = 0.01  # probability of a false alarm in a whole table
LEAST = 10  # measurements of a series that is tested
_SIDE = 3  # measurements before and after a step
_PERMUTATIONS = 1_000  # permutations at a time
_MOST_VALUES = 5_000_000  # values in all permutations of one time
_MOST_LARGER = 20  # permutations with as large a change that end the test (Besag and Clifford, 1991)
_MOST_CHANGES = 6  # changes of one series
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
    last: int  # last measurement of the change
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
                        f"column {name}: all {several} measurements have {labels[0]}, which gives no order "
                        "in time; choose another column with --date"
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
    """Find steps and drifts of a series, in order of time.

    The largest step and the slope are tested together by permutation of the values. If the result is
    significant, the better of the two is accepted. A step splits the series, and both parts are searched in
    the same way (binary segmentation). The scale comes from differences between neighbors, which neither a
    step nor a drift changes much. The sizes of all changes are then fitted jointly, and a change must exceed
    its standard error (95 %).

    Args:
        series: n values.
        level: probability of a false alarm.
    """
    rng = np.random.default_rng(1)
    changes: list[TrendChange] = []
    parts = [(0, len(series.values))]
    while parts and len(changes) < _MOST_CHANGES:
        begin, end = parts.pop()
        if end - begin < LEAST:
            continue
        part = slice(begin, end)
        times, values, std_errs = series.times[part], series.values[part], series.std_errs[part]
        weights = 1.0 / (_spread_squared(values, std_errs) + std_errs**2)
        mean = weights @ values / weights.sum()
        scaled = (values - mean) * np.sqrt(weights)
        observed = _statistics(scaled[None], times)
        larger = tried = 0
        several = max(1, min(_PERMUTATIONS, _MOST_VALUES // len(scaled)))
        while larger < _MOST_LARGER and tried < 4.0 / level:
            shuffled = rng.permuted(np.broadcast_to(scaled, (several, len(scaled))), axis=1)
            larger += int(np.count_nonzero(_statistics(shuffled, times).max(axis=1) >= observed.max()))
            tried += several
        p_value = (1 + larger) / (1 + tried)
        if p_value > level:
            continue
        *steps, drift = observed[0]
        place = begin + int(np.argmax(steps)) + _SIDE
        if max(steps) >= drift:
            changes.append(TrendChange("step", place, end - 1, 0.0, 0.0, 0.0, p_value))
            parts += [(begin, place), (place, end)]
        else:
            changes.append(TrendChange("drift", begin, end - 1, 0.0, 0.0, 0.0, p_value))
    while changes := _with_joint_sizes(series, sorted(changes, key=lambda change: change.first)):
        ratios = [abs(change.after - change.before) / change.std_err for change in changes]
        if min(ratios) > SIGMAS_95:
            break
        del changes[int(np.argmin(ratios))]
    return changes


def _with_joint_sizes(series: Series, changes: Sequence[TrendChange]) -> list[TrendChange]:
    """Fit the sizes of all changes, given in order: constants or lines between the steps, weighted.

    A size from one part of the series alone would contain other changes in this part.
    """
    times, values, count = series.times, series.values, len(series.values)
    borders = [0, *(change.first for change in changes if change.kind == "step"), count]
    drifting = {change.first for change in changes if change.kind == "drift"}
    columns = np.zeros((count, 2 * len(borders) - 2))
    for number, (begin, end) in enumerate(pairwise(borders)):
        columns[begin:end, 2 * number] = 1.0
        if begin in drifting:
            columns[begin:end, 2 * number + 1] = times[begin:end] - times[begin]
    weights = np.ones(count)
    tiny = 1e-12 * float(np.mean(values**2))
    for _ in range(3):  # the residual shows the scatter, and so the weights of the next fit
        information = np.linalg.pinv(columns.T @ (weights[:, None] * columns), hermitian=True)
        coefficients = information @ columns.T @ (weights * values)
        scatter = _spread_squared(values - columns @ coefficients, series.std_errs)
        weights = 1.0 / (max(scatter, tiny) + series.std_errs**2)
    sized = []
    for change in changes:
        is_step = change.kind == "step"
        before = columns[change.first - is_step]
        after = columns[change.first] if is_step else columns[change.last]
        std_err = float(np.sqrt((after - before) @ information @ (after - before)))
        start, end_value = float(before @ coefficients), float(after @ coefficients)
        sized.append(replace(change, before=start, after=end_value, std_err=std_err))
    return sized


def _spread_squared(values: FloatArray, std_errs: FloatArray) -> float:
    """Estimate the variance between measurements in excess of their standard errors, from n values.

    With this variance, squared differences between neighbors have on average the expected size (R. C. Paule,
    J. Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377). One uncertain value therefore hardly counts.
    """
    squares, noise = np.diff(values) ** 2, std_errs[1:] ** 2 + std_errs[:-1] ** 2
    least, most = 1e-200 + 1e-12 * float(np.mean(values**2)), 0.5 * float(np.mean(squares))

    def excess(log_variance: float) -> float:
        return float(np.mean(squares / (2.0 * np.exp(log_variance) + noise))) - 1.0

    if most <= least or excess(np.log(least)) <= 0.0:
        return least
    if excess(np.log(most)) >= 0.0:  # by rounding, without standard errors
        return most
    return float(np.exp(scipy.optimize.brentq(excess, np.log(least), np.log(most))))


def _statistics(scaled: FloatArray, times: FloatArray) -> FloatArray:
    """Squared z values (m, places + 1) of a step at each place, and of a drift last, in m series (m, n)."""
    count = scaled.shape[1]
    centered = scaled - scaled.mean(axis=1, keepdims=True)
    # Half the mean squared difference of neighbors (von Neumann, Ann. Math. Stat. 12 (1941) 367).
    variance = 1e-200 + 0.5 * np.mean(np.diff(scaled, axis=1) ** 2, axis=1, keepdims=True)
    places = np.arange(_SIDE, count - _SIDE + 1)
    sums = np.cumsum(centered, axis=1)[:, places - 1]
    steps = sums**2 * count / (places * (count - places))
    away = times - times.mean()
    drift = (centered @ away) ** 2 / max(float(away @ away), np.finfo(float).tiny)
    return np.asarray(np.column_stack([steps, drift]) / variance)


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
