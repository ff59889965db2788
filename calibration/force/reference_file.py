"""A record of a force sensor beside a reference, from somebody's data file."""

import os
from collections.abc import Mapping

import numpy as np

from calibration.force.plateaus import Plateaus, find_plateaus
from estimation.data.table import Table, read_table
from robot_io.errors import InputError

STANDARD_GRAVITY_M_S2 = 9.80665
_ROLES = ("reading", "reference", "settled")
_READING_UNITS = {"counts": "count", "count": "count", "n": "N", "v": "V", "mv": "mV", "mv/v": "mV/V"}
_TO_N = {"n": 1.0, "kn": 1e3, "mn": 1e-3, "lbf": 4.4482216152605}


def read_reference_file(
    path: str | os.PathLike[str],
    columns: Mapping[str, str],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2,
    reading_unit: str | None = None,
) -> tuple[Plateaus, str]:
    """Plateaus of a data file, and the unit of its readings.

    Args:
        path: CSV (also .gz), Parquet or NPZ; one row a sample, in the order of time.
        columns: what `reading`, `reference` and `settled` are called there; units are the end of a name, such
            as `load_counts`, `weight_kg`, `force_N`. Without an entry a column is looked for that begins so.
            Where a column `settled` is there, only rows count in which it is not 0.
        gravity_m_s2: what makes a mass a weight [m/s^2].
        reading_unit: of the readings, where the column's name does not say it.

    Raises:
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
