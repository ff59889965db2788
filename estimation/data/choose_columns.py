"""Which columns make channels, with their units and the numbers of their joints."""

import math
import shlex
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.data.column_names import (
    DISPLACEMENT,
    OF_JOINTS,
    QUANTITIES,
    STANDS_FOR,
    TIME,
    Guess,
    Key,
    Role,
    guess_column,
    guess_columns,
    keys_of_channels,
    parse_role,
    si_unit,
    unit_in_name,
    unknown_unit,
)
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.table import Table
from palpate.estimation.data.table_layout import clocks_of
from palpate.estimation.data.units import (
    SI,
    dimension_of,
    factor_to_si,
    is_scaled,
    likely_time_unit,
    normalise,
    read_as,
    scaled_unit,
)
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

POSITION = ("position", 0)
EFFORTS = ("force", "torque")
_DERIVABLE = frozenset({"velocity", "acceleration"})
_OTHER_SIGN = 0.2  # of its largest, that a force of a press may have on the other side
_GOES_WITH = 0.3  # correlation of position and force
_BEGINNING = 0.05  # of the way, in which an axis already needs its force


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
    guessed = guess_columns(table.names, clocks_of(table.columns))
    named = [
        guess
        if guess.joint is None or guess.quantity not in OF_JOINTS
        else replace(guess, joint=guess.joint + shift)
        for guess in guessed
    ]
    named = [
        guess for guess in named if guess.quantity and guess.column not in taken and guess.key not in known
    ]
    if any(quantity in OF_JOINTS and joint == 0 for quantity, joint in known):  # the user means one joint
        named = [guess for guess in named if guess.quantity not in OF_JOINTS or not guess.joint]
    free = [guess for guess in named if table.is_mostly_numeric(guess.column)]
    there = {*known, *(guess.key for guess in free)}
    if not (keys_of_channels(there) and TIME in there):
        keys = keys_of_channels({*known, *(guess.key for guess in named)})
        for guess in named:  # say which cell is no number, where a channel could be made but for it
            if guess.key in keys and guess.key not in there:
                table.numbers(guess.column)
    clear = [
        guess
        for guess in free
        if guess.unit
        or guess.key == TIME
        or units_meant(table, options, Role(*guess.key, guess.unit, shift), guess.column)
    ]
    guesses = clear if keys_of_channels({*known, *(guess.key for guess in clear)}) else free
    guesses_of: dict[Key, list[Guess]] = {}
    for guess in guesses:
        guesses_of.setdefault(guess.key, []).append(guess)
    keys = [key for key in keys_of_channels({*known, *guesses_of}) if key in guesses_of]
    keys += [  # what could be derived is read too where the user says its unit
        guess.key
        for guess in clear
        if guess.quantity in _DERIVABLE
        and guess.key not in keys
        and units_meant(table, options, Role(*guess.key, guess.unit, shift), guess.column)
    ]
    fitting = {key: _best(table, key, guesses_of[key]) for key in keys}
    chosen = {
        key: (Role(*key, guesses[0].unit, shift), guesses[0].column) for key, guesses in fitting.items()
    }
    questions, answers = [], []
    for key, (role, column) in chosen.items():
        if len(fitting[key]) > 1:
            names = " and ".join(f"'{guess.column}'" for guess in fitting[key][:4])
            questions.append(f"columns {names} may hold {role.numbered}")
            answers.append(f"--column {role.numbered}={shlex.quote(column)}")
    if questions:
        units = [unit for _, unit in _missing_units(table, options, chosen)]
        raise InputError(
            f"{table.path}: {', '.join(questions)}; choose with {' '.join(dict.fromkeys(answers + units))}"
        )
    return chosen


def units_meant(table: Table, options: ImportOptions, role: Role, column: str) -> list[str]:
    """The names in --unit that mean a column: its own, its quantity, or its quantity and joint.

    A name that a column has means that one alone, unless the user calls another one so.

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        role: what the column is for.
        column: its name in the file.
    """
    exact = {name for name in table.names if name not in options.columns or name in options.columns.values()}
    said = {name: parse_role(name, role.shift) for name in options.units if name not in exact}
    of_role = {name for name, parsed in said.items() if parsed is not None and parsed.key == role.key}
    if role.quantity in said:
        of_role.add(role.quantity)
    return [name for name in options.units if name == column or name in of_role]


