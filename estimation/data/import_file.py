"""Create channels from data files of other programs."""

import os
import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import is_

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.assign_columns import ColumnAssignment, assign_columns, in_blocks
from palpate.estimation.data.channel_sources import ChannelSource, channel_sources, check_options_are_used
from palpate.estimation.data.column_names import (
    PROXIES,
    TIME,
    Key,
    numbered,
    quantity_in,
    si_unit,
    unit_in_name,
    words_of,
)
from palpate.estimation.data.contact import STEP_COLUMN, SURFACE_COLUMN, with_surface
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data.even_clock import note_uneven
from palpate.estimation.data.file_columns import list_first
from palpate.estimation.data.import_options import NO_OPTIONS, ImportOptions
from palpate.estimation.data.import_rows import UNKNOWN_PHASE, ImportedRows, arrange_rows
from palpate.estimation.data.measured_derivatives import is_difference, mistaken_scale, unwrap_angle
from palpate.estimation.data.presses import press_phases
from palpate.estimation.data.table import Table, read_table
from palpate.estimation.data.units import (
    MAX_STEP_S,
    MIN_STEP_S,
    SI,
    dimension_of,
    other_time_unit,
    scaled_unit,
    si_factor,
)
from palpate.estimation.signals.arm_signals import ARM_MOTION, PAYLOAD, REGRESSOR, TORQUE
from palpate.estimation.signals.blocks import blocks, number_pieces
from palpate.estimation.signals.motion import never_returns
from palpate.estimation.signals.runwise import sample_time, shift
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray

_MAX_SIGNAL_LENGTH = 50  # characters; a session allows 64 including a prefix
# A column with the name of a derived signal would be mistaken for the signal that a model needs.
_RESERVED_SIGNALS = frozenset({*ARM_MOTION, "load", TORQUE, REGRESSOR, PAYLOAD})
_SPECIMEN = re.compile(
    r"specimen|sample|probek?(?!\w)|prüfling|éprouvette|échantillon|probeta|试样|試料|motor|actuator|servo",
    re.IGNORECASE,
)
_MIN_SPECIMENS = 2
_CLOCK_UNITS = (1.0, 1e-3, 1e-6, 1e-9)  # units that a time without a unit may have [s]
_SAME_SPAN = 1.05  # largest ratio of the durations of two clocks that agree
_SPECIMENS_NOTE = (
    "{1} {0} objects, but all runs are read as runs of one object. To read only one object, add --where {2}; "
    "to read all, and state that no run affects another, add --fresh-runs"
)
_SAME_RATIO = 0.05  # largest relative deviation of a wrong unit from a known one
_MOTOR_WORDS, _JOINT_WORDS = frozenset(["motor", "rotor"]), frozenset(["joint", "output", "link"])
_JOINT_KINDS = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
# Variance that a positive inertia or stiffness explains, relative to a negative damping's.
_CONTRADICTING = 0.1
# Delays of an effort that are tried in place of a reversed sign, and the largest error with such a delay,
# relative to the error without one.
_LONGEST_DELAY_S, _DELAYS, _MUCH_BETTER = 0.3, 12, 0.5
_CERTAIN_SIGN = 0.5  # absolute correlation of effort and velocity above which the effort's sign is certain


@dataclass(frozen=True)
class ImportedData:
    """Channels of a data file."""

    channels: tuple[ChannelData, ...]  # "contact", and "joint_1" ...
    run_labels: dict[int, str]  # name of each run in the file, by its number
    notes: tuple[str, ...]  # notes for the user
    unused: tuple[str, ...]  # numeric columns that could be kept as context
    # Short description of the column assignment; empty if all columns have palpate's own names.
    read: str = ""
    # Quantity and unit of each column in use, by the column's name.
    roles: Mapping[str, str] = field(default_factory=dict)
    # Columns of position and effort by joint channel, for names other than palpate's own.
    columns: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    # Whether positions and efforts keep the signs of their columns, and efforts are no reactions.
    signs: tuple[bool, ...] = ()

    def title(self, channel: str) -> str:
        """Return a channel's name, followed by its columns if they are known."""
        columns = " and ".join(f"'{column}'" for column in self.columns.get(channel, ()))
        return f"{channel} of {columns}" if columns else channel


