"""Which columns of other names make channels, where the user did not say."""

import shlex
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from estimation.data.clock_times import clocks_of
from estimation.data.column_guess import Guess, guess_columns
from estimation.data.import_options import ImportOptions
from estimation.data.quantities import OF_JOINTS, Role, parse_role
from estimation.data.table import Table
from estimation.data.units import dimension_of, factor_to_si
from estimation.statistics.correlation import correlation_coefficient
from robot_io.errors import InputError
from robot_io.types import FloatArray

Key = tuple[str, int]  # quantity and number of the joint, 0 where there is none
TIME, DISPLACEMENT, FORCE = ("time", 0), ("displacement", 0), ("force", 0)
POSITION = ("position", 0)
EFFORTS = ("force", "torque")
_OTHER_SIGN = 0.2  # of its largest, that a force of a press may have on the other side
_GOES_WITH = 0.3  # correlation of position and force


def choose_columns(
    table: Table, known: Collection[Key], taken: Collection[str], options: ImportOptions, shift: int
) -> dict[Key, tuple[Role, str]]:
    """The columns that make a channel, with those that are known already; what makes none is left alone.

    Columns that say no unit are asked about only where nothing else makes a channel.

    Args:
        table: the rows.
        known: what palpate's own names and the user's word say.
        taken: columns that are known, and those that must not be used.
        options: what the user says.
        shift: to add to the joints' numbers.

    Raises:
        InputError: two columns that a channel needs match equally well, or one of them is spoilt by a cell.
    """
    named = [_shifted(one, shift) for one in guess_columns(table.names, clocks_of(table.columns))]
    named = [one for one in named if one.quantity and one.column not in taken and one.key not in known]
    free = [one for one in named if table.is_mostly_numeric(one.column)]
    there = {*known, *(one.key for one in free)}
    if not (_wanted(there) and TIME in there):
        _refuse_spoilt(table, known, named)
    clear = [
        one
        for one in free
        if one.unit
        or one.key == TIME
        or units_meant(table, options, Role(*one.key, one.unit, shift), one.column)
    ]
    guesses = clear if _wanted({*known, *(one.key for one in clear)}) else free
    found: dict[Key, list[Guess]] = {}
    for one in guesses:
        found.setdefault(one.key, []).append(one)
    wanted = [key for key in _wanted({*known, *found}) if key in found]
    chosen = {key: _best(table, Role(*key, "", shift), found[key]) for key in wanted}
    return {key: (Role(*key, guess.unit, shift), guess.column) for key, guess in chosen.items()}


def units_meant(table: Table, options: ImportOptions, role: Role, column: str) -> list[str]:
    """The names in --unit that mean a column: its own, its quantity, or its quantity and joint.

    A name that a column has means that one alone, unless the user calls another one so.
    """
    exact = {name for name in table.names if name not in options.columns or name in options.columns.values()}
    return [name for name in options.units if name == column or (name not in exact and _is_of(name, role))]


def _is_of(named: str, role: Role) -> bool:
    said = parse_role(named, role.shift)
    return named == role.quantity or (said is not None and said.key == role.key)


def _shifted(one: Guess, shift: int) -> Guess:
    return (
        one if one.joint is None or one.quantity not in OF_JOINTS else replace(one, joint=one.joint + shift)
    )


def _refuse_spoilt(table: Table, known: Collection[Key], named: Collection[Guess]) -> None:
    """Name the cell that is no number, where a channel could be made but for such cells.

    Raises:
        InputError: there is one.
    """
    wanted = _wanted({*known, *(one.key for one in named)})
    for one in named:
        if one.key in wanted:
            table.numbers(one.column)


def is_pressed(position: FloatArray, force: FloatArray) -> bool:
    """Whether a position (n,) and a force (n,) are rather those of a press than of an axis.

    A press's force has one sign and grows with the position; what moves an axis has both.
    """
    low, high = np.quantile(force, [0.005, 0.995])
    one_sided = min(abs(low), abs(high)) < _OTHER_SIGN * max(abs(low), abs(high))
    return bool(one_sided and abs(correlation_coefficient(position, force)) > _GOES_WITH)


def _wanted(there: Collection[Key]) -> list[Key]:
    """The keys that make channels of what is there, and their time."""
    keys: list[Key] = []
    if DISPLACEMENT in there and FORCE in there:
        keys += [DISPLACEMENT, FORCE]
    joints = sorted({joint for quantity, joint in there if quantity == "position"})
    for joint in joints:
        for effort in (("torque", joint), ("force", joint)):
            if effort in there and effort not in keys:
                keys += [("position", joint), effort]
                break
    return [TIME, *keys] if keys else []


def _best(table: Table, role: Role, guesses: list[Guess]) -> Guess:
    """The column whose name fits best; of several times, one without a bad cell that goes on all along."""
    if role.key == TIME and len(guesses) > 1:
        guesses = [one for one in guesses if table.varies(one.column)] or guesses
        guesses = [one for one in guesses if np.all(np.diff(table.numbers(one.column)) > 0.0)] or guesses
    fit = max(one.fit for one in guesses)
    first, *equal = (one for one in guesses if one.fit == fit)
    others = [one for one in equal if not _same(table, first, one)]
    if others:
        names = " and ".join(f"'{one.column}'" for one in (first, *others[:3]))
        raise InputError(
            f"{table.path}: columns {names} may hold {role.numbered}; choose with "
            f"--column {role.numbered}={shlex.quote(first.column)}"
        )
    return first


def _same(table: Table, one: Guess, other: Guess) -> bool:
    """Whether two columns hold the same, be it in two units; not where a cell of them is no number."""
    if not (one.unit and other.unit and dimension_of(one.unit) == dimension_of(other.unit)):
        return False
    try:
        first, second = (
            factor_to_si(guess.unit, str(dimension_of(guess.unit)), guess.column)
            * table.numbers(guess.column)
            for guess in (one, other)
        )
    except InputError:
        return False
    if one.key == TIME:  # of which only the differences count
        first, second = first - first[0], second - second[0]
    return bool(np.allclose(first, second, rtol=1e-3, atol=1e-3 * float(np.ptp(first))))
