"""Decide which channels the columns of a data file form, or explain why they form none."""

import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.assign_columns import ColumnAssignment
from palpate.estimation.data.choose_columns import EFFORTS
from palpate.estimation.data.column_names import (
    DISPLACEMENT,
    QUANTITIES,
    TIME,
    Key,
    channel_pairs,
    goal_pair,
    guess_columns,
    is_angle,
    quantity_in,
    unit_in_name,
    words_of,
)
from palpate.estimation.data.column_units import ColumnUnits
from palpate.estimation.data.file_columns import list_first
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.join_columns import completing_file
from palpate.estimation.data.table import Table
from palpate.estimation.data.table_layout import clocks_of
from palpate.estimation.data.text_dialect import NAMELESS
from palpate.estimation.data.units import dimension_of
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

# Quantities of columns that cannot be an effort.
_NO_EFFORT = {"time", "position", "velocity", "acceleration", "run", "phase", "goal", "none"}
_EFFORT_DIMENSIONS = {dimension for quantity in EFFORTS for dimension in QUANTITIES[quantity]}
# Quantities and dimensions of a motion.
_MOTIONS = {"displacement", "position", "velocity", "length", "strain", "angle", "length_rate", "angle_rate"}
# Words for numbers of rows, which are neither a motion nor an effort.
_COUNTERS = frozenset("index idx sample samples counter number no id row step".split())  # noqa: SIM905
# Words for the command of a drive, which may stand for its torque or force.
_DRIVE = frozenset("u pwm duty voltage volt volts input dac pct percent".split())  # noqa: SIM905
_OUTPUT = frozenset({"y", "out", "output"})  # words for the output of a drive
_MIN_CLOCK_STEP = 1e-5  # least step of a clock [s]; that of a spreadsheet's day number is smaller
_SAME_CLOCK = 1.0 - 1e-6  # least correlation of two columns that hold the same clock
_MAX_GUESSED = 4  # most columns without names among which motion and effort are guessed
_MIN_COLUMNS = 3  # least number of columns of which one may be a clock
_MIN_CHANGING = 0.2  # least share of steps in which a coarse clock changes
_RISING = 0.8  # least share of steps by which a clock increases, which may restart in each run
_EVEN = 0.9  # least share of these steps that are nearly equal
_MAX_UNEVEN = 0.5  # largest relative deviation of most steps of a clock from their median
_SHOWN_CELLS = 12  # cells of a row that an error message shows


@dataclass(frozen=True)
class ChannelSource:
    """Origin of a channel: its name, kind, and the columns of position and effort."""

    name: str  # "contact" or "joint_1", "joint_2" ...
    kind: ChannelKind
    position: Key  # key of the position, or of the velocity that is integrated to a position
    effort: Key

    @property
    def joint(self) -> int:
        """Number of the joint, 0 for a contact or an unnumbered joint."""
        return self.position[1]

    @property
    def keys(self) -> tuple[Key, ...]:
        """All columns that the channel uses if the file has them."""
        return self.position, self.effort, ("velocity", self.joint), ("acceleration", self.joint)


def channel_sources(columns: ColumnAssignment) -> list[ChannelSource]:
    """Return the channels for which there are columns, at least one.

    Args:
        columns: columns of the file.

    Raises:
        InputError: no channel can be made; the message suggests options.
    """

    def turns(motion: Key) -> bool:
        return columns.assigned[motion].dimension in {"angle", "angle_rate"}

    def fits(motion: Key, effort: Key) -> bool:
        return effort[0] in ({"torque", "goal"} if turns(motion) else {"force"})

    sources = []
    for motion, effort in channel_pairs(columns.assigned, fits):
        kind = ChannelKind.REVOLUTE if turns(motion) else ChannelKind.PRISMATIC
        kind = ChannelKind.SERVO if effort[0] == "goal" else kind
        is_contact = motion == DISPLACEMENT
        name = "contact" if is_contact else f"joint_{max(motion[1], 1)}"
        sources.append(ChannelSource(name, ChannelKind.CONTACT if is_contact else kind, motion, effort))
    if sources:
        return sources
    _check_dimensions(columns)
    table, first_row = columns.table, ""
    if NAMELESS in table.notes:
        cells = list_first([table.labels(name)[0][0] for name in table.names], _SHOWN_CELLS)
        first_row = f" (the file has no column names; its first row is {cells})"
    if (path := completing_file(table)) is not None:
        files = f"{shlex.quote(str(table.path))} {shlex.quote(str(path))}"
        raise InputError(
            f"{table.path}: holds only a part of a measurement ({table.listed_names}); {path.name} has "
            f"the same number of rows and completes it; give both, as in palpate import {files}"
        )
    if len(table.names) == 1:
        raise InputError(
            f"{table.path}: holds only one column, '{table.names[0]}'; a measurement needs at least three: "
            "time, motion and effort; if other files hold them, give all these files"
        )
    reason = f"no channel can be made of columns {table.listed_names}{first_row}"
    raise InputError(f"{table.path}: {reason}; {_suggest_columns(columns)}")


