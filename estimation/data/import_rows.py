"""Assign rows of a data file to runs and phases, and put them in order."""

import shlex
from dataclasses import dataclass, replace

import numpy as np

from palpate.control.loop.task import Phase
from palpate.estimation.data.assign_columns import ColumnAssignment, in_blocks
from palpate.estimation.data.choose_columns import has_levels, is_parameter_named_as_time
from palpate.estimation.data.column_names import DISPLACEMENT, FORCE, RUN, TIME, guess_columns
from palpate.estimation.data.file_columns import list_first
from palpate.estimation.data.presses import MAX_RUNS, MIN_RUN_ROWS, cut_into, cut_presses, number_recordings
from palpate.estimation.data.table import Table
from palpate.estimation.data.units import MIN_INCREASE_S
from palpate.estimation.signals.blocks import blocks, since_start
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, IntArray

UNKNOWN_PHASE = -1
_MAX_DIGITS = 18  # digits of a run number; longer ones are names, such as serial numbers
_MAX_REPEATED_SHARE = 0.05  # largest share of rows that may repeat the time of the previous row
_GAP, _QUICK = 1.5, 0.75  # least step of a gap and largest step in a burst, relative to the usual step
_FEW_GAPS, _MAX_BURST = 0.05, 50  # largest share of gaps; most steps of a gap and its burst
_CYCLE_RANGE = 0.3  # least share of the position's range that a cycle covers
_CYCLE_SHARE = 0.8  # least share of the stretches between clock restarts that must be cycles
_MIN_JUMP = 5.0  # least jump of the position between two tests, relative to its usual step
_MIN_ROWS = 5  # least number of samples in a run; with fewer the acceleration is meaningless
_SHOWN_RUNS = 3  # runs that an error message names
_REPEATED_NOTE = (  # note with the number of rows and the column
    "repeats times: {0} rows are spaced evenly up to the next time; if this column is not the time of each "
    "row, add --context {1} to read it as another signal"
)
_LATE_NOTE = "stamps {0} rows late, in bursts after gaps: their times are spaced evenly over gap and burst"


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
    if columns.run is None:
        run, notes = _detect_runs(columns, _times(columns), count)
        labels = {number: str(number) for number in np.unique(run).tolist()}
    else:
        run, labels = _numbered_runs(table, columns.run)
        notes = []
        if count is not None:  # `columns.run` may be no column of the file but name its parts
            given = list_first(list(labels.values()), _SHOWN_RUNS)
            raise InputError(f"--runs {count}: the file already gives the runs ('{columns.run}': {given})")
    order = np.argsort(run, kind="stable")
    time_s = _times(columns)[order]
    if TIME not in columns:
        notes.append(
            "no time column: rows are assumed to be 1 s apart, so speeds, damping, inertia and relaxation "
            "times are not in seconds; if a column holds the time, add --column time=COLUMN"
        )
        notes += [
            _note_parameter(columns, name)
            for name in columns.unused
            if is_parameter_named_as_time(columns.table, name)
        ]
    is_repeated = np.abs(np.diff(time_s, prepend=-np.inf)) < MIN_INCREASE_S
    is_repeated[1:] &= np.diff(run[order]) == 0
    if 0 < np.sum(is_repeated) < _MAX_REPEATED_SHARE * len(order):
        notes.append(table.note_left_out(order[is_repeated], "they repeat the previous time"))
        order, time_s = order[~is_repeated], time_s[~is_repeated]
    counts = np.bincount(run[order]) if columns.run is None else np.array([_MIN_ROWS])
    if counts.min() < _MIN_ROWS <= counts.max():  # these runs were only detected, so they can be dropped
        is_short = counts[run[order]] < _MIN_ROWS
        notes.append(table.note_left_out(order[is_short], f"their run has fewer than {_MIN_ROWS}"))
        order, time_s = order[~is_short], time_s[~is_short]
        labels = {number: labels[number] for number in np.unique(run[order]).tolist()}
    run = run[order]
    for spread, note in ((_spread_repeated_times, _REPEATED_NOTE), (_spread_late_stamps, _LATE_NOTE)):
        before_s, time_s = time_s, spread(time_s, run)
        if moved := int(np.sum(time_s != before_s)):
            name = columns.name(TIME)
            notes.append(f"'{name}' {note.format(f'{moved} of {len(order)}', shlex.quote(name))}")
    rows = ImportedRows(order, time_s, run, _phases(table, columns.phase)[order], labels, tuple(notes))
    _check_times(columns, rows)
    runs, counts = np.unique(run, return_counts=True)
    if counts.min() < _MIN_ROWS:
        rows_in = "1 row" if counts.min() == 1 else f"{counts.min()} rows"
        needed = f"has {rows_in}, at least {_MIN_ROWS} are needed"
        if columns.run is None:
            raise InputError(f"{table.path}: {needed}")
        raise InputError(
            f"{table.path}: run '{labels[int(runs[np.argmin(counts)])]}' {needed}; leave it out with "
            f"--where, or check the column '{columns.run}', which names the runs"
        )
    return replace(rows, time_s=since_start(time_s, run)) if fresh else rows


