"""Choose the columns that form channels, and number their joints."""

import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from palpate.estimation.data.column_names import (
    DISPLACEMENT,
    JOINT_QUANTITIES,
    NO_JOINT,
    POSITION,
    TIME,
    Key,
    Role,
    channel_pairs,
    guess_column,
    guess_columns,
    quantity_in,
    unit_in_name,
    with_whole_joint_names,
)
from palpate.estimation.data.column_units import Chosen, ColumnUnits, explain_numbers
from palpate.estimation.data.table import Table
from palpate.estimation.data.units import dimension_of, si_factor
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

EFFORTS = ("force", "torque")
_DERIVABLE = frozenset({"velocity", "acceleration"})
_MAX_OPPOSITE_FORCE = 0.2  # largest force of opposite sign in a press, relative to the largest force
_PRESS_CORRELATION = 0.3  # least correlation of position and force in a press
# Most levels of a parameter, and largest share of steps between rows at which it changes.
_MAX_LEVELS, _MAX_CHANGING = 20, 0.2
_START_SHARE = 0.05  # first share of the travel, in which a linear axis already needs its force


def choose_columns(
    units: ColumnUnits, known: Chosen, reserved: Collection[str], shift: int, *, ask: bool = True
) -> Chosen:
    """Choose the columns that form channels together with the known columns.

    Columns without a unit are considered only if no other columns form a channel.

    Args:
        units: units of the table's columns.
        known: quantities already assigned by palpate's own names or by options.
        reserved: columns of the known quantities, and columns that must not be used.
        shift: number to add to the joint numbers in the file so that they count from 1.
        ask: whether to raise an error for columns that match equally well, or else to choose the first.

    Raises:
        InputError: two columns match a required quantity equally well, or a required column has a cell that
            is not a number.
    """
    table = units.table
    as_time = {name for name in table.names if units.option_names(Role(name, *TIME))}
    parameters = [
        name
        for name in table.names
        if name not in reserved and name not in as_time and _is_parameter_named_as_time(table, name)
    ]
    candidates = [name for name in table.names if name not in parameters]
    guessed = guess_columns(candidates, table.clocks)
    numbered = _number_by_names(guessed, units.options.joint_names, 1 - shift)
    named = [g for g in numbered if g.quantity and g.column not in reserved and g.key not in known]
    is_single_joint = any(quantity in JOINT_QUANTITIES and joint == NO_JOINT for quantity, joint in known)
    if is_single_joint:  # the user named it
        named = [g for g in named if g.quantity not in JOINT_QUANTITIES or g.joint == NO_JOINT]
    axis, by_user = known.get(POSITION), {*units.options.columns.values()}
    if axis and axis.column in by_user and dimension_of(units.unit_of(axis)) == "length":
        named = [g for g in named if g.key != DISPLACEMENT]  # the force moves the axis
    free = [guess for guess in named if table.numeric_share(guess.column) > 0.5]
    if any(guess.quantity == "position" for guess in free):  # a constant length is then a lever arm
        free = [guess for guess in free if guess.key != DISPLACEMENT or table.varies(guess.column)]
    available = {*known, *(guess.key for guess in free)}
    if not (_keys_of_channels(available) and TIME in available):
        keys = _keys_of_channels({*known, *(guess.key for guess in named)})
        for guess in named:  # report the invalid cell if the column would complete a channel
            # An empty column is only meant as a signal if its name states a unit.
            is_signal = guess.unit or any(table.labels(guess.column)[0])
            if is_signal and guess.key in keys and guess.key not in available:
                table.numbers(guess.column)
    user_guesses = {guess for guess in free if units.option_names(guess)}
    clear = [guess for guess in free if guess.unit or guess.key == TIME or guess in user_guesses]
    guesses = clear if _keys_of_channels({*known, *(guess.key for guess in clear)}) else free
    guesses_of: dict[Key, list[Role]] = {}
    for guess in guesses:
        guesses_of.setdefault(guess.key, []).append(guess)
    lengths = {k for k, of in guesses_of.items() if all(dimension_of(g.unit) == "length" for g in of)}
    lengths |= {key for key, role in known.items() if dimension_of(units.unit_of(role)) == "length"}
    keys = [key for key in _keys_of_channels({*known, *guesses_of}, lengths) if key in guesses_of]
    keys += [  # velocity and acceleration are also read if the user states their unit
        guess.key
        for guess in clear
        if guess.quantity in _DERIVABLE and guess.key not in keys and guess in user_guesses
    ]
    # Several columns without a change are settings, such as gains of a controller, and no measurement.
    for key in [key for key in keys if len(guesses_of[key]) > 1]:
        if not any(table.varies(guess.column) for guess in guesses_of[key]):
            keys.remove(key)
    fitting = {key: _best_matches(table, key, guesses_of[key]) for key in keys}
    chosen = {key: best for key, (best, *_) in fitting.items()}
    questions, answers = [], []
    for key, role in chosen.items():
        if len(fitting[key]) > 1:
            names = " and ".join(f"'{guess.column}'" for guess in fitting[key][:4])
            questions.append(f"columns {names} may hold {role.numbered}")
            answers.append(f"--column {role.numbered}={shlex.quote(role.column)}")
    if questions and ask:
        answers += [unit for _, unit in units.missing(chosen)]
        raise InputError(
            f"{table.path}: {', '.join(questions)}; choose with "
            + explain_numbers(" ".join(dict.fromkeys(answers)))
        )
    return chosen


