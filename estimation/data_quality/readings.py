"""Checks of readings: saturated, stuck, spiked or rectified."""

from collections.abc import Mapping

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.estimation.signals.runwise import apply_per_run
from palpate.estimation.statistics.least_squares import solve
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_STUCK_SHARE = 0.3  # share of loaded samples at one extreme value of a saturated sensor
_HELD_RANGE = 1e-3  # range of a held position, relative to all positions
# Free air at a sensor's lower end: how much of it, how far from zero (of all readings' range), and how many
# of the readings above are distinct.
_MOST_OF_AIR, _OFF_ZERO, _FINE = 0.7, 0.01, 0.5
# Readings in all, with which a sensor says little, or is coarse. Each edge between two of them tells one
# point of the curve: a straight one, bent by a damper, needs four to be seen to be right or wrong.
# A joint meets each edge in many states of motion, but a single edge gives no scale.
_TOO_FEW_LEVELS, _TOO_FEW_OF_A_JOINT, _FEW_LEVELS = 5, 3, 50
_LOADED = 0.3  # least effort of a loaded sample, relative to the largest
# Correlation of two runs' noise: by chance 5 / sqrt(n) at most. Of a copy to which noise was added, half as
# large as its own, 0.9.
_COPY, _EQUAL = 0.8, 1.0 - 1e-9
_SAME_PLACE = 0.05  # largest difference between copies of a run, relative to the range of positions
_FEWEST_TOLD = 40  # samples needed to compare the noise of two runs
_FEWEST_BENDS = 100  # second differences needed to tell noise from a lower limit of the sensor
# Share of second differences that turn against the one before: 0.73 in white noise, 0.67 in noise as slow as
# a random walk, and next to none in a formula's curves.
_TURNING = 0.6
_DIGITS = 1e-7  # relative noise below which it is rounding of numbers
# Times the usual second difference: what is larger is a corner of the motion, the same in each run that
# repeats it, and no noise.
_CORNER = 4.0
# Of the reader's steps, that half of the bends exceed: by chance, a reading is then the same in 1 of 3 cases.
# Rounding alone makes bends of 0 or 1.
_STEPS = 2.0


def unchanging(data: ChannelData) -> str | None:
    """Report the signal that never changes; None if both do.

    Args:
        data: the channel.
    """
    for what, signal in (("effort", data.effort), ("position", data.position)):
        if np.ptp(signal) <= 1e-12 * max(1.0, float(np.max(np.abs(signal)))):
            return f"the {what} never changes; check the sensor and the column"
    return None


def too_coarse(data: ChannelData) -> str | None:
    """Report readings that take too few values; None otherwise.

    Args:
        data: the channel.
    """
    levels = len(np.unique(data.effort))
    if levels < (_TOO_FEW_LEVELS if data.kind is ChannelKind.CONTACT else _TOO_FEW_OF_A_JOINT):
        return f"only {levels} different readings: the sensor's steps are too coarse for this effort"
    return None


def saturated(data: ChannelData) -> str | None:
    """Report where the effort exceeds the sensor's range; None if it does not.

    Args:
        data: the channel.
    """
    if len(np.unique(data.effort)) < _FEW_LEVELS:
        return None  # coarse steps, of which the last is often met
    size = np.abs(data.effort)
    loaded = size > _LOADED * size.max()
    for extreme in (data.effort.max(), data.effort.min()):
        stuck = data.effort == extreme
        share = float(np.mean(stuck[loaded]))
        moves = float(np.ptp(data.position[stuck])) > _HELD_RANGE * float(np.ptp(data.position))
        if share > _STUCK_SHARE and moves:  # in data without noise, a hold shows one reading too
            unit = data.kind.effort_unit
            return (
                f"{100 * share:.0f} % of the loaded samples show {extreme:.6g} {unit}: the sensor is "
                "saturated, and the true peak is unknown; repeat with less load or a larger range"
            )
    return None


def at_lower_end(data: ChannelData) -> BoolArray:
    """Select readings of a contact at the lower end of the sensor's range, which free air lies beyond.

    Readings there have one value other than zero, and noise above it. A dead band about zero reads zero; a
    sensor with coarse steps, and data without noise, may show one reading in free air.

    Args:
        data: the channel.

    Returns:
        Mask of shape (n,).
    """
    none = np.zeros(len(data), dtype=np.bool_)
    if data.kind is not ChannelKind.CONTACT or data.tare is not None or data.engaged.all():
        return none
    lowest = float(data.effort.min())
    stuck = np.asarray(data.effort == lowest)
    above = data.effort[~stuck]
    off_zero = abs(lowest) > _OFF_ZERO * float(np.ptp(data.effort))
    few_stuck = np.mean(stuck[~data.engaged]) < _MOST_OF_AIR
    if few_stuck or not off_zero or len(np.unique(above)) < _FINE * len(above):
        return none
    bends = np.diff(data.effort, 2)[~stuck[1:-1]]
    return stuck if len(bends) >= _FEWEST_BENDS and _turn_like_noise(bends) else none


