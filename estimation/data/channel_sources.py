"""Decide which channels the columns of a data file form, or explain why they form none."""

import re
import shlex
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from palpate.estimation.channel import ChannelKind
from palpate.estimation.data.assign_columns import ColumnAssignment
from palpate.estimation.data.choose_columns import EFFORTS
from palpate.estimation.data.column_names import (
    DISPLACEMENT,
    PROXIES,
    QUANTITIES,
    TIME,
    Key,
    Role,
    channel_pairs,
    is_angle,
    numbered,
    quantity_in,
    unit_in_name,
    words_of,
)
from palpate.estimation.data.column_units import ColumnUnits, explain_numbers
from palpate.estimation.data.file_columns import OTHER_LENGTHS, list_first
from palpate.estimation.data.import_options import NO_OPTIONS, ImportOptions
from palpate.estimation.data.table import Table
from palpate.estimation.data.text_dialect import NAMELESS, OMITTED
from palpate.estimation.data.units import dimension_of
from palpate.robot_io.errors import InputError

# Usual units of the quantities of a channel.
_UNITS = {"displacement": "mm", "force": "N", "position": "rad", "velocity": "rad_s", "torque": "Nm"}
_LINEAR_UNITS = {"position": "m", "velocity": "m_s"}
_TOLD_BY_NUMBERS = "deg", "strain", "%"  # units that names and numbers tell
_JOINT_WORDS = frozenset(["q", "tau", "joint", "current", "torque"])  # in names of joints' columns
_RISES = 0.9  # least share of rows in which a clock rises; it may restart in each run
_MANY_TIMES = 10  # least ratio of columns to rows of a table whose rows hold signals
_MIN_COLUMNS = 3  # least number of columns of which one may be a clock
_MIN_ARM = 4  # least number of columns of which two may be positions and two torques
_INTERVAL = "; if no column holds the time, add the interval of rows, such as --unit time=10ms"


@dataclass(frozen=True)
class ChannelSource:
    """Origin of a channel: its name, kind, and the columns of position and effort."""

    name: str  # "contact" or "joint_1", "joint_2" ...
    kind: ChannelKind
    position: Key  # key of the position, or of the velocity that is integrated to a position
    effort: Key

    @property
    def joint(self) -> int:
        """Number of the joint in the file, or `NO_JOINT`."""
        return self.position[1]


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
        name = "contact" if is_contact else f"joint_{max(motion[1] + columns.shift, 1)}"
        sources.append(ChannelSource(name, ChannelKind.CONTACT if is_contact else kind, motion, effort))
    if sources:
        return sources
    _check_dimensions(columns)
    table, first_row = columns.table, ""
    if NAMELESS in table.notes:
        cells = list_first([table.labels(name)[0][0] for name in table.names])
        if len(table.names) > _MANY_TIMES * len(table):
            raise InputError(
                f"{table.path}: has {len(table)} rows and {len(table.names):,} columns without names, so "
                "each row seems to hold a signal. Either save the table transposed, for example with "
                "numpy.savetxt(NEW, numpy.loadtxt(FILE).T), or begin each row with the name of its signal "
                "and a comma"
            )
        first_row = f" (the file has no column names; its first row is {cells})"
    if len(table.names) == 1:
        raise InputError(
            f"{table.path}: holds only one column, '{table.names[0]}'; a measurement needs at least three: "
            "time, motion and effort; if other files hold the rest, give all files"
        )
    reason = f"no channel can be made of columns {table.listed_names}{first_row}"
    tables = [note for note in table.notes if note.startswith((OMITTED, OTHER_LENGTHS))]
    raise InputError("; ".join([f"{table.path}: {reason}", _suggest_columns(columns), *tables]))


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
    used = {TIME}
    for source in sources:
        used |= {source.position, source.effort, ("velocity", source.joint), ("acceleration", source.joint)}
    for key, assigned in columns.assigned.items():
        if key in used:
            continue
        texts = [f"--column {name}={c}" for name, c in options.columns.items() if c == assigned.column]
        names = ColumnUnits(columns.table, options).option_names(Role(assigned.column, *key))
        texts += [f"--unit {name}={options.units[name]}" for name in names]
        if texts:
            channels = "; ".join(
                f"{source.name} of '{columns.name(source.position)}', '{columns.name(source.effort)}'"
                for source in sources
            )
            raise InputError(
                f"{columns.table.path}: {' '.join(texts)}: no channel uses '{assigned.column}' "
                f"as {numbered(key)}. Channels: {channels}"
            )


