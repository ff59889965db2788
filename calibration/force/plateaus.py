"""Steady readings under known forces, cut out of a record."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.data.table import Table, read_table
from estimation.signals.blocks import blocks
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

_SETTLING_SHARE = 0.25  # of a plateau, left out where nothing says when it is settled
_FEWEST = 3  # samples of a plateau
_OUTLIER = 8.0  # robust standard deviations: a converter's glitch, not its noise
_NORMAL = 1.4826  # standard deviation of normal noise over its median absolute deviation
STANDARD_GRAVITY_M_S2 = 9.80665
_ROLES = ("reading", "reference", "settled")
_READING_UNITS = {"counts": "count", "count": "count", "n": "N", "v": "V", "mv": "mV", "mv/v": "mV/V"}
_TO_N = {"n": 1.0, "kn": 1e3, "mn": 1e-3, "lbf": 4.4482216152605}


@dataclass(frozen=True)
class Plateaus:
    """Mean readings under known forces, in the order of time; arrays of shape (m,)."""

    reference_n: FloatArray  # force that was there [N]
    reading: FloatArray  # mean of what the sensor showed, in its unit
    std_err: FloatArray  # of each mean if the samples' noise is white, in the sensor's unit
    direction: FloatArray  # 1 where the force was reached from below, -1 from above, 0 at the start
    glitches: int = 0  # samples that were left out as outliers

    def __len__(self) -> int:
        return len(self.reading)


def find_plateaus(reading: FloatArray, reference_n: FloatArray, settled: BoolArray | None = None) -> Plateaus:
    """Cut a record (n,) where the reference [N] changes, and take the mean reading of each piece.

    Samples that are not settled do not count; without that mark the first quarter of each plateau does not.

    InputError: fewer than three samples are left of every plateau.
    """
    steps = np.concatenate([[0], np.cumsum(np.diff(reference_n) != 0.0)])
    pieces = [_settled(reading[rows], None if settled is None else settled[rows]) for rows in blocks(steps)]
    references = [float(reference_n[rows][0]) for rows in blocks(steps)]
    long_enough = [number for number, piece in enumerate(pieces) if len(piece) >= _FEWEST]
    if not long_enough:
        raise InputError(
            f"no plateau has {_FEWEST} settled samples: the reference must stay constant for a while"
        )
    return plateaus_of([references[i] for i in long_enough], [pieces[i] for i in long_enough])


def plateaus_of(references_n: Sequence[float], pieces: Sequence[FloatArray]) -> Plateaus:
    """Plateaus from the settled readings under each force, in the order of time."""
    kept = [piece[~_is_glitch(piece)] for piece in pieces]
    reference = np.array(references_n, dtype=np.float64)
    return Plateaus(
        reference,
        np.array([piece.mean() for piece in kept]),
        np.array([piece.std(ddof=1) / np.sqrt(len(piece)) for piece in kept]),
        np.concatenate([[0.0], np.sign(np.diff(reference))]),
        sum(map(len, pieces)) - sum(map(len, kept)),
    )


def _settled(reading: FloatArray, settled: BoolArray | None) -> FloatArray:
    return reading[int(_SETTLING_SHARE * len(reading)) :] if settled is None else reading[settled]


def _is_glitch(piece: FloatArray) -> BoolArray:
    """Samples far off the median, if most agree; the resolution counts as noise."""
    off = np.abs(piece - np.median(piece))
    steps = np.diff(np.unique(piece))
    noise = max(_NORMAL * float(np.median(off)), float(steps.min()) if len(steps) else 0.0)
    return np.asarray(off > _OUTLIER * noise if noise else np.zeros(len(piece), dtype=np.bool_))


def read_reference_file(
    path: str | os.PathLike[str],
    columns: Mapping[str, str],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2,
    reading_unit: str | None = None,
) -> tuple[Plateaus, str]:
    """Plateaus of a data file, and the unit of its readings.

    CSV (also .gz), Parquet or NPZ, one row a sample in the order of time. `columns` say what `reading`,
    `reference` and `settled` are called there; without an entry a column is looked for that begins so.
    Units are the end of a name, such as `load_counts`, `weight_kg`, `force_N`, or `reading_unit`. Where
    there is a column `settled`, only rows count in which it is not 0. Gravity makes a mass a weight
    [m/s^2].

    InputError: the file cannot be read, a column is missing or has no known unit, or nothing is steady.
    """
    wrong = [role for role in columns if role not in _ROLES]
    if wrong:
        raise InputError(f"--column {wrong[0]}: valid are {', '.join(_ROLES)}")
    table = read_table(path)
    reading = _column(table, "reading", columns)
    reference = _column(table, "reference", columns)
    settled = columns.get("settled") or next((name for name in table.names if name == "settled"), None)
    plateaus = find_plateaus(
        table.numbers(reading),
        table.numbers(reference) * _newtons(table, reference, gravity_m_s2),
        None if settled is None else np.asarray(table.numbers(settled) != 0.0),
    )
    return plateaus, reading_unit or _reading_unit(table, reading)


def _column(table: Table, role: str, columns: Mapping[str, str]) -> str:
    if role in columns:
        return columns[role]
    found = [name for name in table.names if name == role or name.startswith(f"{role}_")]
    if len(found) != 1:
        free = [name for name in table.names if not name.startswith((*_ROLES, "time"))]
        example = (free or [*table.names])[0]
        raise InputError(
            f"{table.path}: which column is the {role}? Say --column {role}={example}. "
            f"There are: {table.listed_names}"
        )
    return found[0]


def _newtons(table: Table, name: str, gravity_m_s2: float) -> float:
    """What one unit of the reference is [N]."""
    factors = _TO_N | {"kg": gravity_m_s2, "g": 1e-3 * gravity_m_s2, "lb": 0.45359237 * gravity_m_s2}
    unit = name.rpartition("_")[2].lower()
    if unit not in factors:
        raise InputError(
            f"{table.path}: the unit of the reference is the end of its column's name; '{name}' says none of "
            f"{', '.join(factors)}"
        )
    return factors[unit]


def _reading_unit(table: Table, name: str) -> str:
    unit = _READING_UNITS.get(name.rpartition("_")[2].lower())
    if unit is None:
        raise InputError(
            f"{table.path}: the unit of the reading is not the end of its column's name '{name}'; "
            "say it with --reading-unit"
        )
    return unit