def check_options_are_used(
    columns: ColumnAssignment, sources: Collection[ChannelSource], options: ImportOptions
) -> None:
    """Check that each quantity named in the options is used, since others would be ignored silently.

    Args:
        columns: columns of the file.
        sources: the channels of the file.
        options: options for columns and units.

    Raises:
        InputError: no channel uses a quantity that the user named.
    """
    used = {TIME, *(key for source in sources for key in source.keys)}
    for key, assigned in columns.assigned.items():
        if key in used:
            continue
        texts = [f"--column {name}={c}" for name, c in options.columns.items() if c == assigned.column]
        names = ColumnUnits(columns.table, options).option_names(columns.role(key), assigned.column)
        texts += [f"--unit {name}={options.units[name]}" for name in names]
        if texts:
            channels = "; ".join(
                f"{source.name} of '{columns.name(source.position)}', '{columns.name(source.effort)}'"
                for source in sources
            )
            raise InputError(
                f"{columns.table.path}: {' '.join(texts)}: no channel uses it as "
                f"{columns.role(key).numbered}. Channels: {channels}"
            )


def _check_dimensions(columns: ColumnAssignment) -> None:
    """Raise an error if a joint has an angle with a force, or a length with a torque."""
    for (quantity, joint), position in columns.assigned.items():
        other_effort = ("force" if position.dimension == "angle" else "torque", joint)
        if quantity != "position" or other_effort not in columns:
            continue
        effort, correction = columns.assigned[other_effort], "correct one with --unit or --column"
        if effort.dimension == "current":
            force = columns.role(("force", joint)).numbered
            correction = (
                "if it is the current of a linear motor with 20 N/A, add "
                f"--column {force}={shlex.quote(effort.column)} --unit {force}=20N/A"
            )
        raise InputError(
            f"{columns.table.path}: column '{position.column}' is in {position.unit} and "
            f"'{effort.column}' in {effort.unit}: a torque goes with an angle (rad, deg), a force with a "
            f"length (m, mm); {correction}"
        )


