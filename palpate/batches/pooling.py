"""Pool many measurements: random effects, differences between groups, and outliers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from scipy.stats import chi2
from scipy.stats import t as student_t

from palpate.batches.common_effects import CommonEffect
from palpate.batches.statistics import RandomEffects, holm, random_effects, shrunk
from palpate.batches.table import ParameterColumn, texts
from palpate.estimation.estimate import DisplayTable, TableDisplay
from palpate.estimation.fit.intervals import SIGMAS_95
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

PAGE = "index.html"
OUTLYING = 0.01  # chance of an outlier in a group of normal values
_LEAST_FOR_OUTLIERS = 5
_DRAWS = 10_000  # simulated groups
_CONTRADICTED = 0.01  # chance of refusing to share parameters that are the same


@dataclass(frozen=True)
class PooledParameter:
    """The random-effects model of one parameter in one group."""

    channel: str
    parameter: str
    unit: str
    group: str
    effects: RandomEffects


@dataclass(frozen=True)
class GroupDifference:
    """How much a parameter's mean differs between two groups, and whether that may be chance."""

    channel: str
    parameter: str
    unit: str
    groups: tuple[str, str]
    difference: float  # second minus first mean
    interval: tuple[float, float]  # 95 %, of the difference alone
    p_value: float  # p-value of no difference
    p_corrected: float  # by Holm, over all parameters and pairs of groups

    @property
    def std_err(self) -> float:
        """Approximate standard error, from the interval."""
        return (self.interval[1] - self.interval[0]) / 4.0


@dataclass(frozen=True)
class SharedParameter:
    """One value of a parameter for all channels and measurements of a group, unless they contradict it."""

    parameter: str
    unit: str
    group: str
    channels: tuple[str, ...]  # channels that share it
    count: int  # estimates, one for each channel of each measurement
    value: float  # NaN if the estimates contradict it, as are the next two
    std_err: float
    interval: tuple[float, float]  # 95 %
    p_corrected: float  # of estimates as unlike as these if they share it; by Holm over all shared parameters
    contradicted: bool


@dataclass(frozen=True)
class Outlier:
    """A measurement with a parameter far from the values of its group."""

    row: int  # row of the table
    parameter: str
    unit: str
    value: float
    z: float  # distance from the group's median, over scatter and standard error