def stuck_in_air(data: ChannelData) -> str | None:
    """Report free air beyond the sensor's lower end; None if there is none.

    Args:
        data: the channel.
    """
    stuck = at_lower_end(data)
    if not stuck.any():
        return None
    return (
        f"{100 * np.mean(stuck[~data.engaged]):.0f} % of free air shows exactly {data.effort.min():.6g} "
        f"{data.kind.effort_unit}, and no sample less: the sensor is at the lower end of its range, and such "
        "samples are left out; shift the range, or preload the sensor"
    )


@cache_by_channel_arrays("position", "effort", "run")
def copied_runs(data: ChannelData) -> dict[int, tuple[int, float]]:
    """Find runs that are copies of others, exactly or except for a small part of their noise.

    A copy that is held out adds no information, and a copy that is fitted makes intervals too narrow. Times
    may differ. No sensor with noise reads the same twice over a whole run, so second differences of two runs
    are uncorrelated if they are noise. Data without noise may repeat themselves, and so may a joint at rest
    with a coarse sensor.

    Args:
        data: the channel.

    Returns:
        For each copy the run that it is a copy of, and the correlation of their noise, 1 for equal numbers.
    """
    range_of_all = float(np.ptp(data.position)) if len(data) else 0.0
    of_length: dict[int, list[IntArray]] = {}
    for rows in rows_of_runs(data.run):
        effort = data.effort[rows]
        bends, steps = np.diff(effort, 2), np.diff(np.unique(effort))
        if np.ptp(data.position[rows]) <= _HELD_RANGE * range_of_all or len(bends) < 2 or len(steps) == 0:
            continue
        usual = float(np.median(np.abs(bends)))  # noise must be large enough that readings rarely repeat
        least = max(_STEPS * steps.min(), _DIGITS * float(np.sqrt(np.mean(effort**2))))
        if usual >= least and _turn_like_noise(bends):
            of_length.setdefault(len(rows), []).append(rows)
    copies: dict[int, tuple[int, float]] = {}
    for length, runs in of_length.items():
        bends = np.diff(data.effort[np.array(runs)], 2)
        corner = _CORNER * np.median(np.abs(bends), axis=1, keepdims=True)
        bends = np.clip(bends, -corner, corner)
        bends /= np.linalg.norm(bends, axis=1, keepdims=True)
        least = _COPY if length >= _FEWEST_TOLD else _EQUAL
        for number, rows in enumerate(runs):
            likeness = bends[:number] @ bends[number]
            for first in np.flatnonzero(likeness > least):
                largest_difference = np.max(np.abs(data.position[rows] - data.position[runs[first]]))
                if largest_difference < _SAME_PLACE * range_of_all:
                    copies[int(data.run[rows[0]])] = int(data.run[runs[first][0]]), float(likeness[first])
                    break
    return copies


def copied(copies: Mapping[int, tuple[int, float]]) -> str:
    """Describe the runs that are left out as copies; see `copied_runs`.

    Args:
        copies: original run and correlation of the noise, by the number of the copy.
    """
    (run, (first, likeness)), more = next(iter(copies.items())), len(copies) - 1
    further = f" (and {more} more)" if more else ""
    return (
        f"run {run} is a copy of run {first}{further}: {100.0 * likeness:.0f} % of its noise is the same, so "
        "it adds no information and is left out; record it again"
    )


def _turn_like_noise(bends: FloatArray) -> bool:
    """Check whether second differences (n,) alternate in sign as those of noise do."""
    return bool(np.mean(bends[1:] * bends[:-1] < 0.0) > _TURNING)


_FEWEST = 50  # readings within the noise of zero, none below it: by chance in 1 of 2^50 cases
# Of the readings in the farther half of that noise, that lie in the nearer. Folded noise is densest at zero:
# 1 and more, by chance 0.8; what thins out towards its least reading had 0.3, where there was enough of it.
_FLAT = 0.6
# Exactly zero, for each reading on the next step: folding lays two steps on that one and leaves zero alone,
# half; cutting lays on zero all that was below.
_MOST_ZEROS = 0.75
# Of a joint's readings, that are exactly zero: more than at a standstill. With fewer different ones than that
# zero is a step as any other.
_OFTEN, _FEWEST_VALUES = 0.3, 50
# Times the energy that a law leaves without a constant. What was cut off takes nothing from what is left: 1.0
# to 1.1, also beside an effect at ten times the noise. A dead band takes its width from all of it: 3 and
# more, less where a weight goes through so little of its turn that it looks like a constant.
_WITHOUT_CONSTANT = 1.5
_CLEAR = 4.0  # multiple of the noise above which no reading is rectified noise
_FOLDED = (
    "no reading is below zero, though {count} lie within the noise of zero, {noise:.2g} {unit}: "
    "the signal was rectified"
)
# converts the median second difference to the standard deviation of normal noise
_TO_SIGMA = 1.4826 / np.sqrt(6.0)