def is_pressed(position: FloatArray, force: FloatArray) -> bool:
    """Whether a position (n,) and a force (n,) are rather those of a press than of an axis.

    A press's force has one sign, and grows with the position or is not there when the motion begins. What
    moves an axis has both signs, or is there from the first movement on, as friction is.

    Args:
        position: shape (n,), in any unit.
        force: shape (n,), of either sign.
    """
    low, high = np.quantile(force, [0.005, 0.995])
    largest = max(abs(low), abs(high))
    if min(abs(low), abs(high)) >= _OTHER_SIGN * largest:
        return False
    moved = np.abs(position - position[0])
    begins = slice(int(np.argmax(moved > 0.0)), int(np.argmax(moved > _BEGINNING * np.ptp(position))))
    peak = int(np.argmax(np.abs(force))) + 1  # then it may tear; an axis may have its peak where it begins
    parts = [slice(begins.start, end) for end in (len(force), peak) if end > begins.stop]
    if any(abs(correlation_coefficient(position[part], force[part])) > _GOES_WITH for part in parts):
        return True
    return bool(force[begins].size and abs(np.median(force[begins])) < _OTHER_SIGN * largest)


def _best(table: Table, key: Key, guesses: list[Guess]) -> list[Guess]:
    """The columns whose names fit best, of those that change and differ; of several times, what goes on."""
    if len(guesses) > 1:
        guesses = [guess for guess in guesses if len(table.labels(guess.column)[0]) > 1] or guesses
    if len(guesses) > 1 and key == TIME:
        guesses = [guess for guess in guesses if table.varies(guess.column)] or guesses
        for goes_on in (np.greater, np.greater_equal):  # a clock may say a time twice
            onward = [guess for guess in guesses if goes_on(np.diff(table.numbers(guess.column)), 0.0).all()]
            if onward:
                guesses = onward
                break
    fit = max(guess.fit for guess in guesses)
    first, *equal = (guess for guess in guesses if guess.fit == fit)
    others = [
        guess
        for guess in equal
        if not hold_the_same(table, key, (first.column, first.unit), (guess.column, guess.unit))
    ]
    return [first, *others]


def hold_the_same(table: Table, key: Key, first: tuple[str, str], second: tuple[str, str]) -> bool:
    """Whether two columns hold the same, be it in two units; not where a cell of them is no number.

    Args:
        table: the rows.
        key: what both seem to hold; of times only the differences count.
        first: name and unit of a column.
        second: those of the other one.
    """
    dimension = dimension_of(first[1])
    if dimension is None or dimension != dimension_of(second[1]):
        return False
    try:
        values, other_values = (
            factor_to_si(unit, dimension, column) * table.numbers(column) for column, unit in (first, second)
        )
    except InputError:
        return False
    if key == TIME:
        values, other_values = values - values[0], other_values - other_values[0]
    return bool(np.allclose(values, other_values, rtol=1e-3, atol=1e-3 * float(np.ptp(values))))