@dataclass(frozen=True, repr=False)
class BatchResult(TableDisplay):
    """Result of a batch; prints as the table of its pooled parameters."""

    folder: Path  # folder of the page, the tables, and the results by content
    table: pa.Table  # a row for each channel of each measurement
    measurements: int  # number of measurements
    finished: int  # measurements with a result, be it an error
    pooled: tuple[PooledParameter, ...] = ()  # each parameter in each group
    differences: tuple[GroupDifference, ...] = ()  # between each two groups
    outliers: tuple[Outlier, ...] = ()  # measurements with a parameter far from the others
    common_effects: tuple[CommonEffect, ...] = ()  # missing in all measurements together, if requested
    shared: tuple[SharedParameter, ...] = ()  # by all channels of a group, if requested
    where: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # of measurements that share files
    reports: Mapping[str, str] = field(default_factory=dict)  # by measurement, relative to the folder

    @property
    def page(self) -> Path:
        """The HTML page."""
        return self.folder / PAGE

    @cached_property
    def errors(self) -> dict[str, str]:
        """Reasons why measurements could not be evaluated, by measurement."""
        pairs = zip(texts(self.table, "measurement"), texts(self.table, "error"), strict=True)
        return {name: error for name, error in pairs if error}

    def _table(self) -> DisplayTable:
        rows = []
        for entry in self.pooled:
            effects, mean = entry.effects, f"{entry.effects.mean:.5g} {entry.unit}"
            interval = "{:.5g} to {:.5g}".format(*effects.interval) if effects.count > 1 else ""
            rows.append((entry.channel, entry.parameter, entry.group, effects.count, mean, interval))
        caption = f"{self.finished} of {self.measurements} measurements done, {len(self.errors)} unreadable"
        columns = ("channel", "parameter", "group", "measurements", "mean", "95 % interval")
        return DisplayTable(caption, columns, rows)

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data; the keys are stable."""
        return {
            **{key: getattr(self, key) for key in ("folder", "page", "measurements", "finished", "errors")},
            "verdicts": dict(Counter(filter(None, texts(self.table, "verdict")))),
            **{key: getattr(self, key) for key in ("pooled", "differences", "common_effects", "shared")},
            "outliers": [
                {"measurement": self.table["measurement"][entry.row].as_py()} | asdict(entry)
                for entry in self.outliers
            ],
            "reports": self.reports,
        }


def pool(column: ParameterColumn, groups: Sequence[str]) -> tuple[list[PooledParameter], FloatArray]:
    """Fit one random-effects model for each group; also the partially pooled values (n,).

    Args:
        column: n values of a parameter.
        groups: group of each row of the table.
    """
    own = np.array([groups[row] for row in column.rows])
    pooled, drawn = [], np.empty(len(own))
    for group in dict.fromkeys(own.tolist()):
        mask = own == group
        effects = random_effects(column.values[mask], column.std_errs[mask])
        pooled.append(PooledParameter(column.channel, column.name, column.unit, group, effects))
        drawn[mask] = shrunk(column.values[mask], column.std_errs[mask], effects)
    return pooled, drawn


def shared_parameters(
    columns: Sequence[ParameterColumn], groups: Sequence[str], effects: Sequence[str]
) -> list[SharedParameter]:
    """Give each parameter of an effect one value in all channels of a group, where estimates agree.

    The value is the mean weighted by inverse variances; Cochran's Q (Biometrics 10 (1954) 101) tests
    whether the estimates differ by more than their standard errors.

    Args:
        columns: parameters of the table.
        groups: group of each row of the table.
        effects: effects whose parameters are shared, such as "coulomb_friction".

    Raises:
        InputError: no two estimates have a parameter of an effect.
    """
    estimates: dict[tuple[str, str, str], list[tuple[str, float, float]]] = {}
    for column in columns:
        if column.name.partition(".")[0] in effects:
            for row, value, std_err in zip(column.rows, column.values, column.std_errs, strict=True):
                if std_err > 0.0:
                    key = column.name, column.unit, groups[row]
                    estimates.setdefault(key, []).append((column.channel, float(value), float(std_err)))
    estimates = {key: entries for key, entries in estimates.items() if len(entries) > 1}
    for effect in effects:
        if not any(name.partition(".")[0] == effect for name, _, _ in estimates):
            names = ", ".join(dict.fromkeys(column.name.partition(".")[0] for column in columns)) or "none"
            raise InputError(f"--share {effect}: each group has fewer than two estimates. Available: {names}")
    made = []
    for key, entries in estimates.items():
        values, weights = np.array([entry[1:] for entry in entries]).T
        weights = weights**-2.0
        mean, std_err = float(weights @ values / weights.sum()), float(weights.sum() ** -0.5)
        p_value = float(chi2.sf(weights @ (values - mean) ** 2, len(entries) - 1))
        channels = tuple(dict.fromkeys(entry[0] for entry in entries))
        made.append((key, channels, len(entries), mean, std_err, p_value))
    shared = []
    corrected = holm([entry[-1] for entry in made])
    for (key, channels, number, mean, std_err, _), p in zip(made, corrected, strict=True):
        contradicted = p < _CONTRADICTED
        value, error = (float("nan"), float("nan")) if contradicted else (mean, std_err)
        interval = value - SIGMAS_95 * error, value + SIGMAS_95 * error
        shared.append(SharedParameter(*key, channels, number, value, error, interval, p, contradicted))
    return shared


def group_differences(pooled: Sequence[PooledParameter]) -> list[GroupDifference]:
    """Test each parameter for each pair of groups (Welch), and correct all p values together (Holm).

    Args:
        pooled: all parameters in all groups; groups of one measurement are left out.
    """
    by_parameter: dict[tuple[str, str, str], list[PooledParameter]] = {}
    for entry in pooled:
        if entry.effects.count > 1:
            by_parameter.setdefault((entry.channel, entry.parameter, entry.unit), []).append(entry)
    made = []
    for key, entries in by_parameter.items():
        for first, second in combinations(entries, 2):
            a, b = first.effects, second.effects
            difference, std_err = b.mean - a.mean, float(np.hypot(a.std_err, b.std_err))
            # Degrees of freedom by Welch and Satterthwaite.
            freedom = std_err**4 / (a.std_err**4 / a.freedom + b.std_err**4 / b.freedom)
            p_value = 2.0 * float(student_t.sf(abs(difference) / std_err, freedom))
            half = float(student_t.ppf(0.975, freedom)) * std_err
            interval = difference - half, difference + half
            made.append((*key, (first.group, second.group), difference, interval, p_value))
    corrected = holm([entry[-1] for entry in made])
    return [GroupDifference(*entry, p) for entry, p in zip(made, corrected, strict=True)]


@cache
def outlying_z(count: int) -> float:
    """Return the largest modified z value that a group of normal values exceeds with probability `OUTLYING`.

    Modified z values are those of Iglewicz and Hoaglin, How to Detect and Handle Outliers (1993); their limit
    of 3.5 ignores that the median and the scatter of a small group are uncertain.

    Args:
        count: number of values in the group.
    """
    rng = np.random.default_rng(1)
    largest: list[float] = []
    while len(largest) < _DRAWS:
        values = rng.standard_normal((max(1, min(_DRAWS, _DRAWS * 100 // count)), count))
        away = np.abs(values - np.median(values, axis=1, keepdims=True))
        largest += (away.max(axis=1) / (MAD_TO_SIGMA * np.median(away, axis=1))).tolist()
    return float(np.quantile(largest, 1.0 - OUTLYING))


def outliers(column: ParameterColumn, groups: Sequence[str]) -> list[Outlier]:
    """Return measurements whose value is far from their group's median, given scatter and standard error.

    Args:
        column: values of a parameter; a group of fewer than five has no outliers.
        groups: group of each row of the table.
    """
    own = np.array([groups[row] for row in column.rows])
    outlying = []
    for group in dict.fromkeys(own.tolist()):
        places = np.flatnonzero(own == group)
        if len(places) < _LEAST_FOR_OUTLIERS:
            continue
        values = column.values[places]
        away = values - np.median(values)
        scale = np.hypot(MAD_TO_SIGMA * np.median(np.abs(away)), column.std_errs[places])
        z = np.divide(away, scale, out=np.zeros_like(away), where=scale > 0.0)
        outlying += [
            Outlier(int(column.rows[place]), column.name, column.unit, float(value), float(score))
            for place, value, score in zip(places, values, z, strict=True)
            if abs(score) > outlying_z(len(places))
        ]
    return outlying