def import_file(path: str | os.PathLike[str], options: ImportOptions = NO_OPTIONS) -> ImportedData:
    """Read a data file of any format that `read_table` supports.

    A contact needs `time_s`, `displacement_m` (positive into the object) and `force_N` (positive in
    compression). A joint needs `time_s`, `position_rad` and `torque_Nm`, or `position_m` and `force_N` if it
    is prismatic. Several joints have numbered columns: `position_1_rad`, `torque_1_Nm`. Velocity and
    acceleration (else derived run by run without phase error), `run` and `phase` are optional.

    Args:
        path: path of the file.
        options: names and units of columns, and the rows to read.

    Raises:
        InputError: the file cannot be used; the one-line message states row, column and remedy.
    """
    return import_table(read_table(path, options.table), options)


_OF_CONTACT = {SURFACE_COLUMN: "position of the surface", STEP_COLUMN: "resolution of the displacement"}


def import_table(table: Table, options: ImportOptions = NO_OPTIONS) -> ImportedData:
    """Create channels from a table in memory; see `import_file`.

    Args:
        table: the table.
        options: names and units of columns, and the rows to read.

    Raises:
        InputError: the table cannot be used; the one-line message states row, column and remedy.
    """
    for name, given in options.where.items():
        texts, index = table.labels(name)
        chosen = chosen_texts(name, given, texts, str(table.path))
        table = table.select(np.isin(index, [texts.index(text) for text in chosen]))
    columns = assign_columns(table, options)
    sources = channel_sources(columns)
    check_options_are_used(columns, sources, options)
    rows = arrange_rows(columns, fresh=options.fresh, count=options.runs)
    notes = [*columns.notes, *filter(None, ["; ".join(rows.notes)])]
    context = _context_signals(columns, rows, options, notes)
    if any(source.kind is ChannelKind.SERVO for source in sources):
        notes.append(
            "no column holds an effort; goal minus position [rad] is used instead, which is the "
            "torque divided by the servo's position gain (model position_servo)"
        )
    time_warnings = [*_note_time(columns, rows, options.columns.values())]
    notes += [*time_warnings, *_note_specimens(columns, rows, options)]
    channels = []
    for source in sources:
        before = len(notes)
        channel = _make_channel(source, columns, rows, notes)
        channels.append(replace(channel, import_warnings=(*time_warnings, *notes[before:])))
    recorded = channels
    channels = _reverse_reactions(recorded, sources, columns, notes)
    signs = [columns.assigned[key].factor > 0.0 for each in sources for key in (each.position, each.effort)]
    signs += map(is_, recorded, channels)
    channels = [replace(channel, context=context, recorded=frozenset(context)) for channel in channels]
    roles = columns.roles
    if any(channel.surface is not None for channel in channels):
        roles |= {name: f"{what} in m" for name, what in _OF_CONTACT.items() if name in table.names}
    unused = tuple(name for name in columns.unused if name not in {*options.context, *roles})
    read = "; ".join(filter(None, [columns.matched, *columns.table.notes]))
    joint_columns = {
        source.name: (columns.name(source.position), columns.name(source.effort))
        for source in sources
        if source.kind is not ChannelKind.CONTACT and columns.matched
    }
    return ImportedData(
        with_arm(channels), rows.labels, tuple(notes), unused, read, roles, joint_columns, tuple(signs)
    )


def _context_signals(
    columns: ColumnAssignment, rows: ImportedRows, options: ImportOptions, notes: list[str]
) -> dict[str, FloatArray]:
    """Return the columns to keep as context, shape (n,) each, by their names in a session."""
    signals: dict[str, str] = {}
    for column in options.context:
        if column in columns.used:
            listed = ", ".join(columns.unused) or "none"
            raise InputError(f"--context {column}: this column is already used. Unused columns: {listed}")
        name = re.sub(r"\W+", "_", column, flags=re.ASCII)[:_MAX_SIGNAL_LENGTH]
        if name in _RESERVED_SIGNALS:
            notes.append(
                f"column '{column}' is kept as the signal recorded_{name}, because palpate computes a signal "
                f"{name} itself"
            )
            name = f"recorded_{name}"
        earlier = signals.setdefault(name, column)
        if earlier != column:
            raise InputError(
                f"--context {column}: this column and '{earlier}' would both be the signal {name}; rename one"
            )
    return {name: columns.table.numbers(column)[rows.order] for name, column in signals.items()}


