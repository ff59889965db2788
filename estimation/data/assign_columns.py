"""Assign quantities and units to the columns of a table."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.estimation.data.choose_columns import (
    EFFORTS,
    choose_columns,
    have_equal_values,
    is_pressed,
    joint_shift,
)
from palpate.estimation.data.column_names import (
    COUNTERS,
    DISPLACEMENT,
    FORCE,
    NO_JOINT,
    PHASE,
    POSITION,
    QUANTITIES,
    RUN,
    TIME,
    Key,
    Role,
    channel_pairs,
    numbered,
    parse_role,
    role_of_option,
    si_unit,
    split_unit,
    unit_in_name,
    words_of,
)
from palpate.estimation.data.column_units import AssignedColumn, Chosen, ColumnUnits
from palpate.estimation.data.file_columns import list_first, pa
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.presses import MIN_RUN_ROWS, press_sides
from palpate.estimation.data.table import Table
from palpate.estimation.data.units import (
    describe_fault,
    dimension_of,
    invalid_rows,
    scaled_unit,
    si_factor,
)
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

# A counter that rises evenly; it may restart or skip rows.
_UNEVEN, _EVEN_SHARE = 0.5, 0.9  # largest deviation relative to the usual step, and least share of such steps
_MOTIONS = frozenset({"displacement", "position", "velocity"})
_ABSOLUTE = frozenset(["abs", "absolute", "absolut", "betrag", "magnitude"])  # in names of absolute values


@dataclass(frozen=True)
class ColumnAssignment:
    """A table with the meaning of its columns."""

    table: Table  # the table
    assigned: dict[Key, AssignedColumn]  # the columns in use, by quantity
    run: str | None  # column with the run of each row, or None
    phase: str | None  # column with the phase of each row, or None
    choice_notes: tuple[str, ...] = ()  # notes on how the columns were chosen
    two_sided: bool = False  # whether the element of displacement and force can also pull
    shift: int = 0  # offset of the joint numbers from those in the file

    def __contains__(self, key: object) -> bool:
        return key in self.assigned

    def values(self, key: Key) -> FloatArray:
        """Return a quantity in SI units, shape (n,).

        Args:
            key: key of a quantity in `assigned`.

        Raises:
            InputError: a value is too large in SI units.
        """
        source, table = self.assigned[key], self.table
        values = source.factor * table.numbers(source.column) - source.zero
        if len(bad := invalid_rows(values)):
            raise InputError(
                f"{table.place(bad[0], source.column)} in {source.unit}: "
                f"{values[bad[0]]:.4g} {si_unit(source.dimension)} is "
                f"{describe_fault(float(values[bad[0]]), len(bad))}; correct the unit with --unit"
            )
        return values

    @cached_property
    def motions(self) -> FloatArray:
        """All displacements, positions and velocities in SI units, shape (k, n)."""
        motions = [self.values(key) for key in self.assigned if key[0] in _MOTIONS]
        return np.array(motions).reshape(len(motions), len(self.table))

    def name(self, key: Key) -> str:
        """Return the name of a quantity's column in the file.

        Args:
            key: key of a quantity in `assigned`.
        """
        return self.assigned[key].column

    @property
    def used(self) -> frozenset[str | None]:
        """Names of the columns with a quantity, a run or a phase."""
        return frozenset({source.column for source in self.assigned.values()} | {self.run, self.phase})

    @cached_property
    def unused(self) -> tuple[str, ...]:
        """Names of the numeric columns that are not used and not constant."""
        used = self.used
        return tuple(name for name in self.table.names if name not in used and self.table.varies(name))

    @cached_property
    def run_candidate(self) -> str:
        """Name of an unused column that could number the runs; empty if none could or a run column exists."""
        looked_at = () if self.run else self.unused
        return next((name for name in looked_at if in_blocks(self.table.numbers(name))), "")

    @property
    def clock_advice(self) -> str:
        """Advice for a table without a time, which names a counter that rises evenly, if there is one."""
        for name in self.unused:
            steps = np.diff(self.table.numbers(name))
            usual = float(np.median(steps))
            is_even = np.mean(np.abs(steps - usual) < _UNEVEN * usual) > _EVEN_SHARE
            if is_even and not COUNTERS.isdisjoint(words_of(name)):
                return (
                    f"if '{name}', which rises by {usual:.6g} per row, counts the time, add --column "
                    f"time={shlex.quote(name)} --unit time=UNIT, where UNIT is the duration of one count, "
                    "such as 0.001s"
                )
        return "if a column holds the time, add --column time=COLUMN"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the columns for the user."""
        notes = [*self.choice_notes, *(source.note for source in self.assigned.values() if source.note)]
        if self.run_candidate:
            looks = f"column '{self.run_candidate}' looks like a run number"
            notes.append(f"{looks}; if it is one, add --column run={shlex.quote(self.run_candidate)}")
        return tuple(notes)

    @property
    def roles(self) -> dict[str, str]:
        """Quantity and unit of each column in use, by the column's name."""
        roles = {
            source.column: f"{numbered(key)} in {source.unit.replace('_', '/')}"
            for key, source in self.assigned.items()
        }
        return roles | {name: what for name, what in ((self.run, RUN), (self.phase, PHASE)) if name}

    @cached_property
    def matched(self) -> str:
        """Short description of the assignment; empty if all columns have palpate's own names."""
        if all(_own_name(source.column) for source in self.assigned.values()):
            return ""
        words = [
            f"{numbered(key)} '{source.column}'"
            + ("" if unit_in_name(source.column) == source.unit else f" in {source.unit.replace('_', '/')}")
            for key, source in self.assigned.items()
        ]
        return ", ".join(words + [f"{RUN} '{self.run}'"] * bool(self.run))