_LARGE = {  # the unit that is likely where the numbers span more
    "displacement": (0.2, "mm"),
    "position": (4.0 * np.pi, "deg"),
    "goal": (4.0 * np.pi, "deg"),
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

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        role: what the column is for.
        column: its name in the file.

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
            f"{table.path}: column '{column}': '{unknown}' is no unit of time that is known; use --unit "
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
    """A column's unit; empty where nothing says it.

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        role: what the column is for.
        column: its name in the file.
    """
    own = read_as(_own_unit(table, column), QUANTITIES[role.quantity])
    fits = dimension_of(own) in QUANTITIES[role.quantity]
    return _said_unit(table, options, role, column) or (own if fits else "") or role.unit


def check_all_say_their_units(
    table: Table, options: ImportOptions, chosen: dict[Key, tuple[Role, str]]
) -> None:
    """Ask for the units that nothing says, with those that are likely. InputError: one is not said.

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        chosen: role and column of each quantity.
    """
    if missing := _missing_units(table, options, chosen):
        columns, units = (
            ", ".join(f"'{column}'" for column, _ in missing),
            dict.fromkeys(u for _, u in missing),
        )
        unknown = next(filter(None, (unknown_unit(column) for column, _ in missing)), "")
        single = len(missing) == 1
        said = f"{'does' if single else 'do'} not say {'its unit' if single else 'their units'}"
        said += f" in a way that is known ('{unknown}')" if unknown else ""
        raise InputError(
            f"{table.path}: column{'' if single else 's'} {columns} {said}; say "
            f"{'it' if single else 'them'}, as in {' '.join(units)}"
        )


def _missing_units(
    table: Table, options: ImportOptions, chosen: dict[Key, tuple[Role, str]]
) -> list[tuple[str, str]]:
    """The columns whose unit nothing says, each with the option that says the likely one."""
    missing = []
    for role, column in chosen.values():
        if role.quantity != "time" and not unit_of(table, options, role, column):
            linear = ("force", role.joint) in chosen and ("torque", role.joint) not in chosen
            unit = _likely_unit(table, role, column, linear=linear)
            missing.append((column, f"--unit {role.quantity}={unit}"))
    return missing


def check_force_of_angle(table: Table, options: ImportOptions, chosen: dict[Key, tuple[Role, str]]) -> None:
    """Ask for the lever arm where a joint has an angle and a force, and nothing else makes a channel.

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        chosen: role and column of each quantity.

    Raises:
        InputError: this is so.
    """
    if DISPLACEMENT in chosen or any(quantity in {"torque", "goal"} for quantity, _ in chosen):
        return
    for (quantity, joint), (role, column) in chosen.items():
        if quantity != "position" or ("force", joint) not in chosen:
            continue
        force_role, force = chosen["force", joint]
        unit = unit_of(table, options, force_role, force)
        in_n = SI["force"].get(unit)
        if dimension_of(unit_of(table, options, role, column)) == "angle" and (in_n or not unit):
            torque = Role("torque", joint, "", role.shift).numbered
            raise InputError(
                f"{table.path}: column '{column}' is an angle and '{force}' a force, not a torque; if the "
                f"force acts on a lever arm of 0.1 m, say --column {torque}={shlex.quote(force)} "
                f"--unit {torque}={0.1 * (in_n or 1.0):g}Nm"
            )


def _likely_unit(table: Table, role: Role, column: str, *, linear: bool = False) -> str:
    """The SI unit, or where the numbers are large for that, the one that laboratories take.

    `linear`: a position is that of a linear axis, whose effort is a force.
    """
    values = table.numbers(column) if table.is_numeric(column) else np.zeros(1)
    if role.quantity == "time":
        step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
        return likely_time_unit(step, float(np.ptp(values)) if step > 0.0 else np.inf)
    span = float(np.ptp(values))
    if linear and role.quantity == "position":
        most, otherwise = _LARGE["displacement"]
        return otherwise if span > most else "m"
    most, otherwise = _LARGE.get(role.quantity, (np.inf, ""))
    return otherwise if span > most else si_unit(QUANTITIES[role.quantity][0])


def is_said_scaled(table: Table, options: ImportOptions, role: Role, column: str) -> bool:
    """Whether the user says a unit with a number before it, which decides the sign.

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        role: what the column is for.
        column: its name in the file.
    """
    return any(is_scaled(options.units[name]) for name in units_meant(table, options, role, column))


def _said_unit(table: Table, options: ImportOptions, role: Role, column: str) -> str:
    return normalise(next((options.units[name] for name in units_meant(table, options, role, column)), ""))


def check_units_are_used(table: Table, options: ImportOptions, chosen: dict[Key, tuple[Role, str]]) -> None:
    """Refuse a unit for something that is not there: it would be lost without a word.

    Args:
        table: the rows of the file, with the names of their columns.
        options: what the user says of columns, units and rows.
        chosen: role and column of each quantity.

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


Numbered = dict[str, dict[int, str]]  # column of each joint of each quantity


def joint_shift(table: Table, columns: Mapping[str, str]) -> int:
    """What to add to the numbers of the joints so that they count from 1.

    Args:
        table: the rows.
        columns: what the user says, which goes before their names.

    Raises:
        InputError: positions and another quantity count from different numbers.
    """
    own = _numbered(name for name in table.names if name not in columns.values())
    positions = own.get("position", {})
    for quantity, others in own.items():  # refuse what may be one joint's or the next one's
        if len(positions) == len(others) and {min(positions), min(others)} == {0, 1}:
            first, pairs = min(positions), zip(sorted(positions), sorted(others), strict=True)
            remedy = " ".join(
                f"--column {quantity}_{joint}={shlex.quote(others[joint_there])}"
                for joint, joint_there in pairs
            )
            raise InputError(
                f"{table.path}: joints of position count from {first}, those of {quantity} from {1 - first}; "
                f"say which is whose, such as {remedy}"
            )
    return int(any(0 in joints for numbered in (own, _numbered(columns)) for joints in numbered.values()))


def _numbered(names: Iterable[str]) -> Numbered:
    numbered: Numbered = {}
    for guess in map(guess_column, names):
        if guess.quantity in OF_JOINTS and guess.joint is not None:
            numbered.setdefault(guess.quantity, {})[guess.joint] = guess.column
    if "position" not in numbered:  # then the forces are those of presses
        numbered.pop("force", None)
    if {*numbered} & {*EFFORTS} or len(numbered.get("goal", ())) != len(numbered.get("position", ())):
        numbered.pop("goal", None)
    return numbered
