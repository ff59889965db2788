"""Assign rows of a data file to runs and phases, and put them in order."""

import shlex
from dataclasses import dataclass, replace

import numpy as np

from palpate.control.loop.task import Phase
from palpate.estimation.data.assign_columns import ColumnAssignment
from palpate.estimation.data.column_names import DISPLACEMENT, FORCE, RUN, TIME, Role
from palpate.estimation.data.even_clock import spread_packets
from palpate.estimation.data.file_columns import list_first
from palpate.estimation.data.measured_derivatives import mistaken_scale
from palpate.estimation.data.presses import cut_into, cut_presses
from palpate.estimation.data.table import Table
from palpate.estimation.data.units import MIN_INCREASE_S, dimension_of, si_factor
from palpate.estimation.signals.blocks import blocks, since_start
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, IntArray

UNKNOWN_PHASE = -1
_MAX_DIGITS = 18  # digits of a run number; longer ones are names, such as serial numbers
_MAX_REPEATED_SHARE = 0.05  # largest share of rows that may repeat the time of the previous row
_GAP, _QUICK = 1.5, 0.75  # least step of a gap and largest step in a burst, relative to the usual step
_FEW_GAPS, _MAX_BURST = 0.05, 1000  # largest share of gaps; most steps of a gap and its burst
# Longest unit of a counter, and its longest step at an overflow by its bits, relative to the usual step.
_MAX_COUNT_S, _MAX_OVERFLOW_STEP = 1e-3, {32: 10.0, 31: 2.0, 24: 2.0, 16: 2.0}
# Parts of a file in which a velocity must agree with the motion, least rows of each, and largest ratio of the
# intervals.
_PARTS, _MIN_PART, _SAME_INTERVAL = 3, 20, 1.05
_MIN_ROWS = 5  # least number of samples in a run; with fewer the acceleration is meaningless
_REPEATED_NOTE = (  # notes with the number of rows, the column, and the column as a shell reads it
    "'{1}' repeats times, so {0} rows are spaced evenly; if this column is not the time of each "
    "row, add --context {2} to read it as another signal"
)
_PACKETS_NOTE = "'{1}' stamps rows in packets that follow an even clock, so {0} rows are spaced evenly"
_LATE_NOTE = (
    "'{1}' stamps {0} rows late, in bursts after gaps. Their times are therefore spaced evenly over each gap "
    "with its burst"
)


@dataclass(frozen=True)
class ImportedRows:
    """Rows of a table, one block for each run."""

    order: IntArray  # index of each row in the table, shape (n,)
    time_s: FloatArray  # times, strictly increasing within a run, shape (n,) [s]
    run: IntArray  # run number of each row, shape (n,)
    phase: IntArray  # numbers of `palpate.control.loop.task.Phase`, or -1 if unknown, shape (n,)
    labels: dict[int, str]  # name of each run in the file, by its number
    notes: tuple[str, ...] = ()  # notes on the detection of runs and on repairs