def in_blocks(values: FloatArray) -> bool:
    """Return whether values are whole numbers that each occupy one block of rows, as run numbers do.

    Args:
        values: values of a column in the order of the rows, shape (n,).
    """
    if np.any(values != np.round(values)):
        return False
    blocks = 1 + np.count_nonzero(np.diff(values))
    return bool(blocks == len(np.unique(values)) and blocks * MIN_RUN_ROWS <= len(values))


def assign_columns(table: Table, options: ImportOptions) -> ColumnAssignment:
    """Assign columns to quantities: by options first, then by palpate's own names, then by common names.

    Args:
        table: table of the file.
        options: options for columns, units and rows.

    Raises:
        InputError: a column is missing or ambiguous, or a unit is unknown or does not fit.
    """
    shift = joint_shift(table, options.columns)
    chosen, notes = _assign_own_names(table, options, _assign_by_options(table, options))
    if any(quantity in EFFORTS for quantity, _ in chosen):  # a goal is used only if there is no effort
        chosen = {
            key: role
            for key, role in chosen.items()
            if role.quantity != "goal" or role.column in options.columns.values()
        }
    reserved = {*options.columns.values(), *options.context, *(role.column for role in chosen.values())}
    chosen |= choose_columns(ColumnUnits(table, options), chosen, reserved, shift)
    if TIME not in chosen and TIME[0] in options.units and not {TIME[0], _ROW_NUMBER} & set(table.names):
        with_number = table.columns.append_column(
            _ROW_NUMBER, pa.array(np.arange(len(table), dtype=np.float64))
        )
        table, chosen[TIME] = replace(table, columns=with_number), Role(_ROW_NUMBER, *TIME)
    for role in chosen.values():
        column = role.column
        repeated_name, cells = f"{column} (2)", table.columns
        is_chosen = column in options.columns.values() or repeated_name not in table.names
        if not is_chosen and not cells.column(column).equals(cells.column(repeated_name)):
            raise InputError(
                f"{table.path}: column '{column}' appears twice, with different values; choose with "
                f"--column {role.numbered}={shlex.quote(column)} or "
                f"{role.numbered}={shlex.quote(repeated_name)}, or rename one"
            )
    run = _run_column(table, options)
    efforts = [role.column for role in chosen.values() if role.quantity in EFFORTS]
    motions = [r.column for key, r in chosen.items() if key != TIME and r.column not in efforts]
    time = chosen[TIME].column if TIME in chosen else None
    table, rate_notes = _with_one_rate(table, time, efforts, motions, run)
    notes += rate_notes
    chosen, position_notes = _press_or_axis(ColumnUnits(table, options), chosen)
    original = table
    table, chosen, sensor_notes = _subtract_deflection(table, chosen, options)
    notes += [*sensor_notes, *_note_other_columns(original, chosen, options)]
    units = ColumnUnits(table, options)
    chosen = dict(sorted(chosen.items(), key=lambda item: table.names.index(item[1].column)))
    units.check_force_of_angle(chosen)
    units.check_known(chosen)
    assigned = {key: units.assign(role) for key, role in chosen.items()}
    units.check_used(chosen)
    assigned, two_sided, sign_notes = _orient_signs(units, assigned)
    phase = options.columns.get(PHASE, PHASE if PHASE in table.names else None)
    notes += [*_note_preamble(units, chosen, assigned), *position_notes, *sign_notes]
    return ColumnAssignment(table, assigned, run, phase, tuple(notes), two_sided, shift)


