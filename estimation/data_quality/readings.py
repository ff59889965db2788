"""Checks for readings that are saturated, stuck, copied or rectified."""

from collections.abc import Mapping

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.estimation.signals.motion import is_stepwise_command
from palpate.estimation.signals.runwise import apply_per_run
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_STUCK_SHARE = 0.3  # least share of loaded samples at one extreme value of a saturated sensor
_HELD_RANGE = 1e-3  # largest range of a held position, relative to the range of all positions
# Free air at a sensor's lower limit: least share of free air at the limit, least distance of the limit from
# zero (relative to the range of readings), and least share of distinct readings above it.
_MIN_AT_LIMIT, _MIN_LIMIT, _MIN_DISTINCT = 0.7, 0.01, 0.5
# Least number of distinct readings of a contact and of a joint, and the number below which a sensor counts as
# coarse. Each edge between two readings gives one point of the force curve; four points are needed to test a
# spring with a damper. A joint crosses each edge in many states of motion, but one edge gives no scale.
_MIN_LEVELS, _MIN_JOINT_LEVELS, _COARSE_LEVELS = 5, 3, 50
_LOADED = 0.3  # least effort of a loaded sample, relative to the largest
# Least noise correlation of a copied run, and of an exact copy. Chance correlations reach 5 / sqrt(n). A copy
# with added noise of half its own noise level has 0.9.
_COPIED, _IDENTICAL = 0.8, 1.0 - 1e-9
_MAX_DIFFERENCE = 0.05  # largest difference between copies of a run, relative to the range of positions
_MIN_COMPARED = 40  # samples needed to compare the noise of two runs
# Least number of samples in which a run changes, so that equal readings in all samples are no coincidence.
_MIN_CHANGES = 40
_SAME_SPEED = 1e-3  # largest velocity difference of equal runs, relative to the range of velocities
_MIN_FREE = 20  # samples in free air needed to state the share of one reading
_MIN_BENDS = 100  # second differences needed to tell noise from a lower limit of the sensor
# Least share of sign changes between consecutive second differences of noise: 0.73 in white noise, 0.67 in a
# random walk, and almost none in a smooth curve.
_MIN_TURNS = 0.6
_ROUNDING = 1e-7  # relative noise below which it is only rounding of numbers
# Ratio to the median second difference above which a second difference is a corner of the motion. Repeated
# motions share such corners, so they are excluded from the noise.
_CORNER = 4.0
# Least median second difference, in steps of the readings, so that readings coincide by chance in only one of
# three cases. Rounding alone gives second differences of 0 or 1 step.
_MIN_STEPS = 2.0


def unchanging(data: ChannelData) -> str | None:
    """Report an effort or a position that never changes; None if both change.

    Args:
        data: the channel; ranges up to 1e-12 of the largest value, or 1e-12 in SI units, are rounding.
    """
    for name, signal in (("effort", data.effort), ("position", data.position)):
        if np.ptp(signal) <= 1e-12 * max(1.0, float(np.max(np.abs(signal)))):
            return f"the {name} never changes; check the sensor and the column"
    return None


def too_coarse(data: ChannelData) -> str | None:
    """Report an effort with too few distinct readings; None otherwise, and for a stepwise command.

    Args:
        data: the channel; a contact needs five distinct readings, a joint three.
    """
    levels = len(np.unique(data.effort))
    least = _MIN_LEVELS if data.kind is ChannelKind.CONTACT else _MIN_JOINT_LEVELS
    if levels < least and not is_stepwise_command(data):
        return f"only {levels} different readings, so the sensor's steps are too coarse for this effort"
    return None