def _check_dimensions(columns: ColumnAssignment) -> None:
    """Raise an error if a joint has an angle with a force, or a length with a torque; or a rate of these."""
    for (quantity, joint), motion in columns.assigned.items():
        turns = motion.dimension in {"angle", "angle_rate"}
        other_effort = ("force" if turns else "torque", joint)
        if quantity not in {"position", "velocity"} or other_effort not in columns:
            continue
        effort, correction = columns.assigned[other_effort], "correct one with --unit or --column"
        force = numbered(("force", joint))
        as_force = f"add --column {force}={shlex.quote(effort.column)} --unit {force}"
        if effort.dimension == "current":
            correction = f"if '{effort.column}' is the current of a linear motor of 20 N/A, {as_force}=20N/A"
        elif not turns:
            names = (name for name in columns.unused if quantity_in(name) == "position")
            rate = "/s" if quantity == "velocity" else ""
            as_angle = f"--unit {numbered((quantity, joint))}=rad{rate}"
            if rate and (name := next(names, "")):
                as_angle = f"--column position={shlex.quote(name)} --unit position=rad"
            correction = (
                f"if the axis turns, add {as_angle}; if it moves along a line and is driven at a radius of "
                f"0.1 m, {as_force}={effort.factor / 0.1:g}N"
            )
        raise InputError(
            f"{columns.table.path}: column '{motion.column}' is in {motion.unit.replace('_', '/')} and "
            f"'{effort.column}' in {effort.unit}, but a torque goes with an angle (rad, deg) and a force "
            f"with a length (m, mm); {correction}"
        )


def _suggest_columns(columns: ColumnAssignment) -> str:
    """Describe the columns that channels need, and propose options from names and units."""
    table = columns.table
    needed = (
        "a contact needs time_s, displacement_m, force_N; a joint needs time_s, position_rad, torque_Nm (or "
        "position_m, force_N)"
    )
    # The columns of a matrix in a MATLAB file, "data 1" ..., have no names either.
    stems = {name.rstrip("0123456789") for name in table.names}
    if NAMELESS in table.notes or (len(stems) == 1 and not any(map(quantity_in, table.names))):
        example = _options_without_names(columns)
        return f"{needed}; the meaning of each column is unknown; name the columns, as in {example}"
    found: dict[str, str] = {}  # column of each quantity
    # Words count more than units that may stand for a force, and angles come first.
    by_word = {
        guess.column: guess.quantity
        or quantity_in(guess.column)
        or "force" * (re.match(r"[Ff][xyz]?_", guess.column) is not None)  # as in "F_arm"
        for guess in table.guesses
    }
    dimension_by_name = {name: dimension_of(unit_in_name(name)) for name in table.names}
    proxies = {name for name, dimension in dimension_by_name.items() if dimension in {*PROXIES} - {"strain"}}
    for name in sorted(by_word, key=lambda n: (not is_angle(n), n in proxies, not by_word[n])):
        dimension = dimension_by_name[name]
        by_unit = (quantity for quantity in _UNITS if dimension in QUANTITIES[quantity])
        quantity = by_word[name] or next(by_unit, "")
        if table.numeric_share(name) <= 0.5:
            continue
        filled = table.select(table.filled_rows(name))  # a clock increases, and may repeat times
        rises = quantity != "time" or _rising_share(filled, name) > _RISES
        if quantity in EFFORTS or (filled.varies(name) and rises):
            found.setdefault(quantity, name)
    found |= {key[0]: assigned.column for key, assigned in columns.assigned.items()}
    kinds = (("force or torque", EFFORTS), ("position or displacement", ("position", "displacement")))
    if lacking := [words for words, quantities in kinds if found.keys().isdisjoint(quantities)]:
        needed = f"judging by names and units, no column holds a {', or a '.join(lacking)}; {needed}"
    has_effort = not found.keys().isdisjoint(EFFORTS)
    turns = "force" not in found if has_effort else "position" in found and "displacement" not in found
    motion_unit = unit_in_name(found.get("position", found.get("velocity", "")))
    turns |= is_angle(found.get("position", "")) or dimension_of(motion_unit) == "angle_rate"
    motion, units = _proposed_motion(found, turns=turns), _UNITS if turns else _UNITS | _LINEAR_UNITS
    if turns and has_effort:
        found.setdefault("torque", found.get("force", ""))
    elif motion == "displacement" and "position" in found:
        found.setdefault("displacement", found["position"])
    options = [f"--column time={shlex.quote(found['time'])}"] if "time" in found else []
    given = {key[0]: assigned.unit for key, assigned in columns.assigned.items()}
    for quantity in (motion, "torque" if turns else "force"):
        if quantity not in found:  # the unit prevents a further question
            options.append(f"--column {quantity}{'' if has_effort else '_' + units[quantity]}=COLUMN")
            continue
        options.append(f"--column {quantity}={shlex.quote(found[quantity])}")
        dimension = dimension_by_name[found[quantity]]
        if quantity in given and not unit_in_name(found[quantity]):
            options.append(f"--unit {quantity}={shlex.quote(given[quantity])}")
        elif dimension not in QUANTITIES[quantity]:  # the leading 1 overrides the unit in the column's name
            role = Role(found[quantity], quantity)
            missing = ColumnUnits(table, NO_OPTIONS).missing({role.key: role})
            told = (
                o
                for _, o in missing
                if units[quantity] != "m" and not dimension and ("=0.0" in o or o.endswith(_TOLD_BY_NUMBERS))
            )
            options.append(next(told, f"--unit {quantity}={'1' if dimension else ''}{units[quantity]}"))
    proposed = explain_numbers(" ".join(options))
    if has_effort:
        return f"{needed}; name the columns, as in {proposed}"
    interval = "" if "time" in found else _INTERVAL
    return (
        f"{needed}; if columns hold these quantities, or the command of a drive, name the columns, as in "
        f"{proposed}{interval}; if another file with the same rows holds them, give both files"
    )


