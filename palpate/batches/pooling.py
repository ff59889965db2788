"""What many measurements say together: random effects, differences between groups, and outliers."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from scipy.optimize import brentq
from scipy.stats import t as student_t

from palpate.batches.table import ParameterColumn, texts
from palpate.robot_io.types import FloatArray

PAGE = "index.html"
OUTLYING = (
    3.5  # modified z value of an outlier (Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993)
)
_MAD_SIGMAS = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
_LEAST_FOR_OUTLIERS = 5


@dataclass(frozen=True)
class RandomEffects:
    """A parameter that is distributed over measurements: each has its own true value around a common mean."""

    count: int  # measurements
    mean: float  # common mean
    std_err: float  # of the mean
    interval: tuple[float, float]  # 95 %, of the mean
    spread: float  # standard deviation of the true values between measurements
    prediction: tuple[float, float]  # 95 %, of the true value of a further measurement; NaN below three
    inconsistency: float  # I^2: share of the variance of the values that is not due to their standard errors


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
    difference: float  # of the means, second less first
    interval: tuple[float, float]  # 95 %, of the difference alone
    p_value: float  # of no difference
    p_corrected: float  # by Holm, over all parameters and pairs of groups


@dataclass(frozen=True)
class Outlier:
    """A measurement with a parameter far from those of its group."""

    row: int  # of the table
    parameter: str
    unit: str
    value: float
    z: float  # distance from the group's median, over scatter and standard error


@dataclass(frozen=True)
class BatchResult:
    """What a batch found."""

    folder: Path  # of the page, the tables, and the results by content
    table: pa.Table  # a row for each channel of each measurement
    measurements: int  # in all
    finished: int  # measurements with a result, be it an error
    pooled: tuple[PooledParameter, ...]  # each parameter in each group
    differences: tuple[GroupDifference, ...]  # between each two groups
    outliers: tuple[Outlier, ...]  # measurements with a parameter far from the others

    @property
    def page(self) -> Path:
        """The HTML page."""
        return self.folder / PAGE

    @cached_property
    def errors(self) -> dict[str, str]:
        """Why a measurement could not be judged, by its name."""
        pairs = zip(texts(self.table, "measurement"), texts(self.table, "error"), strict=True)
        return {name: error for name, error in pairs if error}

    def as_data(self) -> dict[str, Any]:
        """The outcome as plain data; the keys are stable."""
        return {
            "folder": str(self.folder),
            "page": str(self.page),
            "measurements": self.measurements,
            "finished": self.finished,
            "errors": self.errors,
            "verdicts": dict(Counter(filter(None, texts(self.table, "verdict")))),
            "pooled": [asdict(entry) for entry in self.pooled],
            "differences": [asdict(entry) for entry in self.differences],
            "outliers": [
                {"measurement": self.table["measurement"][entry.row].as_py()} | asdict(entry)
                for entry in self.outliers
            ],
        }


def random_effects(values: FloatArray, std_errs: FloatArray) -> RandomEffects:
    """Fit mean and spread by Paule and Mandel's estimator, with t intervals of the mean.

    Paule and Mandel, J. Res. NBS 87 (1982) 377; advised by Veroniki et al., Res. Synth. Methods 7 (2016) 55.
    At its solution the factor of Hartung and Knapp (2001) is one, so that only the quantile is theirs. The
    prediction interval is that of Higgins et al., J. R. Stat. Soc. A 172 (2009) 137; of few measurements it
    is somewhat too short (Partlett and Riley, Stat. Med. 36 (2017) 301).

    Args:
        values: shape (n,), n at least 1.
        std_errs: of the values (n,), not negative.
    """
    count = len(values)
    least = 1e-9 * (float(np.abs(values).max()) or 1.0)
    variances = np.maximum(std_errs, least) ** 2

    def weighted_mean(spread_squared: float) -> tuple[float, FloatArray]:
        weights = 1.0 / (variances + spread_squared)
        return float(weights @ values / weights.sum()), weights

    def excess(spread_squared: float) -> float:
        mean, weights = weighted_mean(spread_squared)
        return float(weights @ (values - mean) ** 2) - (count - 1)

    most = float(np.sum((values - values.mean()) ** 2)) + 1e-300  # where the excess is not above zero
    squared = brentq(excess, 0.0, most, xtol=1e-12 * most) if count > 1 and excess(0.0) > 0.0 else 0.0
    mean, weights = weighted_mean(squared)
    std_err = float(weights.sum() ** -0.5)
    half = float(student_t.ppf(0.975, count - 1)) * std_err if count > 1 else float("nan")
    wide = (
        float(student_t.ppf(0.975, count - 2) * np.hypot(np.sqrt(squared), std_err))
        if count > 2
        else float("nan")
    )
    fixed = 1.0 / variances
    # Typical variance within a measurement (Higgins and Thompson, Stat. Med. 21 (2002) 1539).
    spare = fixed.sum() ** 2 - (fixed**2).sum()
    typical = (count - 1) * fixed.sum() / spare if spare > 0.0 else float(variances.mean())
    share = squared / (squared + typical) if squared > 0.0 else 0.0
    return RandomEffects(
        count,
        mean,
        std_err,
        (mean - half, mean + half),
        squared**0.5,
        (mean - wide, mean + wide),
        float(share),
    )


def shrunk(values: FloatArray, std_errs: FloatArray, effects: RandomEffects) -> FloatArray:
    """Partially pooled values: each drawn towards the mean as far as its standard error exceeds the spread.

    Args:
        values: shape (n,).
        std_errs: of the values (n,).
        effects: the random-effects model of their group.

    Returns:
        Shape (n,).
    """
    own = effects.spread**2 / np.maximum(effects.spread**2 + std_errs**2, np.finfo(float).tiny)
    return np.asarray(effects.mean + own * (values - effects.mean))


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
            freedom = std_err**4 / (a.std_err**4 / (a.count - 1) + b.std_err**4 / (b.count - 1))
            p_value = 2.0 * float(student_t.sf(abs(difference) / std_err, freedom))
            half = float(student_t.ppf(0.975, freedom)) * std_err
            interval = difference - half, difference + half
            made.append((*key, (first.group, second.group), difference, interval, p_value))
    corrected = holm([entry[-1] for entry in made])
    return [GroupDifference(*entry, p) for entry, p in zip(made, corrected, strict=True)]


def holm(p_values: Sequence[float]) -> list[float]:
    """Corrected p values of several tests (Holm, Scand. J. Stat. 6 (1979) 65).

    Args:
        p_values: of the single tests.
    """
    order = np.argsort(p_values)
    corrected, worst = [1.0] * len(p_values), 0.0
    for rank, place in enumerate(order):
        worst = max(worst, min(1.0, (len(p_values) - rank) * p_values[place]))
        corrected[place] = worst
    return corrected


def outliers(column: ParameterColumn, groups: Sequence[str]) -> list[Outlier]:
    """Measurements whose value is far from the median of their group, beyond scatter and standard error.

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
        scale = np.hypot(_MAD_SIGMAS * np.median(np.abs(away)), column.std_errs[places])
        z = np.divide(away, scale, out=np.zeros_like(away), where=scale > 0.0)
        outlying += [
            Outlier(int(column.rows[place]), column.name, column.unit, float(value), float(score))
            for place, value, score in zip(places, values, z, strict=True)
            if abs(score) > OUTLYING
        ]
    return outlying