def arrange_rows(columns: ColumnAssignment, *, fresh: bool, count: int | None) -> ImportedRows:
    """Group the rows by run.

    Args:
        columns: columns of the table.
        fresh: whether to restart the clock in each run, which marks runs as independent of each other.
        count: number of presses in the recording; None if unknown.

    Raises:
        InputError: times do not increase within a run, a run is too short, or a phase is unknown.
    """
    table = columns.table
    times_s, bits = _times(columns)
    if columns.run is None:
        run, notes = _detect_runs(columns, times_s, count)
        labels = {number: str(number) for number in np.unique(run).tolist()}
    else:
        names, index = table.labels(columns.run)
        in_file = [int(name) for name in names if name.isdecimal() and len(name) <= _MAX_DIGITS]
        # Runs are numbered by appearance unless all names are different numbers; "1" and "01" are two runs.
        numbers = in_file if len(set(in_file)) == len(names) else range(len(names))
        run = np.array(numbers, dtype=np.int64)[index]
        labels = dict(sorted(zip(numbers, names, strict=True)))
        notes = []
        if count is not None:  # `columns.run` may be no column of the file but name its parts
            given = list_first(list(labels.values()))
            raise InputError(f"--runs {count}: the file already gives the runs ('{columns.run}': {given})")
    order = np.argsort(run, kind="stable")
    ordered_s, ordered_run = times_s[order], run[order]
    clock = [write(columns.name(TIME)) for write in (str, shlex.quote) if TIME in columns]
    time_s = spread_packets(ordered_s, ordered_run, columns.motions[:, order])
    if (time_s != ordered_s).any():
        repeats = ((np.diff(ordered_s) < MIN_INCREASE_S) & (np.diff(ordered_run) == 0)).any()
        notes.append((_REPEATED_NOTE if repeats else _PACKETS_NOTE).format(len(order), *clock))
    if TIME not in columns:
        notes.append(
            "no time column was found, so rows are assumed to be 1 s apart. In speeds, damping, inertia and "
            f"relaxation times, one second therefore means one row; {columns.clock_advice}; "
            f"{_interval_advice(columns, run)}"
        )
    elif (added_s := float(np.max(times_s - columns.values(TIME)))) > 0.0:
        notes.append(
            f"'{columns.name(TIME)}' wraps around like a {bits}-bit counter, so it is read as continuous, "
            f"which adds {added_s:.9g} s in total"
        )
    is_repeated = np.abs(np.diff(time_s, prepend=-np.inf)) < MIN_INCREASE_S
    is_repeated[1:] &= np.diff(run[order]) == 0
    if 0 < np.sum(is_repeated) < _MAX_REPEATED_SHARE * len(order):
        notes.append(table.note_left_out(order[is_repeated], "they repeat the previous time"))
        order, time_s = order[~is_repeated], time_s[~is_repeated]
    counts = np.bincount(run[order]) if columns.run is None else np.array([_MIN_ROWS])
    if counts.min() < _MIN_ROWS <= counts.max():  # these runs were only detected, so they can be dropped
        is_short = counts[run[order]] < _MIN_ROWS
        notes.append(table.note_left_out(order[is_short], f"their run has fewer than {_MIN_ROWS} rows"))
        order, time_s = order[~is_short], time_s[~is_short]
        labels = {number: labels[number] for number in np.unique(run[order]).tolist()}
    run = run[order]
    for spread, note in ((_spread_repeated_times, _REPEATED_NOTE), (_spread_late_stamps, _LATE_NOTE)):
        before_s, time_s = time_s, spread(time_s, run)
        if moved := int(np.sum(time_s != before_s)):
            notes.append(note.format(f"{moved} of {len(order)}", *clock))
    rows = ImportedRows(order, time_s, run, _phases(table, columns.phase)[order], labels, tuple(notes))
    _check_times(columns, rows)
    _check_lengths(columns, rows)
    return replace(rows, time_s=since_start(time_s, run)) if fresh else rows


def _interval_advice(columns: ColumnAssignment, run: IntArray) -> str:
    """Propose the interval of rows that a recorded velocity implies, if it is the same in all parts."""
    rows, names, ratios = np.argsort(run, kind="stable"), list[str](), list[float]()
    given = (Role(source.column, *key, source.unit) for key, source in columns.assigned.items())
    roles = {role.column: role for role in (*columns.table.guesses, *given)}
    for guess in roles.values() if len(rows) >= _PARTS * _MIN_PART else ():
        position = columns.assigned.get(("position", guess.joint))
        if guess.quantity != "velocity" or position is None or not columns.table.varies(guess.column):
            continue
        in_same_unit = dimension_of(guess.unit) != f"{position.dimension}_rate"
        velocity = columns.table.numbers(guess.column)
        velocity = velocity * (abs(position.factor) if in_same_unit else si_factor(guess.unit))
        moved = columns.values(("position", guess.joint))
        parts = (
            mistaken_scale(columns.table.rows[part].astype(float), moved[part], velocity[part], run[part])
            for part in np.array_split(rows, _PARTS)
        )
        if found := [ratio for ratio in parts if ratio is not None]:
            names.append(f"'{guess.column}'" + f", if it is in {position.unit}/s" * in_same_unit)
            ratios += found
    if len(ratios) < _PARTS or not 0.0 < max(ratios) < _SAME_INTERVAL * min(ratios):  # not if one is NaN
        return "if rows are evenly spaced, give their interval, as in --unit time=10ms"
    interval = f"{1e3 / float(np.median(ratios)):.3g}"
    return f"rows are {interval} ms apart according to {names[0]}; add --unit time={interval}ms"