def _number_by_names(guesses: Sequence[Role], joint_names: Sequence[str], first: int) -> list[Role]:
    """Number the columns that contain names of the arm's joints, unless one of these does not occur."""
    patterns = [re.compile(rf"(?<![^\W_]){re.escape(name)}(?![^\W_])") for name in joint_names]
    named: dict[str, int] = {}
    for guess in guesses:
        lengths = [
            (len(found[0]), n) for n, p in enumerate(patterns, first) if (found := p.search(guess.column))
        ]
        if lengths and guess.quantity in JOINT_QUANTITIES:
            named[guess.column] = max(lengths)[1]  # "wrist_1" also contains "wrist"
    complete = len(set(named.values())) == len(joint_names)
    return [replace(g, joint=named.get(g.column, g.joint)) if complete else g for g in guesses]


def _keys_of_channels(available: Collection[Key], lengths: Collection[Key] = ()) -> list[Key]:
    """Return the keys of all channels; a torque goes with one of the lengths only if nothing else does."""
    pairs = channel_pairs(available, lambda motion, effort: motion not in lengths or effort[0] != "torque")
    pairs = pairs or channel_pairs(available)
    return [TIME, *chain.from_iterable(pairs)] if pairs else []


def _is_parameter_named_as_time(table: Table, name: str) -> bool:
    """Return whether a column that may be named after the time, such as "T", holds levels of a parameter.

    A thickness or a temperature has few levels, each in many consecutive rows. A clock that is coarser than
    the rows has many. A name with a word for the time, or with a unit of time, is always a clock.
    """
    is_clear = quantity_in(name) == TIME[0] or dimension_of(unit_in_name(name)) == "time"
    if is_clear or guess_column(name).key != TIME or name in table.clocks:
        return False
    if table.numeric_share(name) < 1.0:
        return False
    values = table.numbers(name)
    changing = np.count_nonzero(np.diff(values)) / max(len(values) - 1, 1)
    return bool(0.0 < changing <= _MAX_CHANGING and len(np.unique(values)) <= _MAX_LEVELS)


def is_pressed(position: FloatArray, force: FloatArray) -> bool:
    """Return whether a position and a force look like those of a press rather than of a linear axis.

    The force of a press has one sign. It grows with the position, or is zero when the motion begins. The
    force of an axis has both signs, or begins with the first movement, as friction does.

    Args:
        position: position in any unit, shape (n,).
        force: force in any unit and of any sign convention, shape (n,).
    """
    low, high = np.quantile(force, [0.005, 0.995])
    largest = max(abs(low), abs(high))
    if min(abs(low), abs(high)) >= _MAX_OPPOSITE_FORCE * largest:
        return False
    moved = np.abs(position - position[0])
    begins = slice(int(np.argmax(moved > 0.0)), int(np.argmax(moved > _START_SHARE * np.ptp(position))))
    peak = int(np.argmax(np.abs(force))) + 1  # after the peak an object may tear; an axis may start with it
    parts = [slice(begins.start, end) for end in (len(force), peak) if end > begins.stop]
    if any(abs(correlation_coefficient(position[part], force[part])) > _PRESS_CORRELATION for part in parts):
        return True
    return bool(force[begins].size and abs(np.median(force[begins])) < _MAX_OPPOSITE_FORCE * largest)