# Ratio of a displacement's mean to its range above which the stiffness depends on its zero.
_FAR_FROM_ZERO = 2.0
_ROW_NUMBER = "row number"  # column that stands for the time if there is none and its unit is given


def propose_columns(table: Table) -> dict[str, tuple[str, str]]:
    """Return quantity and unit of the columns that are read without options, by the column's name.

    Of columns that match equally well, the first is proposed. A quantity may number a joint; a unit is empty
    if the table does not state it. The result is empty if no columns form a channel.

    Args:
        table: table of the file.

    Raises:
        InputError: the names of columns contradict each other, or a required column has a cell that is not a
            number.
    """
    options = ImportOptions()
    units, shift = ColumnUnits(table, options), joint_shift(table, {})
    chosen, _ = _assign_own_names(table, options, {})
    chosen |= choose_columns(units, chosen, [role.column for role in chosen.values()], shift, ask=False)
    if not channel_pairs(chosen):
        return {}
    with suppress(InputError):  # whether a position belongs to a press or to an axis is left to the user
        chosen, _ = _press_or_axis(units, chosen)
    proposed = {role.column: (role.numbered, units.unit_of(role)) for role in chosen.values()}
    run = _run_column(table, options)
    return proposed | ({run: (RUN, "")} if run else {})


def _assign_by_options(table: Table, options: ImportOptions) -> Chosen:
    """Assign the columns that the user names."""
    chosen: Chosen = {}
    for name, column in options.columns.items():
        if column not in table.names:
            raise InputError(f"--column {name}={column}: {table.path} has only {table.listed_names}")
        if name not in (RUN, PHASE):
            role = role_of_option(name)
            if role is None:
                valid = ", ".join([*QUANTITIES, RUN, PHASE])
                raise InputError(
                    f"--column: '{name}' is not a quantity, or its unit is unknown. Quantities: {valid}, "
                    "also with a unit, such as force_N"
                )
            chosen[role.key] = replace(role, column=column)
    return chosen


def _run_column(table: Table, options: ImportOptions) -> str | None:
    """Return the column of runs: as named, or one such as `trial` whose values form blocks of rows."""
    if RUN in options.columns or RUN in table.names:
        return options.columns.get(RUN, RUN)
    names = (guess.column for guess in table.guesses if guess.quantity == RUN)
    for name in names:
        texts, index = table.labels(name)
        is_numeric = table.numeric_share(name) == 1.0
        values = table.numbers(name) if is_numeric else index.astype(np.float64)
        if in_blocks(values) and (is_numeric or len(texts) > 1):
            return name
    return None


def _assign_own_names(table: Table, options: ImportOptions, chosen: Chosen) -> tuple[Chosen, list[str]]:
    """Add columns whose names state quantity and unit, such as force_N, and note duplicates."""
    notes = []
    for name in table.names:
        role = parse_role(name)
        if role and role.unit and name not in options.columns.values():
            earlier_role = chosen.setdefault(role.key, role)
            earlier = earlier_role.column
            if earlier == name or earlier in options.columns.values():
                continue
            if not have_equal_values(table, role.key, (earlier, earlier_role.unit), (name, role.unit)):
                raise InputError(
                    f"{table.path}: columns '{earlier}' and '{name}' both hold {role.numbered}, with "
                    f"different values; choose with --column {role.numbered}={shlex.quote(earlier)}"
                )
            notes.append(f"'{earlier}' and '{name}' hold the same {role.numbered}: '{earlier}' is read")
    return chosen, notes