def chosen_texts(name: str, given: str, texts: Collection[str], place: str) -> list[str]:
    """Return the texts of a column that `--where NAME=GIVEN` selects: one, or several separated by commas.

    Args:
        name: name of the column.
        given: the user's text.
        texts: distinct texts of the column.
        place: name of the file, for error messages.

    Raises:
        InputError: the column does not contain one of the texts.
    """
    text = " ".join(given.split())
    parts = [text] if text in texts else [part.strip() for part in text.split(",")]
    if not set(parts) <= set(texts):
        examples = list_first([text or "empty cells" for text in sorted(texts)])
        raise InputError(f"--where {name}={text}: {place} has no such row. Available: {examples}")
    return parts


def _note_time(columns: ColumnAssignment, rows: ImportedRows, user_columns: Collection[str]) -> Iterator[str]:
    """Yield notes on an unlikely unit of time, another clock, uneven times, and a pause of most of a run."""
    if TIME not in columns:
        return
    time, step_s = columns.assigned[TIME], sample_time(rows.time_s, rows.run)
    if time.column not in user_columns:
        yield from _note_other_clock(columns)
    if not MIN_STEP_S <= step_s <= MAX_STEP_S:
        unit = other_time_unit(step_s, float(np.ptp(rows.time_s)), time.factor)
        yield (
            f"column '{time.column}': samples are {step_s:.3g} s apart; if the unit of time is wrong, give "
            f"the right unit, such as --unit time={unit}"
        )
    if figures := note_uneven(rows.time_s, rows.run, columns.motions[:, rows.order]):
        yield (
            f"the times of '{time.column}' are uneven: {figures}. They may be arrival times, which make "
            "speed, damping and inertia wrong; record the time at which each sample was taken"
        )
    for part in blocks(rows.run):
        steps_s = np.diff(rows.time_s[part])
        longest = int(np.argmax(steps_s))
        if steps_s[longest] > np.sum(steps_s) - steps_s[longest]:
            row = columns.table.row_name(rows.order[part.start + longest + 1])
            yield (
                f"'{time.column}' jumps by {steps_s[longest]:.4g} s at {row}, which is longer than the rest "
                "of the run; if samples are missing, select one part with --where"
            )
            return


def _note_other_clock(columns: ColumnAssignment) -> Iterator[str]:
    """Yield a note if another column is named a time and rises in each row, but by a different duration."""
    time_s = columns.values(TIME)
    for name in columns.unused:
        if quantity_in(name) != TIME[0]:
            continue
        times = columns.table.numbers(name)
        if not all((np.diff(clock) > 0.0).all() for clock in (time_s, times)):
            continue
        unit = unit_in_name(name)
        factors = [si_factor(unit)] if dimension_of(unit) == "time" else _CLOCK_UNITS
        spans_s = [factor * np.ptp(times) for factor in factors]
        span_s = min(spans_s, key=lambda span: abs(np.log(span / np.ptp(time_s))))
        if not 1.0 / _SAME_SPAN < span_s / np.ptp(time_s) < _SAME_SPAN:
            yield (
                f"'{name}' is a clock too, but covers {span_s:.4g} s where '{columns.name(TIME)}' covers "
                f"{np.ptp(time_s):.4g} s; if '{name}' is right, add --column time={shlex.quote(name)}"
            )
            return


def _note_specimens(columns: ColumnAssignment, rows: ImportedRows, options: ImportOptions) -> list[str]:
    """Return a note if run labels or an unused column show that the runs belong to several specimens."""
    if options.fresh or options.where or len(rows.labels) < _MIN_SPECIMENS:
        return []
    if columns.run is not None and all(map(_SPECIMEN.search, rows.labels.values())):
        first = shlex.quote(f"run={rows.labels[min(rows.labels)]}")
        return [_SPECIMENS_NOTE.format(len(rows.labels), "the run labels name", first)]
    for name in columns.table.names:
        if _SPECIMEN.search(name) and name not in columns.used:
            texts, index = columns.table.labels(name)
            if _MIN_SPECIMENS <= len(texts) <= len(rows.labels) and in_blocks(index.astype(np.float64)):
                first = shlex.quote(f"{name}={texts[0]}")
                return [_SPECIMENS_NOTE.format(len(texts), f"column '{name}' names", first)]
    return []