def _proposed_motion(found: Collection[str], *, turns: bool) -> str:
    """Return the quantity to propose as the motion; a recorded velocity belongs to an axis, not a press."""
    has_velocity = "velocity" in found and "displacement" not in found
    if has_velocity and "position" not in found:
        return "velocity"
    return "position" if turns or has_velocity else "displacement"


def _rising_share(table: Table, name: str) -> float:
    """Return the share of rows in which a column does not decrease; 0 if it rarely increases."""
    steps = np.diff(table.numbers(name))
    return float(np.mean(steps >= 0.0)) if np.mean(steps > 0.0) > 1.0 - _RISES else 0.0


def _options_without_names(columns: ColumnAssignment) -> str:
    """Return options for columns without names: a clock as the time, the smoother other one as the motion."""
    table, given = columns.table, {key[0] for key in columns.assigned}
    left = [name for name in table.names if name not in columns.used]
    valid = [name for name in left if table.varies(name)]
    options = []
    if "time" not in given and len(left) >= _MIN_COLUMNS:
        clock = max(valid, key=lambda name: (name in table.clocks, _rising_share(table, name)), default="")
        if clock and (clock in table.clocks or _rising_share(table, clock) > _RISES):
            options.append(f"--column time={shlex.quote(clock)}")
            left.remove(clock)
            valid.remove(clock)
    valid.sort(key=lambda name: np.abs(np.diff(table.numbers(name))).sum() / np.ptp(table.numbers(name)))
    is_joint = any(not _JOINT_WORDS.isdisjoint(words_of(name)) for name in table.names)
    pair = ("position", "torque") if is_joint else ("displacement", "force")
    needed = [quantity for quantity in pair if quantity not in given]
    columns_of = (
        map(shlex.quote, valid) if len(left) == len(valid) == len(needed) else ["COLUMN"] * len(needed)
    )
    has_time = "time" in given or bool(options)
    options += [f"--column {quantity}={name}" for quantity, name in zip(needed, columns_of, strict=True)]
    several = "; for several joints, as in --column position_1=COLUMN --column torque_1=COLUMN"
    return " ".join(options) + several * (len(left) >= _MIN_ARM) + _INTERVAL * (not has_time)
