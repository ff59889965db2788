"""Determine the units of columns from options, names and numbers."""

import math
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.data.column_names import (
    DISPLACEMENT,
    FORCE,
    POSITION,
    PROXIES,
    QUANTITIES,
    SENSITIVITY,
    Key,
    Role,
    guess_column,
    holds_counts,
    is_angle,
    quantity_in,
    role_of_option,
    si_unit,
    split_unit,
    unit_in_name,
    unknown_unit,
    words_of,
)
from palpate.estimation.data.file_columns import list_first
from palpate.estimation.data.import_options import ImportOptions
from palpate.estimation.data.quantity_words import CURRENT
from palpate.estimation.data.table import Table
from palpate.estimation.data.units import (
    SI,
    dimension_of,
    is_scaled,
    likely_time_unit,
    normalize_unit,
    read_as,
    scaled_unit,
    si_factor,
)
from palpate.robot_io.errors import InputError

Chosen = dict[Key, Role]  # column in use for each quantity

_MAX_RANGE = {  # largest plausible range in SI, and the likely unit of a larger range
    "displacement": (0.2, "mm"),
    "position": (4.0 * np.pi, "deg"),
    "goal": (4.0 * np.pi, "deg"),
}
_WITHOUT_UNIT = "-"  # text in brackets that states a ratio, as in "Strain (-)"
_MAX_STRAIN = 2.0  # largest range of a strain without a unit that is read as a ratio
_LARGE_UNITS = tuple(unit for _, unit in _MAX_RANGE.values())
_MAX_CURRENT_A = 200.0  # largest plausible range of a current in A; a larger one is in mA
_COUNT_OF_ENCODER = "0.00153rad"  # one of 4096 counts per turn, an example
_FACTOR_OF_VOLT = "FACTOR"  # placeholder in advice
_COUNTED = frozenset(["tick", "counter"])  # in the names of columns whose unit the step does not tell
_LETTERS = {("force", "t"): "tf", ("time", "d"): "day"}  # units that are known only beside their quantity


_FACTOR = re.compile(  # as in "Load x1000 (N)" and "Force*10^3"
    r"(?:(?<=[\W_])x|[×*]) ?1(?:0{2,6}|0? ?(?:\^|\*\*) ?[+-]?\d+|e[+-]?\d+)(?![^\W_])", re.IGNORECASE
)


_PREPOSITION = "in"  # "Weg in [mm]" is not in inches


@dataclass(frozen=True)
class AssignedColumn:
    """Column of one quantity."""

    column: str  # name of the column in the file
    dimension: str  # dimension of the quantity, such as "length"
    unit: str  # unit of the numbers
    factor: float  # factor from this unit to SI
    note: str = ""  # note for the user, or empty
    zero: float = 0.0  # zero of the quantity, in SI; subtracted from the numbers
    is_fixed: bool = False  # whether --unit has a number before the unit, which also fixes the sign

    @property
    def fixed_unit(self) -> str:
        """Unit with a number, which keeps the sign in --unit."""
        return self.unit if is_scaled(self.unit) else f"1{self.unit}"


