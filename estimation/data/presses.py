"""Separate the presses in a recording, find their phases, and determine the sign of compression."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from palpate.control.loop.task import Phase
from palpate.estimation.signals.blocks import blocks
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

FEWEST_ROWS = 20  # rows of a detected run: a press, or a block of equal numbers
MOST_RUNS = 500  # runs that presses are cut into; of more, several form one run
# of the usual range of the force: a press goes from below the one above the other
_PRESSED, _RELEASED = 0.1, 0.05
_SIGMAS = (8.0, 4.0)  # thresholds in standard deviations of the noise, if larger
_TO_SIGMA = 1.4826 / np.sqrt(2.0)  # converts the median step between neighbours to sigma of normal noise
_FEW = 0.02  # share of samples in free air that determine a baseline
_AIR = 0.1  # rise of the force in free air between two presses, relative to the lower press


@dataclass(frozen=True)
class Levels:
    """Force levels [N] that separate a press from free air."""

    pressed: float  # above it something is pressed
    released: float  # below it nothing is
    free: float  # in free air


def force_levels(force: FloatArray, displacement: FloatArray) -> Levels:
    """Estimate the force levels of a contact.

    Args:
        force: shape (n,), positive in compression.
        displacement: shape (n,), positive into the object.
    """
    outside = displacement <= 0.0
    free = force[outside] if np.mean(outside) > _FEW else force
    base = float(np.median(free) if free is not force else np.quantile(force, _FEW))
    span = float(np.quantile(force, 0.98)) - base
    noise = _TO_SIGMA * float(np.median(np.abs(np.diff(force)))) if len(force) > 1 else 0.0
    return Levels(
        base + max(_PRESSED * span, min(_SIGMAS[0] * noise, 0.5 * span)),
        base + max(_RELEASED * span, min(_SIGMAS[1] * noise, 0.25 * span)),
        base,
    )


def restarts(time_s: FloatArray) -> IntArray:
    """Number the recordings at restarts of a clock, shape (n,); all 0 without a restart.

    Args:
        time_s: shape (n,), in the order of the file [s].
    """
    back = np.flatnonzero(np.diff(time_s) < 0.0) + 1
    if not len(back):
        return np.zeros(len(time_s), dtype=np.int64)
    step_s = float(np.median(np.diff(time_s)))
    anew = np.abs(time_s[back] - time_s[0]) <= 2.0 * max(step_s, 0.0)
    number = np.zeros(len(time_s), dtype=np.int64)
    number[back] = 1
    return np.cumsum(number) if anew.all() else np.zeros(len(time_s), dtype=np.int64)


def cut_presses(force: FloatArray, displacement: FloatArray, piece: IntArray) -> tuple[IntArray, int]:
    """Cut runs in the middle of the free air between presses; also return the presses per run.

    Args:
        force: shape (n,), positive in compression.
        displacement: shape (n,), positive into the object.
        piece: number of the separate recording of each sample, shape (n,).
    """
    levels, peaks = force_levels(force, displacement), list[int]()
    for rows in blocks(piece):  # the largest force between a rise above the one level and the next
        sides = np.where(force[rows] > levels.pressed, 1, np.where(force[rows] < levels.released, -1, 0))
        decided = np.flatnonzero(sides)
        if len(decided):
            is_rise = (sides[decided] > 0) & np.append(True, sides[decided][:-1] < 0)
            begins = rows.start + decided[is_rise]
            ends = np.append(begins, rows.stop)[1:]
            peaks += [a + int(np.argmax(force[a:b])) for a, b in zip(begins, ends, strict=True)]
    tops = peaks[:1]
    for peak in peaks[1:]:  # only after the displacement came back: a force may rise twice in one press
        back = displacement[tops[-1]] - displacement[tops[-1] : peak].min(initial=np.inf)
        if back > _RELEASED * np.ptp(displacement):
            tops.append(peak)
    presses = max(1, -(-len(tops) // MOST_RUNS))
    return _cut_between(force, piece, np.array(tops, dtype=np.int64), FEWEST_ROWS, presses), presses


def cut_into(
    force: FloatArray, displacement: FloatArray, piece: IntArray, count: int, where: str
) -> IntArray:
    """Cut a recording into a given number of presses: those that start farthest from the object.

    Args:
        force: shape (n,), positive in compression.
        displacement: shape (n,), positive into the object.
        piece: number of the separate recording of each sample, shape (n,).
        count: number of presses that the user states.
        where: file and option, for the error.

    Raises:
        InputError: there are fewer presses.
    """
    from scipy.signal import find_peaks, peak_prominences  # noqa: PLC0415, slow to import

    depth = np.asarray(scipy.ndimage.median_filter(displacement, 5))
    padded = np.pad(depth, 1, constant_values=depth.min())
    peaks = find_peaks(padded)[0]
    way = peak_prominences(padded, peaks)[0]
    pressed = (
        np.asarray(scipy.ndimage.median_filter(force, 5))[peaks - 1]
        > force_levels(force, displacement).released
    )
    is_press = pressed & (way > _RELEASED * np.ptp(depth))
    tops = np.sort(peaks[is_press][np.argsort(way[is_press])[::-1][:count]]) - 1
    run = _cut_between(force, piece, tops, 1) if len(tops) else piece
    if run[-1] + 1 != count:
        presses = f"{run[-1] + 1} press{'es' if run[-1] else ''}"
        raise InputError(f"{where}: {presses} can be separated at most")
    return run


def _cut_between(
    force: FloatArray, piece: IntArray, tops: IntArray, fewest: int, presses: int = 1
) -> IntArray:
    border = np.zeros(len(force), dtype=np.int64)
    border[1:] = np.diff(piece) != 0
    for first, second in list(pairwise(tops.tolist()))[presses - 1 :: presses]:
        if piece[first] == piece[second]:  # cut in the middle of the free air between two presses
            stretch = force[first:second]
            low = float(stretch.min())
            free = np.flatnonzero(stretch <= low + _AIR * max(min(force[first], force[second]) - low, 0.0))
            border[first + int(free[0] + free[-1] + 1) // 2] = 1
    run = np.cumsum(border)
    counts = np.bincount(run)
    return run if counts.min() >= fewest else piece


_SLOW = 0.05  # speed of a hold, relative to the usual speed
_TURNS = 0.3  # median speed within a reversal, relative to the speed beside it: 0.5 for a sine
_FEWEST_RESTING = 3  # samples: a turn of a saw tooth has less
_EDGE = 0.5  # smoothed velocity where the motion begins, relative to the usual speed
_SPRINGY = 0.5  # correlation of position and force: above, the force follows it; in free air it does not
_LASTING = 9  # samples that decide together, so that noise makes no phases
_PHASES = np.array(  # of what is free and what is pressed, by the way it moves
    [[Phase.RETRACT, Phase.FREE_AIR, Phase.APPROACH], [Phase.UNLOADING, Phase.HOLD, Phase.LOADING]],
    dtype=np.int64,
)


def press_phases(
    position: FloatArray,
    velocity: FloatArray,
    force: FloatArray,
    run: IntArray,
    pressed: BoolArray | None = None,
) -> IntArray:
    """Determine the phase of each sample, as numbers of `palpate.control.loop.task.Phase`, shape (n,).

    A sample presses if it is below the surface, or has a force if the displacement does not show the surface.

    Args:
        position: displacement, shape (n,), positive into the object.
        velocity: shape (n,).
        force: shape (n,), positive in compression.
        run: shape (n,), one block of samples for each run.
        pressed: where something is pressed or pulled, shape (n,); None to find out.
    """
    if pressed is None and position.min() <= 0.0:
        pressed = np.asarray(position > 0.0)
    elif pressed is None:
        pressed = np.asarray(force > force_levels(force, position).released)
        if correlation_coefficient(position[~pressed], force[~pressed]) > _SPRINGY:
            pressed = np.ones(len(position), dtype=np.bool_)
    usual = _typical_size(velocity)
    moves = np.abs(velocity) > _SLOW * usual
    # A velocity that was derived over many samples begins before the motion, and ends after it.
    change, half = np.empty(len(position)), _LASTING // 2
    for rows in blocks(run):  # how far it is from some samples before, and to some after each one, the less
        displacement = position[rows]
        padded = np.pad(displacement, half, mode="reflect", reflect_type="odd")  # as if the motion went on
        before, after = displacement - padded[: -2 * half], padded[2 * half :] - displacement
        change[rows] = np.minimum(np.abs(before), np.abs(after))
    moves &= (np.abs(velocity) > _EDGE * usual) | (change > _SLOW * _typical_size(change))
    way = np.sign(velocity).astype(np.int8) * moves
    phase = np.empty(len(position), dtype=np.int64)
    for rows in blocks(run):
        of_run = np.asarray(
            scipy.ndimage.median_filter(way[rows], min(_LASTING, rows.stop - rows.start), mode="nearest")
        )
        parts, speed = list(blocks(of_run)), np.abs(velocity[rows])
        # Where the motion only reverses, it does not rest: a sine decelerates evenly.
        for left, rest, right in zip(parts, parts[1:], parts[2:], strict=False):
            lasts = rest.stop - rest.start
            moves_on = min(left.stop - left.start, right.stop - right.start) >= max(2 * lasts, _LASTING)
            if of_run[rest.start] or not moves_on or of_run[left.start] == of_run[right.start]:
                continue
            at_ends = min(speed[rest.start - 1], speed[rest.stop])
            if lasts < _FEWEST_RESTING or np.median(speed[rest]) > _TURNS * at_ends:
                of_run[rest] = np.sign(velocity[rows][rest])
        touching = np.asarray(scipy.ndimage.median_filter(pressed[rows].astype(np.int8), 3, mode="nearest"))
        phase[rows] = _PHASES[touching, of_run + 1]
    return phase


def _typical_size(signal: FloatArray) -> float:
    """Return the 90 % quantile of the absolute nonzero values of a signal (n,)."""
    sizes = np.abs(signal[signal != 0.0])
    return float(np.quantile(sizes, 0.9)) if len(sizes) else 0.0


_TAILS = (0.005, 0.995)  # quantiles, between which a signal has its range
_FAR = 3.0  # ratio of the larger to the smaller side of a one-sided signal
_GOES_WITH = 0.3  # correlation of displacement and force of a press, of which most may be free air
_DRAGGED = -0.3  # correlation of velocity and force, below which the force is counted the other way
_OTHER_SIDE = 0.2  # least range on the smaller side, relative to the larger
_MOVES = 0.3  # least standard deviation of the force on one side, relative to the other
_FARTHER = 0.5  # least displacement that counts as far out, relative to the extreme
_FARTHEST = 0.9  # least displacement that counts as farthest out
_RESTS = 0.2  # force at rest farthest out, relative to its deviation on that side
_RESTLESS = 0.5  # least deviation of a force that does not rest farthest out, relative to its deviation
_FEWEST = 20  # samples far out, or about a level of the force
_SHALLOW = 0.02  # quantile of pressed depths; no force begins deeper
_PULLS = 0.5  # least force of the weaker sign, relative to the stronger
_NOT_NOISE = 0.5  # correlation of neighboring readings, which noise in free air does not have
_FINE, _MOSTLY_HELD = 1e-3, 0.5  # step relative to the range; share of samples below which most are held
_OF_AIR = 0.1  # share of the displacement's range that free air must span


@dataclass(frozen=True)
class PressSides:
    """Signs and zero of a displacement and its force."""

    displacement: float = 1.0  # what turns it positive into the object: 1 or -1
    force: float = 1.0  # what turns it positive in compression: 1 or -1
    zero_m: float = 0.0  # where the force begins, if the displacement counts from far away, after turning [m]
    two_sided: bool = False  # whether the element pulls as well: a spring or damper held at both ends
    springy: bool = True  # whether the force follows the displacement
    never_free: bool = False  # whether the force rests nowhere, so that no displacement is free air


def press_sides(displacement: FloatArray, force: FloatArray) -> PressSides:
    """Determine signs and zero of displacement and force of a press, spring or damper.

    Displacement, force, or both may count compression negative. The force of an object that can only push has
    one sign. An element that also pulls has displacements and forces of both signs.

    Args:
        displacement: shape (n,), in the order of time.
        force: shape (n,).
    """
    sides = _sides_of_object(displacement, force)
    is_two_sided = _is_two_sided(displacement, force)
    # In free air a force rests: its neighboring readings differ as much as any others. A force that changes
    # smoothly farthest outside the object belongs to an element that is held at both ends.
    depth = sides.displacement * displacement - sides.zero_m
    farthest = force[depth <= _FARTHEST * min(depth.min(), 0.0)]
    is_held = len(farthest) >= _FEWEST and bool(np.std(farthest) > _RESTLESS * np.std(force))
    is_held = is_held and correlation_coefficient(farthest[1:], farthest[:-1]) > _NOT_NOISE
    if is_two_sided or is_held:
        correlation = correlation_coefficient(displacement, force)
        if is_held and abs(np.mean(displacement)) > np.ptp(displacement):  # counted from the element's length
            correlation = np.sign(np.mean(displacement) * np.mean(force))
        if abs(correlation) > _SPRINGY:
            return PressSides(force=float(np.sign(correlation)), two_sided=True, never_free=is_held)
        against = correlation_coefficient(np.gradient(displacement), force) < _DRAGGED
        way = -1.0 if against else 1.0
        return PressSides(force=way, two_sided=True, springy=not is_two_sided, never_free=is_held)
    return sides


def _sides_of_object(displacement: FloatArray, force: FloatArray) -> PressSides:
    """Determine signs and zero of displacement and force (n,) of an object that can only push."""
    correlation = correlation_coefficient(displacement, force)
    until = int(np.argmax(np.abs(force))) + 1  # then it may soften or tear
    before = correlation_coefficient(displacement[:until], force[:until]) if until >= _FEWEST else 0.0
    if abs(before) > _GOES_WITH > correlation * np.sign(before):
        displacement, force = displacement[:until], force[:until]
        correlation = before
    way, push = 1.0, 1.0
    if correlation > _GOES_WITH and _is_negative(force):  # the reader of the motion may count from anywhere
        way = push = -1.0
    elif correlation < -_GOES_WITH:
        way, push = (1.0, -1.0) if _is_negative(force) else (-1.0, 1.0)
    zero_m = _find_zero(way * displacement, push * force)
    near = _SHALLOW * float(np.ptp(displacement))
    if way < 0.0 and max(displacement[0] - displacement.min(), abs(displacement.min())) <= near:
        return PressSides()  # a way from about zero on would hardly press if it were turned
    return PressSides(way, push, zero_m)


def _is_negative(signal: FloatArray) -> bool:
    """Return whether a signal (n,) is mostly below zero."""
    low, high = np.quantile(signal, _TAILS)
    return bool(-low > _FAR * max(high, 0.0) and low < high)


def _find_zero(displacement: FloatArray, force: FloatArray) -> float:
    """Find where the force of a press begins [m], if the displacement counts from elsewhere; else 0.

    The displacement counts from elsewhere if it is never positive, or so far from zero that no press is as
    deep and there is free air. The force begins where a fit of a spring and damper to pressed samples crosses
    zero. A hold counts as one sample, since it may last longer than all motion.
    """
    moved = (
        np.diff(np.floor(displacement / (_FINE * float(np.ptp(displacement)) or 1.0)), prepend=np.inf) != 0
    )
    if np.mean(moved) < _MOSTLY_HELD:
        displacement, force = displacement[moved], force[moved]
    if correlation_coefficient(displacement, force) < _GOES_WITH:
        return 0.0  # nothing says that it presses
    low, high = np.quantile(displacement, _TAILS)
    levels = force_levels(force, displacement if low < 0.0 < high else np.ones_like(displacement))
    free = displacement[force <= levels.released]
    in_air = len(free) >= _FEWEST and np.ptp(free) > _OF_AIR * (high - low)
    if high > 0.0 and not (low > high - low and in_air):
        return 0.0
    pressed = force > levels.pressed
    if not in_air or np.sum(pressed) < _FEWEST:
        return float(low)
    columns = np.column_stack([displacement, np.gradient(displacement), np.ones(len(force))])
    stiffness, _, offset = np.linalg.lstsq(columns[pressed], force[pressed] - levels.free, rcond=None)[0]
    begins = -offset / stiffness if stiffness > 0.0 else high
    return float(np.clip(begins, np.min(free), np.quantile(displacement[pressed], _SHALLOW)))


def _is_two_sided(displacement: FloatArray, force: FloatArray) -> bool:
    """Return whether displacement and force (n,) are those of an element that pulls.

    The force takes both signs alike far from zero displacement: an object that can only push does so there in
    any direction of motion, and an object that sticks pulls farther out. Or both reach both signs. In free
    air the force rests, except while an object sticks. An object that sticks longer pulls until it tears off,
    and the force rests farthest out; the force of an element held at both ends does not.
    """
    if len(force) > 1 and correlation_coefficient(force[1:], force[:-1]) >= _NOT_NOISE:
        extreme = displacement[np.argmax(np.abs(displacement))]
        deep = force[displacement * np.sign(extreme) > _FARTHER * abs(extreme)]
        low, high = np.quantile(deep, [0.1, 0.9]) if len(deep) >= _FEWEST else (0.0, 0.0)
        if min(-low, high) > _PULLS * max(-low, high) > _PULLS * _PULLS * np.abs(force).max():
            return True
    ends = [np.quantile(signal, _TAILS) for signal in (displacement, force)]
    if any(min(-low, high) <= _OTHER_SIDE * max(-low, high) for low, high in ends):
        return False
    far, pushing = displacement < _FARTHER * ends[0][0], displacement > _FARTHER * ends[0][1]
    enough = min(np.sum(far), np.sum(pushing)) >= _FEWEST
    if not enough or np.std(force[far]) <= _MOVES * np.std(force[pushing]):
        return False
    farthest = force[displacement < _FARTHEST * ends[0][0]]
    rests = np.sqrt(np.mean(farthest**2)) < _RESTS * np.std(force[far])
    return not (len(farthest) >= _FEWEST and rests)