def _times(columns: ColumnAssignment) -> tuple[FloatArray, int]:
    """Return the time of each row, shape (n,) [s], continued after overflows, and the counter's bits or 0."""
    if TIME not in columns:
        return np.arange(len(columns.table), dtype=np.float64), 0
    time_s, count_s = columns.values(TIME), columns.assigned[TIME].factor
    if len(time_s) < 2 or count_s > _MAX_COUNT_S:
        return time_s, 0
    steps_s = np.diff(time_s)
    usual_s = float(np.median(steps_s))
    for bits, longest in _MAX_OVERFLOW_STEP.items():
        range_s = 2**bits * count_s
        overflows = (steps_s < 0.0) & (steps_s + range_s > 0.0) & (steps_s + range_s <= longest * usual_s)
        # A run may have as many rows as a short counter has values, and then restart its clock.
        is_short = bits < max(_MAX_OVERFLOW_STEP)
        restarts = np.abs(time_s[1:][overflows] - time_s[0]) <= 2.0 * usual_s
        if overflows.any() and not (is_short and (restarts.any() or np.max(time_s) >= range_s)):
            time_s[1:] += range_s * np.cumsum(overflows)
            return time_s, bits
    return time_s, 0


def _detect_runs(
    columns: ColumnAssignment, time_s: FloatArray, count: int | None
) -> tuple[IntArray, list[str]]:
    """Detect runs, which begin at restarts of the clock and between presses, with a note on the method."""
    place = f"{columns.table.path}: --runs {count}"
    is_contact = DISPLACEMENT in columns and FORCE in columns and not columns.two_sided
    goes_back = np.diff(time_s, prepend=time_s[:1]) < 0.0
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    returns_to_start = np.abs(time_s[goes_back] - time_s[0]) <= 2.0 * max(step_s, 0.0)
    is_start = goes_back & bool(returns_to_start.all())
    recording = np.cumsum(is_start, dtype=np.int64)  # restarts of a clock begin recordings
    restarts = int(recording[-1])
    run, presses = recording, 1
    if count is not None and not is_contact:
        raise InputError(f"{place}: there is no contact to divide into presses")
    if count is not None and 1 < count <= restarts:
        times = "once" if restarts == 1 else f"{restarts} times"
        raise InputError(f"{place}: the clock restarts {times}, so there are at least {restarts + 1} runs")
    if is_contact and count is None:
        run, presses = cut_presses(columns.values(FORCE), columns.values(DISPLACEMENT), recording, time_s)
    elif is_contact and count is not None and count > 1:
        run = cut_into(columns.values(FORCE), columns.values(DISPLACEMENT), recording, time_s, count, place)
    number = int(run[-1]) + 1
    if number == 1:
        return run, []
    reason = "the clock restarts, so the data are " if restarts else ""
    is_cut = is_contact and count != 1
    which = f", one for {'each press' if presses == 1 else f'every {presses} presses'}" if is_cut else ""
    remedy = "add --runs N" if is_cut else "name the column that numbers the runs: --column run=COLUMN"
    return run, [f"{reason}cut into {number} runs{which}; if that is wrong, {remedy}"]


def _spread_repeated_times(time_s: FloatArray, run: IntArray) -> FloatArray:
    """Distribute rows with equal times evenly up to the next time, for clocks coarser than the row rate."""
    spread_s = time_s.copy()
    for rows in blocks(run):
        read = time_s[rows]
        steps = np.diff(read)
        first = np.flatnonzero(np.append(True, steps > MIN_INCREASE_S))  # rows at which the clock advances
        if (steps < 0.0).any() or len(first) in {1, len(read)}:
            continue
        usual_s = (read[first[-1]] - read[0]) / first[-1]
        end_s = read[-1] + usual_s * (len(read) - first[-1])
        spread_s[rows] = np.interp(np.arange(len(read)), [*first, len(read)], [*read[first], end_s])
    return spread_s