def _suggest_columns(columns: ColumnAssignment) -> str:
    """Describe the columns that channels need, and options for a column that probably is an effort."""
    table = columns.table
    guesses = {guess.column: guess for guess in guess_columns(table.names, clocks_of(table.columns))}
    quantity_by_name = {name: guesses[name].quantity or quantity_in(name) for name in table.names}
    needed = (
        "a contact needs time_s, displacement_m, force_N; a joint needs time_s, position_rad, torque_Nm (or "
        "position_m, force_N)"
    )
    dimension_by_name = {name: dimension_of(unit_in_name(name)) for name in table.names}
    # A force with an invalid cell counts as varying, so that the cell is reported when its values are used.
    varying = [
        name
        for name in table.names
        if table.varies(name) or (quantity_by_name[name] in EFFORTS and _has_invalid_cell(table, name))
    ]
    has_effort = any(quantity in EFFORTS for quantity, _ in columns.assigned) or any(
        quantity_by_name[n] in EFFORTS if quantity_by_name[n] else dimension_by_name[n] in _EFFORT_DIMENSIONS
        for n in varying
    )
    numbers = [name for name in varying if _COUNTERS.isdisjoint(words_of(name))]
    free = [name for name in numbers if name not in columns.used and quantity_by_name[name] not in _NO_EFFORT]
    positions = [name for name in numbers if quantity_by_name[name] == "position"]
    angles = [*filter(is_angle, positions)]
    lengths = [name for name in positions if name not in angles]
    motions = {quantity_by_name[name] or dimension_by_name[name] or "" for name in numbers}
    has_motion = not motions.isdisjoint(_MOTIONS) or any(key[0] in _MOTIONS for key in columns.assigned)
    # The columns of a matrix in a MATLAB file, "data 1" ..., have no names either.
    stems = {name.rstrip("0123456789") for name in table.names}
    is_nameless = NAMELESS in table.notes or (len(stems) == 1 and not any(quantity_by_name.values()))
    if not has_effort and not is_nameless:
        missing = "by names and units, no column seems to hold a force or torque"
        return f"{missing}; {needed}; {_suggest_effort(numbers, free, quantity_by_name)}"
    joints = [g.joint for g in guesses.values() if g.quantity == "position" and g.joint is not None]
    torque = columns.assigned.get(("torque", 0))
    if torque is not None and joints:
        return f"{needed}; state the joint, as in --column torque_{joints[0]}={shlex.quote(torque.column)}"
    unknown = "" if has_motion else "by names and units, no column seems to hold a motion; "
    unknown = "which column holds what is not known; " if is_nameless else unknown
    others = [name for name in free if name not in angles]
    efforts = [name for name in others if quantity_by_name[name] in EFFORTS]
    is_torque = bool(efforts) and all(quantity_by_name[name] == "torque" for name in efforts)
    if (angles and others) or (is_torque and not lengths):
        options = _joint_options(angles, (efforts or others)[0])
        return f"{needed}; {unknown}name the columns, as in {' '.join(options)}"
    options = list[str]()
    if TIME not in columns:
        named_clock = next((name for name in numbers if quantity_by_name[name] == "time"), "")
        clocks = [named_clock] if named_clock else _clocks(table, free) if is_nameless else []
        options += [f"--column time={shlex.quote(clocks[0])}"] if clocks else []
        free = [name for name in free if name not in clocks]
    # A column whose name or unit says something else is never suggested.
    uninformative = [name for name in free if not (quantity_by_name[name] or dimension_by_name[name])]
    if is_nameless:
        free = [] if len(free) > _MAX_GUESSED else free
    else:  # a counter, or one of several columns, is no likely motion
        uninformative = [name for name in uninformative if not _counts(table.numbers(name))]
        uninformative = uninformative if has_motion or len(uninformative) == 1 else []
    options += _contact_options(columns, free, uninformative, lengths, quantity_by_name)
    return f"{needed}; {unknown}name the columns, as in {' '.join(options)}"


def _contact_options(
    columns: ColumnAssignment,
    free: Sequence[str],
    uninformative: Collection[str],
    lengths: Sequence[str],
    quantity_by_name: Mapping[str, str],
) -> list[str]:
    """Return the options that read columns as the displacement and the force of a contact.

    Args:
        columns: columns of the file.
        free: names of the columns that may be read.
        uninformative: those whose names and units mean no quantity.
        lengths: names of the columns that hold a position along a line.
        quantity_by_name: quantity of each column according to its name; empty for none.
    """
    options, table = list[str](), columns.table
    # Of columns with uninformative names, the smoothest one is suggested as the displacement.
    free = sorted(free, key=lambda n: np.abs(np.diff(table.numbers(n))).sum() / np.ptp(table.numbers(n)))
    for quantity, unit, last in (("displacement", "mm", 0), ("force", "N", -1)):
        if (quantity, 0) in columns:
            continue
        fitting = [name for name in free if dimension_of(unit_in_name(name)) in QUANTITIES[quantity]]
        named = [name for name in free if quantity_by_name[name] == quantity]
        if quantity == "displacement" and lengths and not (fitting or named):
            options.append(f"--column position={shlex.quote(lengths[0])} --unit position={unit}")
        elif candidates := fitting or named or [name for name in free if name in uninformative]:
            column = candidates[0 if fitting or named else last]
            free.remove(column)
            options.append(f"--column {quantity}={shlex.quote(column)}")
            options += [] if fitting else [f"--unit {quantity}={unit}"]
        else:
            options.append(f"--column {quantity}_{unit}=COLUMN")
    return options