def rectified(data: ChannelData) -> str | None:
    """Report readings of a joint from a rectified signal, which loses half of the law.

    If an effort comes within its noise of zero, half of the readings should be below zero. If none is, and
    readings are as dense just above zero as farther up, they were folded there. If readings below zero were
    set to zero instead, the density falls towards zero.

    Args:
        data: the channel; a tare that was taken off is put back.

    Returns:
        One sentence, or None if they are not rectified.
    """
    if data.kind is ChannelKind.CONTACT:
        return None
    effort = _untared(data)
    if len(effort) == 0 or effort.min() < 0.0:
        return None
    zero = effort == 0.0
    if np.mean(zero) > _OFTEN and len(np.unique(effort)) >= _FEWEST_VALUES:
        # Readings that were cut off below zero are complete above it. A dead band that a torque of one sign
        # enters and leaves shows zeros as well, but then the hidden part is missing everywhere. The laws
        # tried are a weight at any tilt, and a weight with springs.
        q, v, target = data.position, data.velocity, effort[~zero]
        for springs in ([np.cos(q)], [q, q**3]):
            law = [np.sin(q), v, np.sign(v), data.acceleration, *springs, np.ones(len(q))]
            columns = np.column_stack(law)[~zero]
            without_constant, with_constant = (
                float(np.sum((target - regressors @ solve(regressors, target).gains) ** 2))
                for regressors in (columns[:, :-1], columns)
            )
            if without_constant <= _WITHOUT_CONSTANT * with_constant:
                return (
                    f"no reading is below zero, and {100 * np.mean(zero):.0f} % are exactly zero: was the "
                    "sign cut off? record the signal with its sign"
                )
    count, noise = _folded(effort, data.run)
    reason = _FOLDED.format(count=count, noise=noise, unit=data.kind.effort_unit)
    return f"{reason}; record it with its sign" if count else None


def folded_in_contact(data: ChannelData) -> BoolArray:
    """Select readings of a contact near zero whose noise the sensor rectified.

    An object can only push, so a converter that cuts off below zero removes only the noise of free air.
    Folded noise has a mean above zero, which would look like a bias.

    Args:
        data: the channel.

    Returns:
        Mask of shape (n,).
    """
    effort = _untared(data)
    if data.kind is not ChannelKind.CONTACT or len(effort) == 0 or effort.min() < 0.0:
        return np.zeros(len(data), dtype=np.bool_)
    count, noise = _folded(effort, data.run)
    return np.asarray(effort <= _CLEAR * noise) if count else np.zeros(len(data), dtype=np.bool_)


def folded(data: ChannelData) -> str | None:
    """Report rectified readings of a contact near zero; None without them.

    Args:
        data: the channel.
    """
    near = folded_in_contact(data)
    if not near.any():
        return None
    count, noise = _folded(_untared(data), data.run)
    reason = _FOLDED.format(count=count, noise=noise, unit=data.kind.effort_unit)
    share = f"{100 * np.mean(near):.0f} % of the samples, up to {_CLEAR:.0f} times that, are left out"
    return f"{reason}, and {share}; record it with its sign"


def _untared(data: ChannelData) -> FloatArray:
    """The effort (n,) before the tare was subtracted."""
    return data.effort if data.tare is None else data.effort + data.tare.of(data.run)


def _folded(effort: FloatArray, run: IntArray) -> tuple[int, float]:
    """Number of readings (n,) within the noise of zero, and the noise; 0 if they are not rectified."""
    bends = apply_per_run(lambda values: np.pad(np.diff(values, 2), 1)[: len(values)], effort, run)
    noise = _TO_SIGMA * float(np.median(np.abs(bends)))
    near = effort[(effort > 0.0) & (effort <= noise)]
    if len(near) == 0 or noise < 2.0 * near.min():
        return 0, noise  # steps too coarse to say how dense they lie
    step = float(near.min())
    half = step * (np.floor(0.5 * noise / step) + 0.5)  # as many steps in the nearer half as in the farther
    inner = int(np.count_nonzero(near <= half))
    outer = int(np.count_nonzero((effort > half) & (effort <= 2.0 * half - 0.5 * step)))
    zeros, next_to_zero = np.count_nonzero(effort == 0.0), np.count_nonzero(near < 1.5 * step)
    is_folded = inner >= _FLAT * outer and zeros <= _MOST_ZEROS * next_to_zero and len(near) >= _FEWEST
    return len(near) if is_folded else 0, noise