def _spread_late_stamps(time_s: FloatArray, run: IntArray) -> FloatArray:
    """Distribute rows with late time stamps evenly over the burst and the gap before it.

    A busy logger stamps delayed samples in quick succession. A speed derived from such times would be many
    times too large.
    """
    spread_s = time_s.copy()
    for rows in blocks(run):
        steps = np.diff(time_s[rows])
        if len(steps) < _MIN_ROWS or (steps <= 0.0).any():
            continue
        step_s = float(np.median(steps))
        gaps = np.flatnonzero(steps > _GAP * step_s)
        if len(gaps) > _FEW_GAPS * len(steps):
            continue
        for gap in gaps:
            burst = steps[gap : gap + _MAX_BURST]
            quick = int(np.argmin(np.append(burst[1:] < _QUICK * step_s, False)))  # stamps in the burst
            late = float(burst[: quick + 1].sum()) - (quick + 1) * step_s
            if quick and abs(late) < 0.5 * step_s:
                first, last = rows.start + gap, rows.start + gap + quick + 1
                spread_s[first : last + 1] = np.linspace(spread_s[first], spread_s[last], last + 1 - first)
    return spread_s


def _phases(table: Table, column: str | None) -> IntArray:
    if column is None:
        return np.full(len(table), UNKNOWN_PHASE, dtype=np.int64)
    known = {phase.name.lower(): phase.value for phase in Phase}
    known |= {str(value): value for value in (UNKNOWN_PHASE, *known.values())}
    names, index = table.labels(column)
    for number, name in enumerate(names):
        if name.lower() not in known:
            place = table.place(np.argmax(index == number), column)
            raise InputError(f"{place}: no phase is called '{name:.60}'. Valid: {', '.join(known)}")
    return np.array([known[name.lower()] for name in names], dtype=np.int64)[index]


def _check_times(columns: ColumnAssignment, rows: ImportedRows) -> None:
    late = np.flatnonzero((np.diff(rows.time_s) < MIN_INCREASE_S) & (np.diff(rows.run) == 0))
    if not len(late):
        return
    table, name = columns.table, columns.name(TIME)
    if (np.diff(rows.time_s)[np.diff(rows.run) == 0] < 0).all():
        raise InputError(f"{table.path}: column '{name}' decreases throughout; reverse the order of the rows")
    if np.ptp(rows.time_s) == 0.0:
        step_s = rows.time_s[0]
        interval = f", and --unit time={step_s:.6g}s if it is the interval of rows" if step_s > 0.0 else ""
        raise InputError(
            f"{table.path}: column '{name}' has the same time in all rows; name the time column with "
            f"--column time=COLUMN, or add --context {shlex.quote(name)} to read this one as another signal"
            f"{interval}"
        )
    before, after = rows.order[late[0]], rows.order[late[0] + 1]
    in_run = f" of run '{rows.labels[int(rows.run[late[0]])]}'" if len(rows.labels) > 1 else ""
    number = shlex.quote(columns.run_candidate or "COLUMN")
    remedy = f"sort the rows, or name the column that numbers the runs: --column {RUN}={number}"
    raise InputError(
        f"{table.place(after, name)}: {rows.time_s[late[0] + 1]:.9g} s does not come after "
        f"{rows.time_s[late[0]]:.9g} s in {table.row_name(before)}{in_run}; times must increase within "
        f"a run; {remedy}"
    )


def _check_lengths(columns: ColumnAssignment, rows: ImportedRows) -> None:
    path, (runs, counts) = columns.table.path, np.unique(rows.run, return_counts=True)
    if counts.min() < _MIN_ROWS:
        rows_in = "1 row" if counts.min() == 1 else f"{counts.min()} rows"
        needed = f"has {rows_in}, but at least {_MIN_ROWS} are needed"
        if columns.run is None:
            raise InputError(f"{path}: {needed}")
        raise InputError(
            f"{path}: run '{rows.labels[int(runs[np.argmin(counts)])]}' {needed}; leave it out with "
            f"--where, or check the column '{columns.run}', which names the runs"
        )