def saturated(data: ChannelData, model: Model | None = None) -> str | None:
    """Report a sensor that saturates; None if it does not.

    Args:
        data: the channel.
        model: the base model; without free parameters it predicts the effort beyond the sensor's range, so
            that saturation is not a fault.
    """
    is_fixed = model is not None and not (model.gains or model.inner)
    if is_fixed or len(np.unique(data.effort)) < _COARSE_LEVELS:  # it often reads its extreme value
        return None
    size = np.abs(data.effort)
    loaded = size > _LOADED * size.max()
    for extreme in (data.effort.max(), data.effort.min()):
        stuck = data.effort == extreme
        share = float(np.mean(stuck[loaded]))
        is_moving = float(np.ptp(data.position[stuck])) > _HELD_RANGE * float(np.ptp(data.position))
        if share > _STUCK_SHARE and is_moving:  # data without noise also have constant readings in a hold
            unit = data.effort_unit
            return (
                f"{100 * share:.0f} % of the loaded samples show {extreme:.6g} {unit}: the sensor is "
                "saturated, and the true peak is unknown; repeat with less load or a larger range"
            )
    return None


def at_lower_end(data: ChannelData) -> BoolArray:
    """Return the mask (n,) of contact readings at a lower limit of the sensor above the force in free air.

    Such readings have one value other than zero, with noise above it. A dead band reads zero instead. A
    coarse sensor, or data without noise, may also show a single reading in free air; neither is selected.

    Args:
        data: the channel.
    """
    none = np.zeros(len(data), dtype=np.bool_)
    if data.kind is not ChannelKind.CONTACT or data.tare is not None or data.engaged.all():
        return none
    lowest = float(data.effort.min())
    stuck = np.asarray(data.effort == lowest)
    above = data.effort[~stuck]
    off_zero = abs(lowest) > _MIN_LIMIT * float(np.ptp(data.effort))
    few_stuck = np.sum(~data.engaged) < _MIN_FREE or np.mean(stuck[~data.engaged]) < _MIN_AT_LIMIT
    if few_stuck or not off_zero or len(np.unique(above)) < _MIN_DISTINCT * len(above):
        return none
    bends = np.diff(data.effort, 2)[~stuck[1:-1]]
    return stuck if len(bends) >= _MIN_BENDS and _is_noise(bends) else none


def stuck_in_air(data: ChannelData) -> str | None:
    """Report free air below the sensor's lower limit; None if there is none."""
    stuck = at_lower_end(data)
    if not stuck.any():
        return None
    return (
        f"{100 * np.mean(stuck[~data.engaged]):.0f} % of the samples in free air are exactly "
        f"{data.effort.min():.6g} {data.effort_unit}, and none is lower, so the sensor is at the lower end "
        "of its range. Such samples are left out; shift the range, or preload the sensor"
    )


@cache_by_channel_arrays("time_s", "position", "effort", "run")
def copied_runs(data: ChannelData) -> dict[int, tuple[int, float | None]]:
    """Find runs that are copies of others, exactly or except for a small part of their noise.

    A held-out copy adds no information, and a fitted copy makes intervals too narrow. Times may differ.
    Noise does not repeat, so the second differences of two runs are uncorrelated unless one is a copy. Runs
    without noise are copies if position and effort are equal in every sample, to the last digit: even if
    such a motion was repeated, the repeat adds no information. A joint at rest with a coarse sensor may
    repeat its readings and is not compared.

    Args:
        data: the channel.

    Returns:
        Original run and correlation of the noise (1 for equal numbers, None without noise), by the number of
        the copy.
    """
    span = float(np.ptp(data.position)) if len(data) else 0.0
    by_length: dict[int, list[IntArray]] = {}
    for rows in rows_of_runs(data.run):
        effort = data.effort[rows]
        bends, steps = np.diff(effort, 2), np.diff(np.unique(effort))
        if np.ptp(data.position[rows]) <= _HELD_RANGE * span or len(bends) < 2 or len(steps) == 0:
            continue
        typical = float(np.median(np.abs(bends)))  # must be large enough that readings rarely repeat
        least = max(_MIN_STEPS * steps.min(), _ROUNDING * float(np.sqrt(np.mean(effort**2))))
        if typical >= least and _is_noise(bends):
            by_length.setdefault(len(rows), []).append(rows)
    copies: dict[int, tuple[int, float | None]] = {
        copy: (first, None) for copy, first in _equal_runs(data).items()
    }
    for length, runs in by_length.items():
        time_s, effort = data.time_s[np.array(runs)], data.effort[np.array(runs)]
        steps_s, span_s = np.diff(time_s), time_s[:, 2:] - time_s[:, :-2]
        between = (effort[:, :-2] * steps_s[:, 1:] + effort[:, 2:] * steps_s[:, :-1]) / span_s
        # Uneven times also bend a smooth effort, and may repeat; so do their errors.
        of_order, of_time = _unit_noise(np.diff(effort, 2)), _unit_noise(effort[:, 1:-1] - between)
        least = _COPIED if length >= _MIN_COMPARED else _IDENTICAL
        for number, rows in enumerate(runs):
            match = np.minimum(of_order[:number] @ of_order[number], of_time[:number] @ of_time[number])
            for first in np.flatnonzero(match > least):
                largest_difference = np.max(np.abs(data.position[rows] - data.position[runs[first]]))
                if largest_difference < _MAX_DIFFERENCE * span:
                    copies[int(data.run[rows[0]])] = int(data.run[runs[first][0]]), float(match[first])
                    break
    return copies