def _make_channel(
    source: ChannelSource, columns: ColumnAssignment, rows: ImportedRows, notes: list[str]
) -> ChannelData:
    """Create one channel and append its notes to `notes`."""
    velocity_key, acceleration_key = (("velocity", source.joint), ("acceleration", source.joint))
    position, pieces = columns.values(source.position)[rows.order], number_pieces(rows.time_s, rows.run)
    name = f"'{columns.name(source.position)}'"
    notes += [*_note_gear(source, columns)]
    measured: FloatArray | None
    if source.position == velocity_key:
        measured = position
        integrals = (
            scipy.integrate.cumulative_trapezoid(measured[run], rows.time_s[run], initial=0.0)
            for run in blocks(rows.run)
        )
        position = np.concatenate(list(integrals))
        notes.append(
            f"no position column was found, so the position is integrated from {name}, starting at 0 in each "
            f"run; if a column holds the position, add --column {numbered(('position', source.joint))}=COLUMN"
        )
        if TIME not in columns:
            notes.append(
                "neither time nor position is recorded. If each row is a steady state, only effects of "
                f"{name} can be trusted, not effects of position, acceleration or time. For other conditions "
                "of the rows, such as a load, add --context COLUMN"
            )
    else:
        if source.kind.is_angle:
            position = _continuous_angle(columns, source, rows, position, notes)
        derived = differentiate(rows.time_s, position, pieces)
        signal = (name, position, derived.velocity)
        measured = _measured_derivative(columns, velocity_key, source, rows, signal, notes)
        if velocity_key not in columns:
            notes += [*_note_unused_velocity(columns, source, rows, position)]
    if measured is None:
        velocity, acceleration, name = derived.velocity, derived.acceleration, "the velocity"
    else:
        velocity, acceleration = measured, differentiate(rows.time_s, measured, pieces).velocity
        name = f"'{columns.name(velocity_key)}'"
    signal = (name, velocity, acceleration)
    measured = _measured_derivative(columns, acceleration_key, source, rows, signal, notes)
    acceleration = acceleration if measured is None else measured
    effort, phase = columns.values(source.effort)[rows.order], rows.phase
    if source.kind is ChannelKind.SERVO:
        recorded, turn = columns.values(source.position)[rows.order], 2.0 * np.pi
        goal, _, _ = unwrap_angle(effort, pieces, rows.run, turn)
        jumps = goal is not None and not np.array_equal(goal, effort)
        effort = effort - recorded
        if jumps or not np.array_equal(position, recorded):  # they jump at different times
            effort -= turn * np.round(effort / turn)
    is_contact = source.kind is ChannelKind.CONTACT
    both_ways = np.ones(len(position), dtype=np.bool_) if is_contact and columns.two_sided else None
    if is_contact and (phase == UNKNOWN_PHASE).all():
        phase = press_phases(position, velocity, effort, rows.run, both_ways)
    motion = rows.time_s, position, velocity, acceleration
    keys = (TIME, source.position, source.effort)
    units = {key[0]: columns.assigned[key].unit for key in keys if key in columns}
    data = ChannelData(
        source.name,
        source.kind,
        *motion,
        effort,
        rows.run,
        phase,
        touching=both_ways,
        units=units,
        proxy_units={
            what: si_unit(dimension)
            for what, key in (("position", source.position), ("effort", source.effort))
            if (dimension := columns.assigned[key].dimension) in PROXIES
        },
    )
    if is_contact and SURFACE_COLUMN in columns.table.names and (rows.phase != UNKNOWN_PHASE).all():
        first, table = rows.order[0], columns.table
        has_step = STEP_COLUMN in table.names and table.filled_rows(STEP_COLUMN).all()
        step_m = float(table.numbers(STEP_COLUMN)[first]) if has_step else 0.0
        return with_surface(data, float(table.numbers(SURFACE_COLUMN)[first]), step_m)
    return data


