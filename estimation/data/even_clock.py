"""Recover the even clock of rows that were stamped in packets or by a coarse clock."""

import numpy as np

from palpate.estimation.data.units import MIN_INCREASE_S
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

# Steps within a packet and between packets, relative to the mean step; least share of steps within packets,
# and largest share of steps that are neither.
_WITHIN, _BETWEEN, _MIN_QUICK, _MAX_OTHER = 0.3, 1.05, 0.04, 0.05
_PAUSE = 1.8  # least length of a pause, relative to the 90 % quantile of the steps between packets
_MIN_SURPLUS = 5  # least number of packets beyond one per run or piece of it
# Largest deviation from the even clock, relative to the step, and to the mean length of packets if the motion
# confirms them; largest share of packets that are later.
_MAX_STEPS, _MAX_LENGTHS, _MAX_LATE = 1.0, 1.0, 0.1
_FIT_ROUNDS = 5
# Suspect steps: largest step, relative to the usual one; their least number and share, and the least share of
# others, which are no pauses.
_SUSPECT, _MIN_SUSPECT, _MIN_SUSPECT_SHARE, _MIN_USUAL_SHARE = 0.1, 5, 1e-3, 0.01
# Least advance of a motion in quick steps, relative to that in others and to its standard error; rows on both
# sides of a step that show the direction.
_ALIKE, _SIGNIFICANT, _MARGIN = 0.5, 3.0, 2


def spread_packets(time_s: FloatArray, run: IntArray, motions: FloatArray) -> FloatArray:
    """Replace time stamps of an evenly sampled recording that come in packets, or repeat, by its even clock.

    The last rows of packets, which were stamped on arrival, lie on a straight line over the row numbers. So
    do the first rows of equal times, which a coarse clock gives. Other time stamps are returned unchanged,
    also those of real bursts, in which the motion advances less than between them.

    Args:
        time_s: times, shape (n,) [s].
        run: run of each row, shape (n,), in blocks.
        motions: positions in any unit, shape (k, n).
    """
    steps_s, in_run = np.diff(time_s), np.diff(run) == 0
    if not in_run.any() or (steps_s[in_run] < 0.0).any():
        return time_s
    gaps_s = steps_s[in_run & (steps_s >= _WITHIN * _usual_step(steps_s[in_run]))]
    in_run &= steps_s <= _PAUSE * np.quantile(gaps_s, 0.9)
    relative = steps_s / max(float(np.mean(steps_s[in_run])), MIN_INCREASE_S)
    quick = in_run & (relative < _WITHIN)
    is_other = in_run & ~quick & (relative < _BETWEEN)
    if np.sum(quick) < _MIN_QUICK * np.sum(in_run) or np.sum(is_other) > _MAX_OTHER * np.sum(in_run):
        return time_s
    largest = _MAX_STEPS  # deviation [steps]
    if (steps_s[quick] > MIN_INCREASE_S).any():
        if not _advances_alike(quick, in_run & ~quick, motions):
            return time_s
        largest = max(largest, _MAX_LENGTHS * np.sum(in_run) / np.sum(in_run & ~quick))
    number = np.cumsum(np.append(0, ~in_run))  # of the run, or of its piece between pauses
    first, last = np.append(True, ~quick), np.append(~quick, True)
    begins, ends = np.append(True, ~in_run), np.append(~in_run, True)
    packet = np.cumsum(first)
    # A run may begin or end within a packet, whose first or last row is then missing.
    whole_first = first & (packet != packet[begins][number])
    whole_last = last & (packet != packet[ends][number])
    rows_in, whole = np.bincount(packet), np.intersect1d(packet[whole_first], packet[whole_last])
    if np.max(rows_in) > 2 * np.max(rows_in[whole], initial=1):
        return time_s
    for number_of_clock in (np.zeros_like(number), number):  # one clock, or one for each run
        clocks = (
            _fit_clock(time_s, number, number_of_clock, rows, ends, largest)
            for rows in (whole_first, whole_last)
        )
        fits = [clock for clock in clocks if clock is not None]
        if fits:
            return min(fits, key=lambda fit: fit[1])[0]
    return time_s