def _press_or_axis(units: ColumnUnits, chosen: Chosen) -> tuple[Chosen, list[str]]:
    """Read a position as a displacement if it belongs to a press, not to a linear axis, with a note."""
    if DISPLACEMENT in chosen or not {POSITION, FORCE} <= set(chosen) or ("torque", NO_JOINT) in chosen:
        return chosen, []
    table, role, column = units.table, chosen[POSITION], chosen[POSITION].column
    unit, is_named = units.unit_of(role), column in units.options.columns.values()
    if is_named or dimension_of(scaled_unit(unit, "")[1]) != "length":
        return chosen, []
    quoted, force = shlex.quote(column), chosen[FORCE].column
    as_axis = [
        f"'{column}' is read as the position of a linear axis; if it is the displacement of a press, add "
        f"--column displacement={quoted}"
    ]
    pressed = is_pressed(table.numbers(column), table.numbers(force))
    if _own_name(column):  # as in files that palpate writes
        return chosen, as_axis if pressed else []
    if pressed:
        others = {key: other for key, other in chosen.items() if key != POSITION}
        return others | {DISPLACEMENT: Role(column, *DISPLACEMENT, role.unit or unit)}, [
            f"'{column}' and '{force}' change together, as in a press; if '{column}' is the position of a "
            f"linear axis, add --column position={quoted}"
        ]
    if not role.unit:
        raise InputError(
            f"{table.path}: '{column}' and '{force}' may belong to a press or to a linear axis; choose with "
            f"--column displacement={quoted} or --column position={quoted}"
        )
    return chosen, as_axis


def _subtract_deflection(
    table: Table, chosen: Chosen, options: ImportOptions
) -> tuple[Table, Chosen, list[str]]:
    """Note a displacement that is proportional to the force, and replace it if it is a deflection.

    The deflection of a force sensor, such as the cantilever of an atomic force microscope, is proportional
    to the force. The indentation is the displacement of the sensor's other end minus this deflection.
    """
    if not {DISPLACEMENT, FORCE} <= set(chosen):
        return table, chosen, []
    column, force = chosen[DISPLACEMENT].column, chosen[FORCE].column
    way, effort = table.numbers(column), table.numbers(force)
    if abs(correlation_coefficient(way, effort)) < 1.0 - _MAX_ROUNDING:
        return table, chosen, []
    line = np.polyfit(way, effort, 1)
    steps = [float(np.diff(np.unique(values)).min()) for values in (way, effort)]
    rounding = max(abs(line[0]) * steps[0] + steps[1], _MIN_ROUNDING * np.ptp(effort))
    if rounding > _MAX_ROUNDING * np.ptp(effort) or np.abs(effort - np.polyval(line, way)).max() > rounding:
        return table, chosen, []
    fact, is_named = f"'{column}' is proportional to '{force}'", column in options.columns.values()
    guesses = [g for g in table.guesses if g.key == DISPLACEMENT and g.column != column]
    bases = [g.column for g in guesses if dimension_of(g.unit) == "length" and table.varies(g.column)]
    unit = unit_in_name(column)
    if is_named or len(bases) != 1 or dimension_of(unit) != "length" or "deflection" not in column.lower():
        note = (
            f"{fact} except for rounding: either one was computed from the other, or '{column}' is the "
            "deflection of the force sensor. If another column holds the displacement, add --column "
            "displacement=COLUMN"
        )
        return table, chosen, [note]
    stem, base_unit = split_unit(bases[0])
    base, scale = table.numbers(bases[0]), si_factor(unit) / si_factor(base_unit)
    scale *= np.sign(correlation_coefficient(base, way))
    name = f"{stem.strip()} minus {split_unit(column)[0].strip()} [{base_unit}]"
    note = (
        f"{fact}, like the deflection of a force sensor or cantilever, so the displacement is '{bases[0]}' "
        f"minus '{column}'; to read '{column}' alone, add --column displacement={shlex.quote(column)}"
    )
    table = replace(table, columns=table.columns.append_column(name, pa.array(base - scale * way)))
    return table, chosen | {DISPLACEMENT: Role(name, *DISPLACEMENT, base_unit)}, [note]


def _note_preamble(units: ColumnUnits, chosen: Chosen, assigned: dict[Key, AssignedColumn]) -> Iterator[str]:
    """Yield a note for each quantity to which a line above the header gives another unit than its column."""
    for key, role in chosen.items():
        source = assigned.get(key)
        if source is None or units.option_names(role):
            continue
        above = ((line, u) for line, u in units.units_above(key[0]) if dimension_of(u) == source.dimension)
        line, unit = next(above, ("", ""))
        if unit and si_factor(unit) != abs(source.factor):
            yield (
                f"the line '{line:.60}' above the header contradicts column '{role.column}', which is "
                f"read in {source.unit}; if {unit} is right, add --unit {role.numbered}={unit}"
            )