def _joint_options(angles: Sequence[str], effort: str) -> list[str]:
    """Return the options that read a column as the torque of a joint.

    Args:
        angles: names of the columns that hold angles.
        effort: name of the column.
    """
    options = [f"--column torque={shlex.quote(effort)}"]
    if dimension_of(unit_in_name(effort)) not in QUANTITIES["torque"]:
        options.append("--unit torque=1Nm")
    if not angles:
        options.append("--column position_rad=COLUMN")
    elif len(angles) > 1 or not unit_in_name(angles[0]):
        options.append(f"--column position={shlex.quote(angles[0])}")
        options += [] if unit_in_name(angles[0]) else ["--unit position=deg"]
    return options


def _has_invalid_cell(table: Table, name: str) -> bool:
    """Return whether most cells of a column are numbers, but not all."""
    try:
        table.numbers(name)
    except InputError:
        return table.numeric_share(name) > 0.5
    return False


def _counts(values: FloatArray) -> bool:
    """Return whether values (n,) are whole numbers with equal steps, as those of a counter of rows."""
    return bool((values == np.round(values)).all() and np.ptp(np.diff(values)) == 0.0)


def _suggest_effort(numbers: Sequence[str], free: Sequence[str], quantity_by_name: Mapping[str, str]) -> str:
    """Suggest an effort if no column names one: the command of a drive, or any column.

    Args:
        numbers: names of the columns that vary.
        free: those that may hold an effort.
        quantity_by_name: quantity of each column according to its name; empty for none.
    """
    voltages = [name for name in free if dimension_of(unit_in_name(name)) == "voltage"]
    if drive := next((n for n in free if n in voltages or not _DRIVE.isdisjoint(words_of(n))), ""):
        moving = [n for q in ("position", "velocity") for n in numbers if quantity_by_name[n] == q]
        motion = quantity_by_name[moving[0]] if moving else "position"
        moving += [name for name in free if name != drive and not _OUTPUT.isdisjoint(words_of(name))]
        is_linear = bool(moving) and (dimension_of(unit_in_name(moving[0])) or "").startswith("length")
        effort, unit = ("force", "N") if is_linear else ("torque", "Nm")
        return (
            f"if '{drive}' is the command of a drive, it can replace the force or torque: "
            f"--column {motion}={shlex.quote(moving[0]) if moving else 'COLUMN'} "
            f"--column {effort}={shlex.quote(drive)} --unit {effort}=1{unit}"
        )
    if pair := goal_pair(numbers):
        position, goal = map(shlex.quote, pair)
        return (
            f"if {position} is an angle and {goal} its goal, the goal can replace the torque: "
            f"--column position={position} --column goal={goal}"
        )
    column = shlex.quote(free[0]) if len(free) == 1 else "COLUMN"
    return (
        f"if a column holds a force or torque, add --column force_N={column} or --column torque_Nm={column}"
    )


def _is_even(steps: FloatArray) -> bool:
    """Return whether the positive steps (n,) of a column are nearly equal; a clock may restart or pause."""
    rises = steps[steps > 0.0]
    return bool(np.mean(np.abs(rises / np.median(rises) - 1.0) < _MAX_UNEVEN) > _EVEN)


def _clocks(table: Table, free: list[str]) -> list[str]:
    """Return the columns without names that rise as a clock does, the likeliest first; copies follow it."""
    if len(table.names) < _MIN_COLUMNS or not free:
        return []
    steps = {name: np.diff(table.numbers(name)) for name in free}
    share = {name: float(np.mean(steps[name] > 0.0)) for name in free}
    rising = [name for name in free if share[name] > _RISING and _is_even(steps[name])]
    rising.sort(key=lambda name: -share[name])
    always = [name for name in free if share[name] == 1.0]
    rising = rising or always * (len(always) == 1)  # the clock of a logger may be uneven
    first = free[0]
    if first not in rising and (steps[first] >= 0.0).all() and np.mean(steps[first] > 0.0) > _MIN_CHANGING:
        rising.insert(0, first)
    if not rising:
        return []
    clock = next((name for name in rising if np.median(steps[name]) >= _MIN_CLOCK_STEP), rising[0])
    times = table.numbers(clock)
    copies = [
        name
        for name in rising
        if name != clock and correlation_coefficient(times, table.numbers(name)) > _SAME_CLOCK
    ]
    return [clock, *copies]