def _equal_runs(data: ChannelData) -> dict[int, int]:
    """Find moving runs whose readings equal those of an earlier run in every sample; see `copied_runs`.

    The velocities must agree as well: a simulated spring has the same readings at every speed.
    """
    span = float(np.ptp(data.position)) if len(data) else 0.0
    largest_difference = _SAME_SPEED * float(np.ptp(data.velocity)) if len(data) else 0.0
    first_runs: dict[bytes, list[IntArray]] = {}
    equal: dict[int, int] = {}
    for rows in rows_of_runs(data.run):
        position, effort = data.position[rows], data.effort[rows]
        changes = np.count_nonzero((np.diff(position) != 0.0) | (np.diff(effort) != 0.0))
        if np.ptp(position) <= _HELD_RANGE * span or np.ptp(effort) == 0.0 or changes < _MIN_CHANGES:
            continue
        # Adding zero turns -0.0 into 0.0, which have different bytes.
        same_readings = first_runs.setdefault((position + 0.0).tobytes() + (effort + 0.0).tobytes(), [])
        for first in same_readings:
            if np.max(np.abs(data.velocity[rows] - data.velocity[first])) <= largest_difference:
                equal[int(data.run[rows[0]])] = int(data.run[first[0]])
                break
        else:
            same_readings.append(rows)
    return equal


def _unit_noise(bends: FloatArray) -> FloatArray:
    """Limit corners of a motion in second differences of runs (r, n), and scale each run to length 1."""
    corner = _CORNER * np.median(np.abs(bends), axis=1, keepdims=True)
    bends = np.clip(bends, -corner, corner)
    return np.asarray(bends / np.maximum(np.linalg.norm(bends, axis=1, keepdims=True), 1e-300))


def copied(copies: Mapping[int, tuple[int, float | None]]) -> str:
    """Describe the runs that are excluded as copies; see `copied_runs`.

    Args:
        copies: original run and correlation of the noise (None without noise), by the number of the copy.
    """
    (run, (first, match)), count = next(iter(copies.items())), len(copies) - 1
    others = f" (one of {len(copies)} copies)" if count else ""
    same = "all of its readings are" if match is None else f"{100.0 * match:.0f} % of its noise is"
    remedy = ", or vary the motion of a simulation" if match is None else ""
    return (
        f"run {run} is a copy of run {first}{others}: {same} the same, so run {run} adds no information and "
        f"is left out; record it again{remedy}"
    )


def _is_noise(bends: FloatArray) -> bool:
    """Return whether second differences (n,) change sign as often as those of noise."""
    return bool(np.mean(bends[1:] * bends[:-1] < 0.0) > _MIN_TURNS)