def _note_other_columns(table: Table, chosen: Chosen, options: ImportOptions) -> Iterator[str]:
    """Yield a note for each effort or displacement that other columns of its dimension may hold, too."""
    used = {role.column for role in chosen.values()} | {*options.context}
    guesses = [guess for guess in table.guesses if guess.column not in used]
    for key, role in chosen.items():
        column = role.column
        dimension = dimension_of(unit_in_name(column))
        alike = (g.column for g in guesses if g.key == key and dimension_of(g.unit) == dimension)
        others = [f"'{name}'" for name in alike if table.varies(name)]
        is_checked = key[0] in (*EFFORTS, DISPLACEMENT[0]) and column not in options.columns.values()
        if is_checked and column in table.names and dimension and others:
            yield (
                f"'{column}' is read as the {key[0]}, not {list_first(others)}; if another column holds the "
                f"{key[0]}, add --column {role.numbered}=COLUMN"
            )


# Whether an element is held at both ends, by the word for its displacement in --column.
_HELD = {"depth": False, "elongation": True}


def _orient_signs(
    units: ColumnUnits, assigned: dict[Key, AssignedColumn]
) -> tuple[dict[Key, AssignedColumn], bool, list[str]]:
    """Make displacement and force positive in compression, with notes, and detect elements that can pull.

    A unit with a number, such as 1N, prevents a change of sign. A displacement named by --column belongs to a
    contact; if it is named as a depth, to one with a surface, and if as an elongation, to one without.
    """
    if DISPLACEMENT not in assigned or FORCE not in assigned:
        return assigned, False, []
    depth, force = assigned[DISPLACEMENT], assigned[FORCE]
    named = (name for name, column in units.options.columns.items() if column == depth.column)
    held = _HELD.get(next(named, "").partition("_")[0].lower())
    recorded, force_n = (side.factor * units.table.numbers(side.column) for side in (depth, force))
    sides = press_sides(recorded, force_n, held=held)
    scaled = {key for key in (DISPLACEMENT, FORCE) if assigned[key].is_fixed}
    factors = {DISPLACEMENT: sides.displacement, FORCE: sides.force}
    flipped = {key: assigned[key].column for key in factors if factors[key] < 0.0 and key not in scaled}
    is_named_so = not _ABSOLUTE.isdisjoint(words_of(force.column))
    is_magnitude = is_named_so and units.table.numbers(force.column).min() >= 0.0
    keeps_sign = is_magnitude and flipped.pop(FORCE, None) is not None
    result = assigned | {key: replace(assigned[key], factor=-assigned[key].factor) for key in flipped}
    notes = []
    if keeps_sign:
        notes.append(
            f"'{force.column}' falls where '{depth.column}' rises, but keeps its sign, because the name says "
            "that the column holds absolute values; if another column holds the signed force, add --column "
            "force=COLUMN"
        )
    if flipped:
        keep = " ".join(f"--unit {key[0]}={assigned[key].fixed_unit}" for key in flipped)
        are, signs = ("are", "their signs are") if len(flipped) > 1 else ("is", "its sign is")
        reason = f"{' and '.join(map(repr, flipped.values()))} {are} negative in compression"
        if sides.never_free:  # an element in tension, which is never compressed
            reason = f"'{force.column}' and '{depth.column}' increase in opposite directions"
            signs = f"the sign of '{force.column}' is"
        notes.append(f"{reason}, so {signs} reversed; to prevent this, add {keep}")
    if sides.zero_m and not scaled:
        at = "changes its sign" if sides.two_sided else "begins"
        result[DISPLACEMENT] = replace(result[DISPLACEMENT], zero=sides.zero_m)
        notes.append(
            f"the zero of '{depth.column}' is set to {sides.zero_m / result[DISPLACEMENT].factor:.6g} "
            f"{depth.unit}, where the force {at}; to keep the recorded zero, add --unit "
            f"displacement={depth.fixed_unit}; to fit the zero, run `palpate add FILE contact_offset`"
        )
    is_named = depth.column in units.options.columns.values()
    if not sides.two_sided or (is_named and not sides.never_free):
        return result, False, ["; ".join(notes)] if notes else []
    names, quoted = f"'{depth.column}' and '{force.column}' take both signs", shlex.quote(depth.column)
    contact = f"to read them as a contact, add --column displacement={quoted}"
    pulls = sides.elastic or is_named or POSITION in assigned
    if not pulls:
        notes.append(
            f"{names}, but at different times, as with a damper, so they are read as a linear axis; {contact}"
        )
        result = {POSITION if key == DISPLACEMENT else key: source for key, source in result.items()}
    elif sides.never_free:
        if held is None:
            notes.append(
                f"'{force.column}' varies at every displacement. The data therefore contain no free air, and "
                "are read as an element held at both ends, without a surface; if there is a surface, add "
                f"--column depth={quoted}"
            )
        mean_m, range_m = float(np.mean(recorded)) - result[DISPLACEMENT].zero, np.ptp(recorded)
        if abs(mean_m) > _FAR_FROM_ZERO * range_m:
            notes.append(
                f"the displacement varies by only {1e3 * range_m:.2g} mm around {1e3 * mean_m:.2g} mm, so "
                "the stiffness depends on where the displacement is zero; subtract the displacement of the "
                "unloaded element"
            )
    else:
        notes.append(
            f"{names} at the same times, so they are read as an element without a surface, which pulls and "
            f"pushes; {contact}; to read them as a linear axis, add --column position={quoted}"
        )
    return result, pulls, ["; ".join(notes)] if notes else []


