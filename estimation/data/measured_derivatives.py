"""Make angles continuous, and check velocities and accelerations against the motion."""

import numpy as np

from palpate.estimation.signals.blocks import blocks
from palpate.estimation.signals.runwise import sample_time
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.types import FloatArray, IntArray

_SAME_SHAPE = 0.7  # least correlation (half of the variance) for a velocity of this position at any scale
_UNRELATED = 0.5  # largest correlation of a velocity with another motion
_CLEAR_MOTION = 20.0  # least range of a position that moves, in standard deviations of its steps
_OTHER_SCALE = 1.5  # least ratio of a wrong unit: smoothing changes a velocity by less than a third
_SPANS = tuple(2**power for power in range(12))  # numbers of samples over which the two are compared
_PAUSE = 5.0  # ratio to the usual step above which sampling paused
_MIN_SPANS = 0.5  # least share of the samples at which a span begins
_HALVES = (1, 2, 3, 4, 5, 8, 10, 16, 32)  # number of samples on each side of a central difference
_REACHES = (*((half, half) for half in _HALVES), (1, 0), (0, 1))  # central, backward and forward
# Least size of a jump and largest range of an angle that is measured within one turn, in turns; largest other
# step; largest bend of the motion at a jump, in turns and relative to the largest bend elsewhere.
_JUMP, _ONE_TURN, _MAX_STEP, _SMALL_BEND, _MAX_BEND = 0.75, 1.01, 0.25, 1e-3, 3.0
_DIFFERENCE_NOISE = 0.5  # largest squared deviation from a finite difference, relative to its noise


def unwrap_angle(
    position: FloatArray, piece: IntArray, run: IntArray, turn: float, count: float = 0.0
) -> tuple[FloatArray | None, int, float]:
    """Make an angle that is measured within one turn continuous; also return the jumps' number and size.

    The angle is None if the motion at the jumps is less smooth than elsewhere, as in isolated wrong readings,
    or if other steps are so large that the direction of a jump is uncertain.

    Args:
        position: angle, shape (n,).
        piece: number of the smooth motion that each sample belongs to, shape (n,).
        run: run number of each sample, shape (n,).
        turn: size of one turn, in the unit of the angle.
        count: size of one count of an encoder if `turn` is only known to 1 %; the turn is then taken from the
            jumps, in whole counts.
    """
    steps, inside = np.diff(position), np.diff(piece) == 0
    jumps = inside & (np.abs(steps) > _JUMP * turn)
    if not jumps.any() or np.ptp(position) > _ONE_TURN * turn:
        return position, 0, turn
    if count:
        usual = np.append(0.0, steps[:-1])[jumps]
        turn = count * round(float(np.median(np.abs(steps[jumps] - usual))) / count)
    moves = steps - turn * np.round(steps / turn)
    change = np.where(inside[1:] & inside[:-1], np.abs(np.diff(moves)), np.inf)
    bend = np.minimum(np.append(change, np.inf), np.append(np.inf, change))
    largest = float(np.max(bend[inside & ~jumps & np.isfinite(bend)], initial=0.0))
    is_smooth = bend[jumps].max() <= max(_SMALL_BEND * turn, _MAX_BEND * largest)
    if not is_smooth or np.abs(moves[inside]).max() > _MAX_STEP * turn:
        return None, int(np.sum(jumps)), turn
    parts = [np.unwrap(position[rows], period=turn) for rows in blocks(run)]
    return np.concatenate(parts), int(np.sum(jumps)), turn


def mistaken_scale(
    time_s: FloatArray, position: FloatArray, velocity: FloatArray, run: IntArray
) -> float | None:
    """Return the ratio of a measured velocity to the slope of the position if it is wrong, else None.

    The ratio is NaN if the velocity is unrelated to a position that clearly moves.

    The function compares changes of position with integrals of the velocity over the time span at which they
    correlate most. Long spans reduce the influence of encoder steps and noise. Short spans reduce the
    influence of the integrated velocity error. The result is None for a joint at rest. Spans across a pause
    in sampling are excluded.

    Args:
        time_s: times, shape (n,) [s].
        position: position, shape (n,).
        velocity: measured velocity, shape (n,).
        run: run number of each sample, shape (n,).
    """
    steps_s = np.diff(time_s)
    breaks = (np.diff(run) != 0) | (steps_s > _PAUSE * sample_time(time_s, run))
    piece = np.concatenate([[0], np.cumsum(breaks)])
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    led = np.concatenate([[0.0], np.cumsum(np.where(np.diff(piece) == 0, mean * steps_s, 0.0))])
    best, ratio, likeness = 0.0, 1.0, 0.0
    for samples in _SPANS:
        same = piece[samples:] == piece[:-samples]
        if np.sum(same) < _MIN_SPANS * len(position):
            break
        moved, by_velocity = ((x[samples:] - x[:-samples])[same] for x in (position, led))
        correlation = correlation_coefficient(moved, by_velocity)
        if abs(correlation) > best:
            best, ratio = abs(correlation), float(by_velocity @ by_velocity) / float(moved @ by_velocity)
        size = float(np.linalg.norm(moved) * np.linalg.norm(by_velocity))
        # At constant speed, changes are equal, and their correlation is that of rounding errors.
        likeness = max(likeness, best, abs(float(moved @ by_velocity)) / size if size > 0.0 else 0.0)
    if likeness < _UNRELATED and np.ptp(position) > _CLEAR_MOTION * np.std(np.diff(position)[~breaks]):
        return np.nan
    is_mistaken = best > _SAME_SHAPE and not 1.0 / _OTHER_SCALE < ratio < _OTHER_SCALE
    return ratio if is_mistaken else None


def is_difference(
    time_s: FloatArray, position: FloatArray, given: FloatArray, wide_derivative: FloatArray, run: IntArray
) -> bool:
    """Return whether a derivative has the noise of a finite difference of the positions.

    Such a column contains no information beyond the positions and is noisier than necessary: a central
    difference (such as `numpy.gradient`) contains the errors of two readings. A column is no difference if
    the positions are closer to its integral by the trapezoidal rule, since they are then derived from it.

    Args:
        time_s: times, shape (n,) [s].
        position: position or another signal, shape (n,).
        given: derivative of the signal in the file, shape (n,).
        wide_derivative: derivative of the signal by windows as wide as the motion allows, shape (n,).
        run: run number of each sample, shape (n,).
    """
    if not np.ptp(given) > 0.0:  # a joint at rest
        return False
    inside = (np.diff(run) == 0) & (np.diff(time_s) > 0.0)
    slopes = np.diff(position)[inside] / np.diff(time_s)[inside]
    from_integral = np.mean((slopes - 0.5 * (given[1:] + given[:-1])[inside]) ** 2)
    at = np.arange(len(position))
    first, last = np.empty_like(at), np.empty_like(at)
    for rows in blocks(run):
        first[rows], last[rows] = rows.start, rows.stop - 1
    for back, ahead in _REACHES:  # differences within each run, over shorter spans at its ends
        before, after = np.maximum(at - back, first), np.minimum(at + ahead, last)
        apart_s = time_s[after] - time_s[before]
        moved = position[after] - position[before]
        difference = np.divide(moved, apart_s, out=np.zeros_like(moved), where=apart_s > 0.0)
        noise = np.mean((difference - wide_derivative) ** 2)
        if np.mean((difference - given) ** 2) < min(_DIFFERENCE_NOISE * noise, from_integral):
            return True
    return False