_MIN_NEAR = 50  # least number of readings within the noise of zero; by chance none is negative once in 2^50
# Least ratio of the numbers of readings in the nearer and the farther half of that noise. Folded noise is
# densest at zero: the ratio is at least 1, by chance 0.8. Unfolded readings that thin out toward their
# minimum reached 0.3.
_MIN_RATIO = 0.6
# Largest ratio of readings that are exactly zero to readings at the next step. Folding maps two steps onto
# the next step and only one onto zero, which gives one half. Clipping maps all readings below zero onto zero.
_MAX_ZEROS = 0.75
# Least share of a joint's readings that are exactly zero, more than at rest, and least number of distinct
# readings, below which zero is a step like any other.
_MIN_ZEROS, _MIN_VALUES = 0.3, 50
# Least ratio of the residual energies of a law without and with a constant that indicates a dead band.
# Clipping does not change the remaining readings: 1.0 to 1.1, also with an effect of ten times the noise. A
# dead band subtracts its width everywhere: 3 or more, or less if the weight hardly turns and looks constant.
_MIN_GAIN = 1.5
# Largest ratio of the residual energies of a law for an effort whose sign was lost and of the same law for
# the effort as recorded: 0.002 for such efforts, 1 or more for others; most corrections of the signs.
_MAX_MAGNITUDE_ERROR, _MAX_SIGN_STEPS = 0.1, 20
_CLEAR = 4.0  # multiple of the noise above which no reading is rectified noise
_MOVES = 0.1  # least speed of a moving joint, relative to the largest
_MIN_WAY, _ALIKE = 0.1, 0.3  # least share of samples in the rarer direction, and ratio of the mean efforts
_FOLDED = (
    "no reading is below zero although {count} lie within the noise ({noise:.2g} {unit}) of zero, so the "
    "signal was rectified"
)
# Converts the median second difference to the standard deviation of normal noise.
_TO_SIGMA = MAD_TO_SIGMA / np.sqrt(6.0)


def rectified(data: ChannelData) -> str | None:
    """Report a joint whose effort was rectified or clipped at zero, so that its sign is lost.

    If an effort comes within its noise of zero, half of the readings there should be negative. If none is,
    and the readings are as dense just above zero as farther up, they were folded (absolute values). If many
    readings are exactly zero instead, the negative ones were clipped.

    Args:
        data: the channel; a subtracted tare is added again.

    Returns:
        One sentence, or None if the readings are not rectified.
    """
    if data.kind is ChannelKind.CONTACT:
        return None
    effort = _untared(data)
    if len(effort) == 0 or effort.min() < 0.0:
        return None
    is_zero = effort == 0.0
    if np.mean(is_zero) > _MIN_ZEROS and len(np.unique(effort)) >= _MIN_VALUES:
        # Clipping at zero does not change positive readings. A dead band also causes zeros, but it reduces
        # all readings by its width. The fitted laws are a weight at any tilt, and a weight with springs.
        q, v, target = data.position, data.velocity, effort[~is_zero]
        for springs in ([np.cos(q)], [q, q**3]):
            law = [np.sin(q), v, np.sign(v), data.acceleration, *springs, np.ones(len(q))]
            columns = np.column_stack(law)[~is_zero]
            without_constant, with_constant = (
                float(np.sum((target - regressors @ solve(regressors, target)) ** 2))
                for regressors in (columns[:, :-1], columns)
            )
            if without_constant <= _MIN_GAIN * with_constant:
                return (
                    f"no reading is below zero, and {100 * np.mean(is_zero):.0f} % are exactly zero, so "
                    "negative readings were probably cut off; record the signal with its sign"
                )
    count, noise = _count_folded(effort, data.run)
    if not count and _is_magnitude(effort, data):
        return (
            "no reading is below zero, but the effort fits the motion only with changing signs. The effort "
            "was therefore recorded as an absolute value; record it with its sign"
        )
    reason = _FOLDED.format(count=count, noise=noise, unit=data.effort_unit)
    return f"{reason}; record the effort with its sign" if count else None