def _own_name(column: str) -> bool:
    role = parse_role(column)
    return role is not None and bool(role.unit)


_MIN_ROUNDING, _MAX_ROUNDING = 1e-9, 1e-3  # relative to the range of the force
_SYSTEMATIC = 0.1  # least share of empty cells of a slower sensor; fewer are faults of the file
_SLOW = 2.0  # ratio to the slowest rate up to which an effort counts as slow
_SHARED = 0.5  # least share of the slowest column's values that must be in complete rows


def _with_one_rate(
    table: Table, time: str | None, efforts: Sequence[str], motions: Sequence[str], run: str | None
) -> tuple[Table, list[str]]:
    """Select or interpolate rows so that all columns in use have a value in each row; return a note on it.

    If each sensor wrote its own rows, hardly any row is complete. The other columns are then interpolated at
    the times of an effort, because interpolation would change its noise, or at those of the slowest column.
    Without a time, only complete rows are selected.
    """
    names = (*efforts, *motions)
    filled_by_name = {name: table.filled_rows(name) for name in (*([time] if time else ()), *names)}
    share = {name: float(np.mean(mask)) for name, mask in filled_by_name.items()}
    sparse = {name: share[name] for name in names if share[name] < 1.0 - _SYSTEMATIC}
    if time is None or not sparse:
        filled = np.logical_and.reduce(list(filled_by_name.values()))
        if filled.all() or not filled.any() or (time and share[time] < 1.0 - _SYSTEMATIC):
            return table, []
        lacking = ", ".join(f"'{name}'" for name, mask in filled_by_name.items() if not mask.all())
        return table.select(filled), [table.note_left_out(np.flatnonzero(~filled), f"no value in {lacking}")]
    slowest = min(sparse, key=lambda name: sparse[name])
    complete = np.logical_and.reduce([filled_by_name[name] for name in sparse])
    note = f"'{slowest}' has a value in {100.0 * sparse[slowest]:.2g} % of the rows"
    if np.sum(complete) >= max(_SHARED * np.sum(filled_by_name[slowest]), 1.0):
        return table.select(complete), [f"{note}, so only complete rows are used"]
    if not filled_by_name[slowest].any():
        raise InputError(
            f"{table.path}: column '{slowest}' is empty; name another column with --column, or, if the cells "
            "hold formulas, save the file with the results"
        )
    if run is not None or (np.diff(times := table.numbers(time)) < 0.0).any():
        listed = ", ".join(map(repr, names))
        raise InputError(
            f"{table.path}: too few rows have values in all of {listed}; save each run in its own file, with "
            "its rows in order of time, so that the missing values can be interpolated"
        )
    base = next((name for name in efforts if sparse.get(name, 1.0) <= _SLOW * sparse[slowest]), slowest)
    columns, inside = table.columns, filled_by_name[base].copy()
    for name in names:
        sampled = np.flatnonzero(filled_by_name[name])
        inside[: sampled[0]] = inside[sampled[-1] + 1 :] = False
        if name != base:
            values = np.interp(times, times[sampled], table.select(filled_by_name[name]).numbers(name))
            columns = columns.set_column(columns.column_names.index(name), name, pa.array(values))
    way = f"all other columns are interpolated at the times of '{base}'"
    return replace(table, columns=columns).select(inside), [f"{note}, so {way}"]