def _continuous_angle(
    columns: ColumnAssignment, source: ChannelSource, rows: ImportedRows, angle: FloatArray, notes: list[str]
) -> FloatArray:
    """Return an angle (n,) without jumps by a whole turn, and append a note if there are any."""
    column, full = columns.assigned[source.position], 2.0 * np.pi
    scale, unit = scaled_unit(column.unit, "")
    if column.is_fixed and scale == 1.0:  # the user keeps the readings as they are
        return angle
    pieces, count = number_pieces(rows.time_s, rows.run), abs(column.factor) * (abs(scale) != 1.0)
    other, turn_in_other = ("deg", 360.0) if unit == "rad" else ("rad", full * SI["angle"]["deg"])
    # A scaled angle is that of an encoder, whose turn has whole counts, or that of a motor before a gear.
    for turn, step in ((full, count), (full * abs(scale), 0.0), (turn_in_other, 0.0)):
        unwrapped, jumps, size = unwrap_angle(angle, pieces, rows.run, turn, step)
        if jumps:
            break
    else:
        return angle
    option = f"--unit {numbered(source.position)}"
    steps = f"{size / abs(column.factor):.4g} {'counts' if step else unit}"
    note = f"position '{column.column}' jumps by {steps} at {jumps} place{'s' * (jumps > 1)}"
    if turn == turn_in_other:
        notes.append(
            f"{note}; each jump is one turn in {other}; if the angle is in {other}, add {option}={other}"
        )
    elif unwrapped is None:
        notes.append(
            f"{note}; each jump is about one turn, but the rest of the motion is not smooth enough to read "
            "the jumps as turns; remove wrong readings, record faster, or save a continuous angle"
        )
    else:
        keep = "" if scale != 1.0 else f"; to prevent this, add {option}=1{unit}"
        notes.append(f"{note}; each jump is one turn, so the position is read as continuous{keep}")
        return unwrapped
    return angle


def _measured_derivative(  # noqa: PLR0917
    columns: ColumnAssignment,
    key: Key,
    source: ChannelSource,
    rows: ImportedRows,
    signal: tuple[str, FloatArray, FloatArray],
    notes: list[str],
) -> FloatArray | None:
    """Return a derivative from the file, shape (n,); None, with a note if the column cannot be used.

    `signal` is the signal of which the column is the derivative: its name in a sentence, its values (n,), and
    the derivative computed from them (n,). The note is appended to `notes`.
    """
    if key not in columns:
        return None
    signal_name, values, derived = signal
    position, measured = columns.assigned[source.position], columns.values(key)[rows.order]
    ratio = mistaken_scale(rows.time_s, values, measured, rows.run)
    rate = f"the rate of change of {signal_name}, from which the {key[0]} is derived instead"
    if not columns.assigned[key].dimension.startswith(position.dimension):
        problem = (
            f"is not used, because its unit does not match that of '{position.column}', from which the "
            f"{key[0]} is derived instead; if a unit is wrong, correct it with --unit"
        )
    elif ratio is None:
        pieces = number_pieces(rows.time_s, rows.run)
        if not is_difference(rows.time_s, values, measured, derived, pieces):
            return measured
        problem = (
            "holds differences of adjacent samples, which amplify noise; the "
            f"{key[0]} is derived from more samples instead"
        )
    elif np.isnan(ratio):
        another = f"--column {numbered(key)}=COLUMN"
        problem = f"does not follow {rate}; if another column holds the {key[0]}, add {another}"
    else:
        example = _unit_example(columns, source, ratio) if key[0] == "velocity" else ""
        wrong_unit = f"a unit is wrong; correct it with --unit{example}"
        if TIME not in columns and key[0] == "velocity":  # rows of no stated interval count as 1 s apart
            step = f"{1e3 / ratio:.3g}"
            wrong_unit = f"if its unit is right, rows are {step} ms apart; then add --unit time={step}ms"
        remedy = "it has the wrong sign" if ratio < 0.0 else wrong_unit
        problem = f"is {ratio:.3g} times {rate}; {remedy}"
    notes.append(f"column '{columns.name(key)}' {problem}")
    return None