def _is_magnitude(effort: FloatArray, data: ChannelData) -> bool:
    """Return whether a law of the motion fits the effort (n,) of a joint only as the size of a signed effort.

    The signs are first those of the velocity, since a joint dissipates energy, and then those of the fit.
    """
    q, v = data.position, data.velocity
    law = np.column_stack(
        [np.sin(q), np.cos(q), np.vander(q, 4), v, np.sign(v), v * np.abs(v), data.acceleration]
    )
    as_recorded, sign = effort - law @ solve(law, effort), np.sign(v)
    for _ in range(_MAX_SIGN_STEPS):
        fitted = law @ solve(law, sign * effort)
        before, sign = sign, np.sign(fitted)
        if np.array_equal(sign, before):
            break
    error = np.mean((effort - np.abs(fitted)) ** 2)
    return bool(error < _MAX_MAGNITUDE_ERROR * np.mean(as_recorded**2))


def unsigned(data: ChannelData) -> str | None:
    """Report a joint's effort that may be an absolute value: similar both ways, never negative.

    Args:
        data: the channel; a subtracted tare is added again.
    """
    effort, speed = _untared(data), np.abs(data.velocity)
    if data.kind is ChannelKind.CONTACT or len(effort) == 0 or effort.min() != 0.0:
        return None
    moving = speed > _MOVES * float(speed.max())
    ways = [effort[moving & (np.sign(data.velocity) == side)] for side in (1.0, -1.0)]
    if min(map(len, ways)) < max(_MIN_WAY * np.count_nonzero(moving), 1):
        return None
    weaker, stronger = sorted(float(np.mean(way)) for way in ways)
    if weaker < _ALIKE * stronger:
        return None
    return (
        "no reading is below zero, although the joint moves both ways; if the effort is an absolute value, "
        "as some drives report their current, record the effort with its sign"
    )


def folded_in_contact(data: ChannelData) -> BoolArray:
    """Return the mask (n,) of contact readings near zero whose noise was rectified.

    An object can only push, so rectification affects only the noise in free air. Folded noise has a positive
    mean, which would look like a bias.

    Args:
        data: the channel.
    """
    effort = _untared(data)
    if data.kind is not ChannelKind.CONTACT or len(effort) == 0 or effort.min() < 0.0:
        return np.zeros(len(data), dtype=np.bool_)
    count, noise = _count_folded(effort, data.run)
    return np.asarray(effort <= _CLEAR * noise) if count else np.zeros(len(data), dtype=np.bool_)


def folded(data: ChannelData) -> str | None:
    """Report rectified readings of a contact near zero; None without them.

    Args:
        data: the channel; see `folded_in_contact` for the readings, to which a subtracted tare is added
            again.
    """
    near = folded_in_contact(data)
    if not near.any():
        return None
    count, noise = _count_folded(_untared(data), data.run)
    reason = _FOLDED.format(count=count, noise=noise, unit=data.effort_unit)
    share = (
        f"{100 * np.mean(near):.0f} % of the samples, those below {_CLEAR:.0f} times this noise, are left out"
    )
    return f"{reason}, and {share}; record the effort with its sign"


def _untared(data: ChannelData) -> FloatArray:
    """Return the effort (n,) before the tare was subtracted."""
    return data.effort if data.tare is None else data.effort + data.tare.of(data.run)


def _count_folded(effort: FloatArray, run: IntArray) -> tuple[int, float]:
    """Return the number of readings within the noise of zero (0 if they are not rectified) and the noise."""
    bends = apply_per_run(lambda values: np.pad(np.diff(values, 2), 1)[: len(values)], effort, run)
    noise = _TO_SIGMA * float(np.median(np.abs(bends)))
    near = effort[(effort > 0.0) & (effort <= noise)]
    if len(near) == 0 or noise < 2.0 * near.min():
        return 0, noise  # the steps are too coarse to determine the density
    step = float(near.min())
    half = step * (np.floor(0.5 * noise / step) + 0.5)  # both halves contain equally many steps
    inner = int(np.count_nonzero(near <= half))
    outer = int(np.count_nonzero((effort > half) & (effort <= 2.0 * half - 0.5 * step)))
    zeros, next_to_zero = np.count_nonzero(effort == 0.0), np.count_nonzero(near < 1.5 * step)
    is_folded = inner >= _MIN_RATIO * outer and zeros <= _MAX_ZEROS * next_to_zero and len(near) >= _MIN_NEAR
    return len(near) if is_folded else 0, noise