def _note_parameter(columns: ColumnAssignment, name: str) -> str:
    """Return a note on a column that may be named after the time but holds levels of a parameter."""
    values, quoted = columns.table.numbers(name), shlex.quote(name)
    levels, changes = len(np.unique(values)), np.count_nonzero(np.diff(values))
    note = f"'{name}' is not read as the time, since it keeps each of its {levels} values over many rows"
    if columns.run is None and changes == levels - 1:  # each value occupies one block of rows
        note += f"; if each value is a run, add --column {RUN}={quoted}"
    return f"{note}; if it is the time, add --column time={quoted}"


def _numbered_runs(table: Table, column: str) -> tuple[IntArray, dict[int, str]]:
    """Return the run number of each row, shape (n,), and the name of each run, from the column of runs.

    The numbers are those of the file if they are distinct whole numbers, else in order of appearance.
    """
    names, index = table.labels(column)
    in_file = [int(name) for name in names if name.isdecimal() and len(name) <= _MAX_DIGITS]
    numbers = in_file if len(set(in_file)) == len(names) else range(len(names))  # "1" and "01" are two runs
    return np.array(numbers, dtype=np.int64)[index], dict(sorted(zip(numbers, names, strict=True)))


def without_repeated_rows(columns: ColumnAssignment) -> ColumnAssignment:
    """Remove rows that repeat an earlier row and make the clock go back, and note it.

    A logger that writes its buffer twice repeats samples with their times. Rows that differ in any column,
    such as the name of a specimen, are not repeats. If the clock returns to its start, a new run begins,
    which may legitimately repeat another run. Nothing is removed in that case, if the clock also goes back
    without the repeats, or if a column states the run.

    Args:
        columns: columns of the table.
    """
    if TIME not in columns or columns.run is not None:
        return columns
    table, time_s = columns.table, columns.values(TIME)
    restarts_s = time_s[1:][np.diff(time_s) < 0.0]
    if len(restarts_s) == 0 or restarts_s.min() <= time_s[0]:
        return columns
    codes = np.column_stack([table.labels(name)[1] for name in table.names])
    is_new = np.zeros(len(table), dtype=np.bool_)
    is_new[np.unique(codes, axis=0, return_index=True)[1]] = True
    if is_new.all() or np.any(np.diff(time_s[is_new]) < 0.0):
        return columns
    note = table.note_left_out(np.flatnonzero(~is_new), "each repeats an earlier row")
    return replace(columns, table=table.select(is_new), choice_notes=(*columns.choice_notes, note))


def _times(columns: ColumnAssignment) -> FloatArray:
    return columns.values(TIME) if TIME in columns else np.arange(len(columns.table), dtype=np.float64)


def _detect_runs(
    columns: ColumnAssignment, time_s: FloatArray, count: int | None
) -> tuple[IntArray, list[str]]:
    """Detect the run of each row if no column states it, and return a note on the method.

    A restart of the clock begins a run, or without a clock another value of a parameter; presses of a contact
    are separated in free air.

    Raises:
        InputError: the number of presses contradicts the data.
    """
    place = f"{columns.table.path}: --runs {count}"
    is_contact = DISPLACEMENT in columns and FORCE in columns and not columns.two_sided
    recording, parameter = number_recordings(time_s), ""
    if TIME not in columns and count is None:
        recording, parameter = _tests_by_parameter(columns)
    restarts = int(recording[-1])
    if not restarts and count is None:
        cycle, clock = _cycles(columns)
        if clock:
            return cycle, [
                f"'{clock}' restarts: cut into {cycle[-1] + 1} runs, one for each cycle; if that is "
                f"wrong, add --column {RUN}=COLUMN" + (" or --runs N" if is_contact else "")
            ]
    run, presses = recording, 1
    if count is not None and not is_contact:
        raise InputError(f"{place}: there is no contact to be cut into presses")
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
    reason = "the clock restarts: " if restarts else ""
    reason = f"the position jumps wherever '{parameter}' changes: " if parameter else reason
    is_cut = is_contact and count != 1
    which = f", one for {'each press' if presses == 1 else f'{presses} presses'}" if is_cut else ""
    remedy = "add --runs N" if is_cut else "name the column that numbers them, --column run=COLUMN"
    return run, [f"{reason}cut into {number} runs{which}; if that is wrong, {remedy}"]