def _note_unused_velocity(
    columns: ColumnAssignment, source: ChannelSource, rows: ImportedRows, position: FloatArray
) -> Iterator[str]:
    """Yield a note on an unused velocity that contradicts the position (n,) by a constant factor."""
    rates = SI.get(f"{columns.assigned[source.position].dimension}_rate", {})
    for guess in columns.table.guesses:
        is_unused = guess.key == ("velocity", source.joint) and guess.column in columns.unused
        if not is_unused or guess.unit not in rates:
            continue
        velocity = rates[guess.unit] * columns.table.numbers(guess.column)[rows.order]
        ratio = mistaken_scale(rows.time_s, position, velocity, rows.run)
        if ratio is not None and np.isfinite(ratio):
            likely = _unit_example(columns, source, ratio)
            gear = "; a gear between the two sensors would also explain this factor" * (
                source.kind.is_angle and not likely
            )
            yield (
                f"column '{guess.column}', which is not used, is {ratio:.3g} times the rate of change of "
                f"'{columns.name(source.position)}'; if a unit is wrong, correct it with --unit{likely}{gear}"
            )


def _unit_example(columns: ColumnAssignment, source: ChannelSource, ratio: float) -> str:
    """Return an example of --unit by which a velocity agrees that is `ratio` times the position's slope."""
    position, option = columns.assigned[source.position], numbered(source.position)
    units = SI[position.dimension].items()
    likely = [unit for unit, size in units if abs(size / position.factor / ratio - 1.0) < _SAME_RATIO]
    return f", such as --unit {option}={likely[0]}" if likely else ""


def _note_gear(source: ChannelSource, columns: ColumnAssignment) -> Iterator[str]:
    """Yield a note if one of position and effort is named after the motor, and the other after the joint."""
    for motor, joint in ((source.position, source.effort), (source.effort, source.position)):
        sides = [set(words_of(columns.name(key))) & (_MOTOR_WORDS | _JOINT_WORDS) for key in (motor, joint)]
        is_split = all(sides) and sides[0] <= _MOTOR_WORDS and sides[1] <= _JOINT_WORDS
        if is_split and not any(columns.assigned[key].is_fixed for key in (motor, joint)):
            example = f"{'50' if motor == source.effort else '0.02'}{columns.assigned[motor].unit}"
            yield (
                f"according to their names, '{columns.name(motor)}' belongs to the motor and "
                f"'{columns.name(joint)}' to the joint; for a gear of 50:1 between them, add --unit "
                f"{numbered(motor)}={example}"
            )


def _reverse_reactions(
    channels: Sequence[ChannelData],
    sources: Sequence[ChannelSource],
    columns: ColumnAssignment,
    notes: list[str],
) -> list[ChannelData]:
    """Reverse the efforts of joints if they are reactions to the drive, and append a note to `notes`.

    All joints of a file are reversed if the sign is certain for some and contradicted by none. A unit with a
    number, such as 1Nm, prevents the reversal.
    """
    power = {channel.name: _passive_power(channel) for channel in channels if channel.kind in _JOINT_KINDS}
    if min(power.values(), default=0.0) > -_CERTAIN_SIGN:
        return list(channels)
    is_mixed = max(power.values()) > _CERTAIN_SIGN
    reversed_efforts = {
        source.name: columns.assigned[source.effort]
        for source in sources
        if source.name in power
        and (not is_mixed or power[source.name] < -_CERTAIN_SIGN)
        and not columns.assigned[source.effort].is_fixed
    }
    if reversed_efforts:
        names = ", ".join(f"'{effort.column}'" for effort in reversed_efforts.values())
        chosen = (source for source in sources if source.name in reversed_efforts)
        options = [f"--unit {s.effort[0]}={reversed_efforts[s.name].fixed_unit}" for s in chosen]
        opposes, signs = ("opposes", "its sign is") if len(options) == 1 else ("oppose", "their signs are")
        notes.append(
            f"{names} {opposes} the velocity, as the reaction to a drive does, so {signs} reversed; "
            f"to prevent this, add {' '.join(dict.fromkeys(options))}"
        )
    return [replace(c, effort=-c.effort) if c.name in reversed_efforts else c for c in channels]


