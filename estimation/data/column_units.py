"""In which unit a column is: by the user's word, or by its name."""

import math
from dataclasses import dataclass

import numpy as np

from estimation.data.choose_columns import Key, units_meant
from estimation.data.clock_times import clocks_of
from estimation.data.import_options import ImportOptions
from estimation.data.quantities import (
    QUANTITIES,
    STANDS_FOR,
    Role,
    si_unit,
    unit_in_name,
    unknown_unit,
)
from estimation.data.table import Table
from estimation.data.units import (
    SI,
    dimension_of,
    factor_to_si,
    is_scaled,
    likely_time_unit,
    normalise,
    read_as,
    scaled_unit,
)
from robot_io.errors import InputError

_LARGE = {  # the unit that is likely where the numbers span more
    "displacement": (0.2, "mm"),
    "position": (4.0 * np.pi, "deg"),
}


@dataclass(frozen=True)
class Assigned:
    """One quantity's column."""

    column: str  # its name in the file
    dimension: str  # what it measures
    unit: str  # of its numbers
    factor: float  # turns its numbers into SI
    note: str = ""  # what the reader should know, or empty
    zero: float = 0.0  # what its numbers count from, in SI


def assign_unit(table: Table, options: ImportOptions, role: Role, column: str) -> Assigned:
    """Find the unit: the user's word, the column's own name, the user's name for it, in this order.

    Raises:
        InputError: the unit does not measure the quantity, or the column holds the times of a clock.
    """
    dimensions = QUANTITIES[role.quantity]
    if role.quantity != "time" and column in clocks_of(table.columns):
        raise InputError(
            f"{table.path}: column '{column}' holds clock times, expected {role.quantity}; name another one "
            "with --column"
        )
    said, own = _said_unit(table, options, role, column), _own_unit(table, column)
    unit = unit_of(table, options, role, column)
    note = ""
    if not unit and role.quantity == "time" and (unknown := unknown_unit(column)):
        raise InputError(
            f"{table.path}: column '{column}': '{unknown}' is no unit of time that is known; say --unit "
            "time=s, or ms, us, min, h"
        )
    if not unit and role.quantity == "time":
        unit = _likely_unit(table, role, column)
        note = (
            f"column '{column}' does not say its unit: its steps are taken for {unit}; else add --unit time="
        )
        note += "ms" if unit == "s" else "s"
    scale, unit = scaled_unit(unit, own)
    dimension = dimension_of(unit)
    if dimension not in dimensions:
        valid = ", ".join(unit for name in dimensions for unit in SI[name])
        raise InputError(
            f"{table.path}: column '{column}': '{unit}' measures no {role.quantity}. Valid: {valid}"
        )
    if not 0.0 < abs(scale) < math.inf:
        raise InputError(f"{table.path}: column '{column}': unit '{said}' cannot be converted")
    if not said and own and dimension_of(own) not in dimensions:
        note = f"column '{column}' is taken as {role.quantity} in {unit}, whatever its name says"
    if dimension in STANDS_FOR:
        effort, what, example = STANDS_FOR[dimension]
        unit_of_it = si_unit(dimension)
        note = (
            f"column '{column}' is a {dimension} that stands for the {role.quantity}: 1 {unit_of_it} counts "
            f"as 1 {effort}; say the {what}, as in --unit {role.numbered}={example}"
        )
    factor = scale * factor_to_si(unit, dimension, f"column '{column}'")
    return Assigned(column, dimension, said if scale != 1.0 else unit, factor, note)


def _own_unit(table: Table, column: str) -> str:
    """What a column's name says, but seconds where it held the times of a clock."""
    return "s" if column in clocks_of(table.columns) else unit_in_name(column)


def unit_of(table: Table, options: ImportOptions, role: Role, column: str) -> str:
    """A column's unit; empty where nothing says it."""
    own = read_as(_own_unit(table, column), QUANTITIES[role.quantity])
    fits = dimension_of(own) in QUANTITIES[role.quantity]
    return _said_unit(table, options, role, column) or (own if fits else "") or role.unit


def check_all_say_their_units(
    table: Table, options: ImportOptions, chosen: dict[Key, tuple[Role, str]]
) -> None:
    """Ask for the units that nothing says, with those that are likely. InputError: one is not said."""
    silent = [
        (role, column)
        for role, column in chosen.values()
        if role.quantity != "time" and not unit_of(table, options, role, column)
    ]
    if silent:
        columns = ", ".join(f"'{column}'" for _, column in silent)
        units = dict.fromkeys(
            f"--unit {role.quantity}={_likely_unit(table, role, column, _moves_by_force(role, chosen))}"
            for role, column in silent
        )
        unknown = next(filter(None, (unknown_unit(column) for _, column in silent)), "")
        single = len(silent) == 1
        said = f"{'does' if single else 'do'} not say {'its unit' if single else 'their units'}"
        said += f" in a way that is known ('{unknown}')" if unknown else ""
        raise InputError(
            f"{table.path}: column{'' if single else 's'} {columns} {said}; say "
            f"{'it' if single else 'them'}, as in {' '.join(units)}"
        )


def _moves_by_force(role: Role, chosen: dict[Key, tuple[Role, str]]) -> bool:
    """Whether a position is that of a linear axis: its effort is a force, and no torque."""
    return ("force", role.joint) in chosen and ("torque", role.joint) not in chosen


def _likely_unit(table: Table, role: Role, column: str, linear: bool = False) -> str:
    """The SI unit, or where the numbers are large for that, the one that laboratories take."""
    values = table.numbers(column) if table.is_numeric(column) else np.zeros(1)
    if role.quantity == "time":
        return likely_time_unit(float(np.median(np.diff(values))) if len(values) > 1 else 0.0)
    span = float(np.ptp(values))
    if linear and role.quantity == "position":
        most, other = _LARGE["displacement"]
        return other if span > most else "m"
    most, other = _LARGE.get(role.quantity, (np.inf, ""))
    return other if span > most else si_unit(QUANTITIES[role.quantity][0])


def is_said_scaled(table: Table, options: ImportOptions, role: Role, column: str) -> bool:
    """Whether the user says a unit with a number before it, which decides the sign."""
    return any(is_scaled(options.units[name]) for name in units_meant(table, options, role, column))


def _said_unit(table: Table, options: ImportOptions, role: Role, column: str) -> str:
    return normalise(next((options.units[name] for name in units_meant(table, options, role, column)), ""))


def check_units_are_used(table: Table, options: ImportOptions, chosen: dict[Key, tuple[Role, str]]) -> None:
    """Refuse a unit for something that is not there: it would be lost without a word.

    Raises:
        InputError: the user named one.
    """
    used = {name for role, column in chosen.values() for name in units_meant(table, options, role, column)}
    for name in options.units:
        if name not in used:
            there = ", ".join(column for _, column in chosen.values()) or "none"
            raise InputError(
                f"{table.path}: --unit {name}={options.units[name]}: no such quantity or column is in use. "
                f"In use: {there}"
            )