def note_uneven(time_s: FloatArray, run: IntArray, motions: FloatArray) -> str:
    """Return figures of steps that are short although the motion advances as in others; empty without them.

    Args:
        time_s: times, shape (n,) [s].
        run: run of each row, shape (n,), in blocks.
        motions: positions in any unit, shape (k, n).
    """
    steps_s, in_run = np.diff(time_s), np.diff(run) == 0
    quick = in_run & (steps_s < _SUSPECT * _usual_step(steps_s[in_run]))
    others, count = in_run & ~quick, np.sum(in_run)
    is_enough = np.sum(quick) >= _MIN_SUSPECT_SHARE * count and np.sum(others) >= _MIN_USUAL_SHARE * count
    if not is_enough or not _advances_alike(quick, others, motions):
        return ""
    return (
        f"{np.sum(quick)} of {count} steps take {np.median(steps_s[quick]):.3g} s and the other steps take "
        f"{np.median(steps_s[others]):.3g} s, but the motion advances equally far in all of them"
    )


def _usual_step(steps_s: FloatArray) -> float:
    """Return the median of the steps, weighted by their durations."""
    ordered = np.sort(steps_s)
    return float(ordered[np.searchsorted(np.cumsum(ordered), 0.5 * np.sum(ordered))])


def _advances_alike(quick: BoolArray, others: BoolArray, motions: FloatArray) -> bool:
    """Return whether a motion advances as far in quick steps as in others, apart from noise.

    The direction of the motion in a step is that between the two rows around it, whose noise is another.
    """
    if not len(motions) or motions.shape[1] <= 2 * _MARGIN + 1:
        return False
    quick, others = quick[_MARGIN:-_MARGIN], others[_MARGIN:-_MARGIN]
    if np.sum(quick) < _MIN_SUSPECT or not others.any():
        return False
    advance = np.diff(motions)[:, _MARGIN:-_MARGIN] * np.sign(
        motions[:, 2 * _MARGIN + 1 :] - motions[:, : -2 * _MARGIN - 1]
    )
    mean, std_err = advance[:, quick].mean(axis=1), advance[:, quick].std(axis=1) / np.sqrt(np.sum(quick))
    is_alike = (mean > _ALIKE * advance[:, others].mean(axis=1)) & (mean > _SIGNIFICANT * std_err)
    return bool(is_alike.any())


def _fit_clock(  # noqa: PLR0917
    time_s: FloatArray, run: IntArray, number: IntArray, rows: BoolArray, ends: BoolArray, largest: float
) -> tuple[FloatArray, float] | None:
    """Fit an even clock to rows; return the times of all rows and the deviation, or None if it is too large.

    Args:
        time_s: times, shape (n,) [s].
        run: run of each row from 0, shape (n,).
        number: clock of each row from 0, shape (n,); runs with the same clock share its step.
        rows: rows to which the clock is fitted; later ones are left out.
        ends: last row of each run; a run without a row in `rows` is placed by it.
        largest: largest deviation [steps].
    """
    index, chosen = np.arange(len(time_s), dtype=np.float64), rows
    for _ in range(_FIT_ROUNDS):
        at = chosen | (ends & (np.bincount(run, chosen)[run] == 0))
        count = np.bincount(run, at)
        if np.min(np.bincount(number, chosen) - np.bincount(number, ends)) < _MIN_SURPLUS:
            return None
        row, at_s = (x - (np.bincount(run, x * at) / count)[run] for x in (index, time_s))
        step_s = np.bincount(number, row * at_s * chosen) / np.bincount(number, row**2 * chosen)
        late = at_s / step_s[number] - row  # [steps]
        typical = max(largest, 3.0 * float(np.median(np.abs(late[chosen]))))
        before, chosen = chosen, rows & (late <= typical)
        if (before == chosen).all():
            break
    deviation = float(np.max(np.abs(late[chosen])))
    if deviation > largest or np.sum(chosen) < (1.0 - _MAX_LATE) * np.sum(rows):
        return None
    return time_s - late * step_s[number], deviation