@dataclass(frozen=True)
class ColumnUnits:
    """Units of a table's columns.

    In all methods `role` is the role of a column, and `chosen` are the columns in use.
    """

    table: Table
    options: ImportOptions

    def option_names(self, role: Role) -> list[str]:
        """Return the names in --unit that refer to a column: its name, quantity, or quantity and joint.

        A column such as `pos` may be called a position or a displacement if there is no other displacement.
        The name of another column refers only to that column, unless --column gives it another meaning.
        """
        if not self.options.units:  # the usual case, and a table may have thousands of columns
            return []
        columns = self.options.columns
        exact = {name for name in self.table.names if name not in columns or name in columns.values()}
        parsed = {name: role_of_option(name) for name in self.options.units if name not in exact}
        is_either = role.key in {DISPLACEMENT, POSITION} and guess_column(role.column).quantity == "position"
        if role.key == POSITION:
            is_either &= not any(guess_column(name).key == DISPLACEMENT for name in self.table.names)
        keys = {DISPLACEMENT, POSITION} if is_either else {role.key}
        role_names = {name for name, named in parsed.items() if named is not None and named.key in keys}
        if role.quantity in parsed:
            role_names.add(role.quantity)
        return [name for name in self.options.units if name == role.column or name in role_names]

    def unit_of(self, role: Role) -> str:
        """Return the unit from --unit, the column's name or the role, in this order; empty if unknown."""
        column = role.column
        guess = guess_column(column)  # knows names whose unit is specified, such as "rpm" and "millis"
        specified = guess.unit if guess.quantity == role.quantity else ""
        # A strain whose range is too large for most materials may be in percent.
        is_unclear = role.unit == "strain" and unknown_unit(column) != _WITHOUT_UNIT
        is_unclear = is_unclear and self.table.varies(column)
        usual = "" if is_unclear and np.ptp(self.table.numbers(column)) > _MAX_STRAIN else role.unit
        stated = (self._named_unit(role), usual, specified)
        fitting = (unit for unit in stated if dimension_of(unit) in QUANTITIES[role.quantity])
        return self._user_unit(role) or next(fitting, "")

    def assign(self, role: Role) -> AssignedColumn:
        """Determine the unit of a column and its factor to SI.

        Raises:
            InputError: the unit does not fit the quantity, or the column contains clock times.
        """
        column, dimensions = role.column, QUANTITIES[role.quantity]
        place = f"{self.table.path}: column '{column}'"
        if role.quantity != "time" and column in self.table.clocks:
            raise InputError(
                f"{place} holds clock times instead of {role.quantity}; name another column with --column"
            )
        user_unit, named_unit, unit = self._user_unit(role), self._named_unit(role), self.unit_of(role)
        note = ""
        if not unit and role.quantity == "time":
            if unknown := unknown_unit(column) or next(iter(_COUNTED & {*words_of(column)}), ""):
                raise InputError(
                    f"{place}: '{unknown}' is not a known unit of time; give it as a multiple of s, ms, us, "
                    "min, h or day, as in --unit time=0.01s"
                )
            unit = self._likely_unit(role)
            note = (
                f"column '{column}' states no unit and is read in {unit}, as its sample step suggests; if "
                f"that is wrong, add --unit time={'ms' if unit == 's' else 's'}"
            )
        # The unit of the numbers, also beside a sensitivity, as in "Load [mV] (5 N/V)".
        own = unit_in_name(SENSITIVITY.sub("", column)) if named_unit.startswith("×") else named_unit
        stated, (scale, unit) = unit.lstrip("×"), scaled_unit(unit, own)
        dimension = dimension_of(unit)
        if dimension not in dimensions:
            valid = ", ".join(unit for name in dimensions for unit in SI[name])
            problem = f"'{unit}' is not a unit of {role.quantity}"
            if dimension in PROXIES:
                constant = f"0.1{si_unit(dimensions[0])}/{unit}"
                stands = f"1 {unit} stands for 0.1 {si_unit(dimensions[0])}"
                problem += f"; if {stands}, add --unit {role.numbered}={constant}"
            raise InputError(f"{place}: {problem}. Valid: {valid}")
        if not 0.0 < abs(scale) < math.inf:
            raise InputError(f"{place}: unit '{user_unit}' cannot be converted")
        if dimension in PROXIES:
            effort, constant, example = PROXIES[dimension]
            note = (
                f"column '{column}' is a {dimension} used as the {role.quantity}, so "
                f"results are in {si_unit(dimension)}, not {effort}; for {effort}, give the {constant}, "
                f"as in --unit {role.numbered}={example}"
            )
        elif not user_unit:
            is_capital = " ".join(self.table.names).isupper()
            note = _note_on_name(role, named_unit, unit, is_capital=is_capital) or note
        elif abs(scale) == 1.0 and not _fits_name(column, named_unit, unit):
            note = f"column '{column}' is read as {role.quantity} in {unit}, whatever its name says"
        factor = scale * SI[dimension][unit]
        unit = stated if scale != 1.0 else unit
        is_fixed = any(is_scaled(self.options.units[name]) for name in self.option_names(role))
        return AssignedColumn(column, dimension, unit, factor, note, is_fixed=is_fixed)

    def missing(self, chosen: Chosen) -> list[tuple[str, str]]:
        """Return the columns of unknown unit, each with the option that states the likely unit."""
        missing = []
        for role in chosen.values():
            if role.quantity != "time" and not self.unit_of(role):
                linear = ("force", role.joint) in chosen and ("torque", role.joint) not in chosen
                # A servo counts its goal as it does its position.
                alike = chosen.get(("position", role.joint), role) if role.quantity == "goal" else role
                unit = self.unit_of(alike) or self._likely_unit(alike, linear=linear)
                unknown = _unknown_unit(role.column)
                in_capitals = dimension_of(normalize_unit(unknown.lower())) in QUANTITIES[role.quantity]
                size = "10" if unknown and not in_capitals and not self._has_counts(role) else ""
                if dimension_of(unknown) == "voltage":  # no number, which would be used as it is
                    size, unit = _FACTOR_OF_VOLT, f"{scaled_unit(unit, '')[1]}/V"
                missing.append((role.column, f"--unit {role.quantity}={size}{unit}"))
        return missing

    def check_known(self, chosen: Chosen) -> None:
        """Check that all units are known.

        Raises:
            InputError: a unit is unknown; the message suggests likely units.
        """
        if missing := self.missing(chosen):
            columns = list_first([f"'{column}'" for column, _ in missing])
            unknown = next(filter(None, (_unknown_unit(column) for column, _ in missing)), "")
            known = f" ('{unknown}' is not a known unit)" if unknown else ""
            by_quantity = {option.partition("=")[0]: option for _, option in missing}
            by_quantity |= {o.partition("=")[0]: o for _, o in missing if o.endswith(_LARGE_UNITS)}
            options = " ".join(by_quantity.values())
            if _FACTOR_OF_VOLT in options:
                known = f" of a motion or effort ('{unknown}' is a voltage)"
            options = explain_numbers(options)
            if len(missing) == 1:
                problem = f"column {columns} states no unit{known}; give it, as in {options}"
            else:
                problem = f"columns {columns} state no units{known}; give them, as in {options}"
            keys = POSITION, FORCE
            if set(keys) <= set(chosen) and not any(self.unit_of(chosen[key]) for key in keys):
                position, force = (shlex.quote(chosen[key].column) for key in keys)
                unit = self._likely_unit(chosen[POSITION])
                torque = self._likely_unit(replace(chosen[FORCE], quantity="torque", unit=""))
                problem += (
                    f"; if they belong to a revolute joint, add --column position={position} --column "
                    f"torque={force} --unit position={unit} --unit torque={torque}"
                )
            raise InputError(f"{self.table.path}: {problem}")

    def check_force_of_angle(self, chosen: Chosen) -> None:
        """Check that no joint has an angle and a force if there is no other channel.

        Raises:
            InputError: the lever arm is needed to convert a force to a torque.
        """
        if DISPLACEMENT in chosen or any(quantity in {"torque", "goal"} for quantity, _ in chosen):
            return
        for (quantity, joint), role in chosen.items():
            if quantity != "position" or ("force", joint) not in chosen:
                continue
            force = chosen["force", joint].column
            scale, unit = scaled_unit(self.unit_of(chosen["force", joint]), "")
            if dimension_of(scaled_unit(self.unit_of(role), "")[1]) == "angle" and (
                unit in SI["force"] or not unit
            ):
                torque = replace(role, quantity="torque").numbered
                length = ""
                if not unit and role.column.lower().endswith("_rad"):  # which may stand for "radial"
                    as_length = f"--column displacement={shlex.quote(role.column)} --unit displacement=mm"
                    length = f"; if '{role.column}' is a length, add {as_length}"
                what = f"'{force}' a force, not a torque; if the force acts on a lever arm of 0.1 m"
                if not unit:
                    what = f"'{force}' states no unit of torque; if a value of 1 is a torque of 0.1 N m"
                raise InputError(
                    f"{self.table.path}: column '{role.column}' is an angle and {what}, use --column "
                    f"{torque}={shlex.quote(force)} --unit "
                    f"{torque}={0.1 * scale * SI['force'].get(unit, 1.0):g}Nm{length}"
                )

    def check_used(self, chosen: Chosen) -> None:
        """Check that each --unit applies to a column in use, since others would be ignored silently.

        Raises:
            InputError: a --unit applies to no column in use.
        """
        used = {name for role in chosen.values() for name in self.option_names(role)}
        for name in self.options.units:
            if name not in used:
                in_use = ", ".join(role.column for role in chosen.values()) or "none"
                raise InputError(
                    f"{self.table.path}: --unit {name}={self.options.units[name]}: no quantity or "
                    f"column in use has this name. In use: {in_use}"
                )

    def _user_unit(self, role: Role) -> str:
        unit = next((self.options.units[name] for name in self.option_names(role)), "")
        return _LETTERS.get((role.quantity, unit), normalize_unit(unit))

    def _named_unit(self, role: Role) -> str:
        """Return the unit in a column's name, or seconds if the column has clock times."""
        if role.column in self.table.clocks:
            return "s"
        unit = unit_in_name(role.column) or _LETTERS.get((role.quantity, unknown_unit(role.column)), "")
        return read_as(unit, QUANTITIES[role.quantity])

    def units_above(self, quantity: str) -> Iterator[tuple[str, str]]:
        """Yield the lines above the header that state a unit of a quantity, each with this unit.

        Args:
            quantity: quantity of a column; the lines may call a position a displacement, and vice versa.
        """
        motions = {"displacement", "position"}
        for line in self.table.preamble:
            named = ""
            if re.search(r"(?<!\w)\d", line):  # a setting, such as "Force limit: 5 kN"
                continue
            for part in re.split(r"[,;|\t]", line):
                named = quantity_in(part) or named
                words = [word for word in re.findall(r"[^\s:=()\[\]{}<>]+", part) if word != "in"]
                if quantity in (motions if named in motions else {named}):
                    units = (read_as(normalize_unit(word), QUANTITIES[quantity]) for word in words)
                    yield from ((line, unit) for unit in units if dimension_of(unit) in QUANTITIES[quantity])

    def _likely_unit(self, role: Role, *, linear: bool = False) -> str:
        """Return the SI unit (`linear`: of a linear axis), or the laboratory's if numbers are too large."""
        column, filled = role.column, self.table.select(self.table.filled_rows(role.column))
        values = filled.numbers(column) if filled.varies(column) else np.zeros(1)
        span = float(np.ptp(values))
        if role.quantity == "time":
            step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
            return likely_time_unit(step, span if step > 0.0 else np.inf)
        is_length = linear and role.quantity == "position" and (not is_angle(column) or holds_counts(column))
        if "strain" in words_of(column):
            return "%" if span > _MAX_STRAIN else "strain"
        if above := next(self.units_above(role.quantity), None):
            return above[1]
        quantity = "displacement" if is_length else role.quantity
        largest, usual = _MAX_RANGE.get(quantity, (np.inf, ""))
        if quantity == "torque" and not CURRENT.isdisjoint(words_of(column)):
            usual = "A" if span < _MAX_CURRENT_A else "mA"
            return "0.001A" if self._has_counts(role) else usual
        turns = quantity in {"velocity", "acceleration"} and not linear
        si = "MPa" if "stress" in column.lower() else si_unit(QUANTITIES[quantity][int(turns)])
        if self._has_counts(role):
            factor = re.sub(r"\D", "", (_FACTOR.search(column) or [""])[0])  # as in "Load * 100"
            count = f"{1.0 / float(factor or 1000):g}{usual or si}"
            return _COUNT_OF_ENCODER if usual == "deg" and not factor else count
        return usual if span > largest else si

    def _has_counts(self, role: Role) -> bool:
        """Return whether a column without a unit holds counts, by its name or since all numbers are whole."""
        column = role.column
        if holds_counts(column):
            return True
        table = self.table.select(self.table.filled_rows(column))
        is_unknown = not _unknown_unit(column) and not any(self.units_above(role.quantity))
        is_whole = is_unknown and table.varies(column) and not np.any(table.numbers(column) % 1.0)
        return is_whole and role.unit != "strain"