def _tests_by_parameter(columns: ColumnAssignment) -> tuple[IntArray, str]:
    """Number the tests of a table without a clock by a parameter, and return its column.

    The position jumps where another test begins. The rows remain one test, and the column name is empty, if
    no unused column changes at exactly the largest steps of the position.
    """
    one_test = np.zeros(len(columns.table), dtype=np.int64)
    moved_key = next((key for key in columns.assigned if key[0] in {"displacement", "position"}), None)
    if moved_key is None:
        return one_test, ""
    steps = np.abs(np.diff(columns.values(moved_key)))
    for name in columns.unused:
        values = columns.table.numbers(name)
        if not has_levels(values):
            continue
        changes = np.diff(values) != 0.0
        within = steps[~changes]
        test = np.append(0, np.cumsum(changes))
        is_jump = steps[changes].min() > max(within.max(), _MIN_JUMP * float(np.median(within)))
        if is_jump and test[-1] < MAX_RUNS and np.bincount(test).min() >= MIN_RUN_ROWS:
            return test, name
    return one_test, ""


def _cycles(columns: ColumnAssignment) -> tuple[IntArray, str]:
    """Number the cycles of a repeated test by a second clock that restarts, and return its column.

    The rows remain one run, and the column name is empty, if there are very many or very short cycles, or if
    most of them do not return to their initial position.
    """
    moved_key = next((key for key in columns.assigned if key[0] in {"displacement", "position"}), None)
    for guess in guess_columns(columns.unused):
        is_clock = guess.key == TIME and not is_parameter_named_as_time(columns.table, guess.column)
        if is_clock and moved_key is not None:
            position = columns.values(moved_key)
            cycle = number_recordings(columns.table.numbers(guess.column))
            if not 0 < cycle[-1] < MAX_RUNS or np.bincount(cycle).min() < MIN_RUN_ROWS:
                continue
            returns = [
                np.ptp(path) > _CYCLE_RANGE * np.ptp(position)
                and abs(path[-1] - path[0]) < 0.5 * np.ptp(path)
                for path in (position[rows] for rows in blocks(cycle))
            ]
            if np.mean(returns) > _CYCLE_SHARE:
                return cycle, guess.column
    return np.zeros(len(columns.table), dtype=np.int64), ""


def _spread_repeated_times(time_s: FloatArray, run: IntArray) -> FloatArray:
    """Distribute rows with equal times evenly up to the next time, for clocks coarser than the row rate.

    A run whose clock never advances, or decreases, is unchanged.
    """
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
        raise InputError(
            f"{table.path}: column '{name}' has the same time in all rows; name the time column with "
            f"--column time=COLUMN, or add --context {shlex.quote(name)} to read this one as another signal"
        )
    before, after = rows.order[late[0]], rows.order[late[0] + 1]
    in_run = f" of run '{rows.labels[int(rows.run[late[0]])]}'" if len(rows.labels) > 1 else ""
    in_order = ""  # unused text column whose values each occupy one block of rows with increasing times
    increases = np.diff(_times(columns)) > 0.0
    for text_column in table.names:
        if text_column not in columns.used:
            index = table.labels(text_column)[1]
            if in_blocks(index.astype(np.float64)) and ((np.diff(index) != 0) | increases).all():
                in_order = text_column
                break
    number = shlex.quote(in_order or columns.run_candidate or "COLUMN")
    sort = "" if in_order else "sort the rows, or "
    remedy = f"{sort}name the column that numbers the runs: --column {RUN}={number}"
    raise InputError(
        f"{table.place(after, name)}: {rows.time_s[late[0] + 1]:.9g} s does not come after "
        f"{rows.time_s[late[0]]:.9g} s in {table.row_name(before)}{in_run}; times must increase within "
        f"a run: {remedy}"
    )