def _passive_power(channel: ChannelData) -> float:
    """Correlate a joint's velocity with the part of its effort that position and inertia do not explain.

    A joint dissipates the energy of its drive. The correlation is therefore positive for the effort of the
    drive, and negative for the reaction to it. In a reaction the inertia is negative as well. The correlation
    is set to zero (uncertain sign) if the fitted damping is negative, but the fitted inertia is positive and
    explains more than a small share of what the damping explains. The effort is then early or late, or a gap
    delays it. If an earlier effort is explained much better, the inertia and damping of this effort count.
    A positive stiffness of a linear axis contradicts as well, since gravity is constant there: the delayed
    effort of a spring is like a negative damping. So does the work of a drive that never returns, where any
    law of the position may look like damping: a drive slows down where its load is large.

    Sources: J. C. Willems, Arch. Rational Mech. Anal. 45 (1972), dissipative systems; J. E. Colgate, G. G.
    Schenkel, J. Robot. Syst. 14 (1997), delayed springs.
    """
    place = channel.position - channel.position.mean()
    law = scipy.linalg.orth(np.vander(place / (float(np.ptp(place)) or 1.0), 4))

    def beside_position(signal: FloatArray) -> FloatArray:
        return np.asarray(signal - law @ (law.T @ signal))

    velocity, acceleration = map(beside_position, (channel.velocity, channel.acceleration))
    motion = np.column_stack([velocity, acceleration])

    def fit(effort: FloatArray) -> tuple[float, float, float]:
        """Return the effort of damping and of inertia, and the mean squared error."""
        gains = np.linalg.lstsq(motion, effort, rcond=None)[0]
        damping, inertia = (gains * motion.std(axis=0)).tolist()
        return damping, inertia, float(np.mean((effort - motion @ gains) ** 2))

    effort = beside_position(channel.effort)
    damping, inertia, error = fit(effort)
    takes_work = float(channel.effort @ channel.velocity) > 0.0
    if damping < 0.0 and takes_work and never_returns(channel.position, channel.run):
        return 0.0
    if damping < 0.0 and channel.kind is ChannelKind.PRISMATIC:
        constant = np.ones(len(channel))
        others = scipy.linalg.orth(np.column_stack([constant, channel.velocity, channel.acceleration]))
        beside_motion = place - others @ (others.T @ place)
        stiffness = float(beside_motion @ channel.effort) / float(np.linalg.norm(beside_motion) or 1.0)
        if stiffness > 0.0 and stiffness**2 > _CONTRADICTING * damping**2 * len(channel):
            return 0.0
    if damping < 0.0:
        step_s, best = sample_time(channel.time_s, channel.run), (damping, inertia, _MUCH_BETTER * error)
        for delay_s in np.geomspace(step_s, max(_LONGEST_DELAY_S, step_s), _DELAYS).tolist():
            earlier = shift(channel.effort, channel.time_s, channel.run, -delay_s)
            best = min(best, fit(beside_position(earlier)), key=lambda fitted: fitted[2])
        if best[1] > 0.0 and (best[0] > 0.0 or best[1] ** 2 > _CONTRADICTING * best[0] ** 2):
            return 0.0
    without_inertia = effort - inertia / (acceleration.std() or 1.0) * acceleration
    return correlation_coefficient(velocity, without_inertia)


def with_arm(channels: Sequence[ChannelData]) -> tuple[ChannelData, ...]:
    """Add position, velocity and acceleration of all joints, (n, joints), to the context of joint channels.

    Args:
        channels: channels of one recording, all of equal length.
    """
    joints = [channel for channel in channels if channel.kind is not ChannelKind.CONTACT]
    if not joints:
        return tuple(channels)
    motions = ((joint.position, joint.velocity, joint.acceleration) for joint in joints)
    arm = dict(zip(ARM_MOTION, map(np.column_stack, zip(*motions, strict=True)), strict=True))
    with_motion = {joint.name: replace(joint, context={**joint.context, **arm}) for joint in joints}
    return tuple(with_motion.get(channel.name, channel) for channel in channels)