def explain_numbers(options: str) -> str:
    """Append to options an explanation of the numbers in their units.

    Args:
        options: options as `ColumnUnits.missing` returns them.
    """
    options += ", the value of one count" * ("=0.0" in options)
    options += f", with the value of one volt as {_FACTOR_OF_VOLT}" * (_FACTOR_OF_VOLT in options)
    return options + ", with the size of the unknown unit in place of 10" * ("=10" in options)


def _unknown_unit(column: str) -> str:
    """Return the text in a column's name that states no known unit of its quantity; empty for none."""
    return unknown_unit(column) or unit_in_name(column)


def _note_on_name(role: Role, named_unit: str, unit: str, *, is_capital: bool) -> str:
    """Return a note if a column name has a factor, two units, or another unit than `unit`; else empty."""
    column = role.column
    if named_unit.startswith("×"):
        return (
            f"the factor in the name of column '{column}' is applied, so the column is read in "
            f"{named_unit[1:]}; if that is wrong, give its unit, such as --unit {role.numbered}={unit}"
        )
    if is_capital and unit.startswith("MN"):
        return (
            f"no column name has a lower-case letter, so the M in '{column}' may be mega or milli; the "
            f"column is read in {unit}; if that is wrong, add --unit {role.numbered}=m{unit[1:]}"
        )
    if factor := _FACTOR.search(column):
        return (
            f"the factor '{factor[0].strip()}' in the name of column '{column}' is ignored, and the column "
            f"is read in {unit}; if that is wrong, give its unit, such as --unit {role.numbered}=1000{unit}"
        )
    other = unit_in_name(split_unit(column)[0])  # "force_N [kN]", where a row of units contradicts
    factors = {} if other == _PREPOSITION else SI.get(dimension_of(other) or "", {})
    if factors.get(named_unit, factors.get(other)) != factors.get(other):
        return (
            f"column '{column}' may state two units and is read in {named_unit}; if {other} is right, "
            f"add --unit {role.numbered}={other}"
        )
    if dimension_of(named_unit) not in {None, dimension_of(unit)}:
        return f"column '{column}' is read as {role.quantity} in {unit}, whatever its name says"
    return ""


def _fits_name(column: str, named_unit: str, unit: str) -> bool:
    """Return whether the name of a column states no unit, or one of the dimension and size of `unit`."""
    if named_unit:
        return (dimension_of(named_unit), si_factor(named_unit)) == (dimension_of(unit), si_factor(unit))
    unknown = unknown_unit(column)
    return unknown in {"", _WITHOUT_UNIT} or normalize_unit(unknown.lower()) == unit