def _best_matches(table: Table, key: Key, guesses: list[Role]) -> list[Role]:
    """Return the columns with the best fitting names and different values; a time preferably increases."""
    if len(guesses) > 1:
        guesses = [guess for guess in guesses if len(table.labels(guess.column)[0]) > 1] or guesses
    if len(guesses) > 1 and key == TIME:
        guesses = [guess for guess in guesses if table.varies(guess.column)] or guesses
        for compare in (np.greater, np.greater_equal):  # a clock may repeat a time
            increasing = [g for g in guesses if compare(np.diff(table.numbers(g.column)), 0.0).all()]
            if increasing:
                guesses = increasing
                break
    fit = max(guess.fit for guess in guesses)
    first, *equal = (guess for guess in guesses if guess.fit == fit)
    read = first.column, first.unit
    return [first, *(g for g in equal if not have_equal_values(table, key, read, (g.column, g.unit)))]


def have_equal_values(table: Table, key: Key, first: tuple[str, str], second: tuple[str, str]) -> bool:
    """Return whether two columns have equal values, possibly in different units, or both without one.

    Args:
        table: the table.
        key: quantity of both columns; times are compared relative to the first one.
        first: name and unit of a column.
        second: name and unit of the other column.
    """
    if dimension_of(first[1]) != dimension_of(second[1]):
        return False
    try:
        values, other_values = (
            table.numbers(column) * (si_factor(unit) if unit else 1.0) for column, unit in (first, second)
        )
    except InputError:
        return False
    if key == TIME:
        values, other_values = values - values[0], other_values - other_values[0]
    return bool(np.allclose(values, other_values, rtol=1e-3, atol=1e-3 * float(np.ptp(values))))


Numbered = dict[str, dict[int, str]]  # column of each joint of each quantity


def joint_shift(table: Table, columns: Mapping[str, str]) -> int:
    """Return the number to add to the joint numbers so that they count from 1.

    Args:
        table: the table.
        columns: columns by quantity as stated by the user, which take precedence over names.

    Raises:
        InputError: the joint numbers of positions and of another quantity start at different numbers.
    """
    numbered = _numbered(name for name in table.names if name not in columns.values())
    positions = numbered.get("position", {})
    for quantity, columns_of in numbered.items():  # reject numbers that are ambiguous by one joint
        if len(positions) == len(columns_of) and {min(positions), min(columns_of)} == {0, 1}:
            first, pairs = min(positions), zip(sorted(positions), sorted(columns_of), strict=True)
            remedy = " ".join(
                f"--column {quantity}_{joint}={shlex.quote(columns_of[joint_there])}"
                for joint, joint_there in pairs
            )
            raise InputError(
                f"{table.path}: joint numbers start at {first} for position, but at {1 - first} for "
                f"{quantity}; give the columns of one joint the same number, such as {remedy}"
            )
    all_joints = [*numbered.values(), *_numbered(columns).values()]
    return int(any(0 in joints for joints in all_joints))


def _numbered(names: Iterable[str]) -> Numbered:
    numbered: Numbered = {}
    for guess in with_whole_joint_names(list(map(guess_column, names))):
        if guess.quantity in JOINT_QUANTITIES and guess.joint != NO_JOINT:
            numbered.setdefault(guess.quantity, {})[guess.joint] = guess.column
    if "position" not in numbered:  # the forces then belong to presses
        numbered.pop("force", None)
    if {*numbered} & {*EFFORTS} or len(numbered.get("goal", ())) != len(numbered.get("position", ())):
        numbered.pop("goal", None)
    return numbered
