"""Separate the presses in a recording, determine their phases, and find the sign of compression."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from palpate.control.loop.task import Phase
from palpate.estimation.signals.blocks import blocks
from palpate.estimation.statistics.correlation import correlation_coefficient
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

MIN_RUN_ROWS = 20  # least number of rows of a detected run (a press or a block of equal numbers)
_MAX_RUNS = 500  # most runs into which a recording is cut; with more presses, several form one run
# Thresholds relative to the range of the force: a press rises from below `_RELEASED` to above `_PRESSED`.
_PRESSED, _RELEASED = 0.1, 0.05
_SIGMAS = (8.0, 4.0)  # the same thresholds in standard deviations of the noise; the larger ones apply
_TO_SIGMA = MAD_TO_SIGMA / np.sqrt(2.0)  # converts the median step between samples to sigma of normal noise
_MIN_AIR_SHARE = 0.02  # least share of samples in free air that determine a baseline
_MAX_AIR_RISE = 0.1  # largest rise of the force in free air between two presses, relative to the lower press


@dataclass(frozen=True)
class _ForceLevels:
    """Force levels [N] that separate a press from free air."""

    pressed: float  # force above which the tool is in contact
    released: float  # force below which the tool is in free air
    free: float  # force in free air


def _force_levels(force: FloatArray, displacement: FloatArray) -> _ForceLevels:
    """Estimate the force levels of a contact from force (n,) [N] and displacement (n,) [m]."""
    outside = displacement <= 0.0
    free = force[outside] if np.mean(outside) > _MIN_AIR_SHARE else force
    base = float(np.median(free) if free is not force else np.quantile(force, _MIN_AIR_SHARE))
    span = float(np.quantile(force, 0.98)) - base
    noise = _TO_SIGMA * float(np.median(np.abs(np.diff(force)))) if len(force) > 1 else 0.0
    return _ForceLevels(
        base + max(_PRESSED * span, min(_SIGMAS[0] * noise, 0.5 * span)),
        base + max(_RELEASED * span, min(_SIGMAS[1] * noise, 0.25 * span)),
        base,
    )


def cut_presses(
    force: FloatArray, displacement: FloatArray, piece: IntArray, time_s: FloatArray
) -> tuple[IntArray, int]:
    """Cut a recording into runs in the free air between presses: at a pause of the clock, or in the middle.

    Args:
        force: force, positive in compression, shape (n,).
        displacement: displacement, positive into the object, shape (n,).
        piece: number of the separate recording that each sample belongs to, shape (n,).
        time_s: times in the order of the file, shape (n,) [s].

    Returns:
        Run number of each sample, shape (n,), and the number of presses per run.
    """
    levels, peaks = _force_levels(force, displacement), list[int]()
    for rows in blocks(piece):  # find the largest force of each press
        sides = np.where(force[rows] > levels.pressed, 1, np.where(force[rows] < levels.released, -1, 0))
        decided = np.flatnonzero(sides)
        if len(decided):
            is_rise = (sides[decided] > 0) & np.append(True, sides[decided][:-1] < 0)
            begins = rows.start + decided[is_rise]
            ends = np.append(begins, rows.stop)[1:]
            peaks += [a + int(np.argmax(force[a:b])) for a, b in zip(begins, ends, strict=True)]
    press_peaks = peaks[:1]
    for peak in peaks[1:]:  # require that the displacement returned: a force may rise twice in one press
        since_peak = displacement[press_peaks[-1] : peak]
        if since_peak[0] - since_peak.min() > _RELEASED * np.ptp(displacement):
            press_peaks.append(peak)
    presses = max(1, -(-len(press_peaks) // _MAX_RUNS))
    at = np.array(press_peaks, dtype=np.int64)
    return _cut_between(force, displacement, piece, time_s, at, MIN_RUN_ROWS, presses), presses


def cut_into(  # noqa: PLR0917
    force: FloatArray, displacement: FloatArray, piece: IntArray, time_s: FloatArray, count: int, where: str
) -> IntArray:
    """Cut a recording into a given number of presses: those that start farthest from the object.

    Args:
        force: force, positive in compression, shape (n,).
        displacement: displacement, positive into the object, shape (n,).
        piece: number of the separate recording that each sample belongs to, shape (n,).
        time_s: times in the order of the file, shape (n,) [s].
        count: number of presses stated by the user.
        where: file and option, for the error message.

    Raises:
        InputError: fewer presses can be separated.
    """
    depth = np.asarray(scipy.ndimage.median_filter(displacement, 5))
    padded = np.pad(depth, 1, constant_values=depth.min())
    peaks, properties = scipy.signal.find_peaks(padded, prominence=0.0)
    prominence = properties["prominences"]
    smooth_force = np.asarray(scipy.ndimage.median_filter(force, 5))
    is_pressed = smooth_force[peaks - 1] > _force_levels(force, displacement).released
    is_press = is_pressed & (prominence > _RELEASED * np.ptp(depth))
    press_peaks = np.sort(peaks[is_press][np.argsort(prominence[is_press])[::-1][:count]]) - 1
    run = _cut_between(force, displacement, piece, time_s, press_peaks, 1) if len(press_peaks) else piece
    if run[-1] + 1 != count:
        presses = f"{run[-1] + 1} press{'es' if run[-1] else ''}"
        raise InputError(f"{where}: at most {presses} can be separated")
    return run


def _cut_between(  # noqa: PLR0917
    force: FloatArray,
    displacement: FloatArray,
    piece: IntArray,
    time_s: FloatArray,
    press_peaks: IntArray,
    fewest: int,
    presses: int = 1,
) -> IntArray:
    border = np.zeros(len(force), dtype=np.int64)
    border[1:] = np.diff(piece) != 0
    for peak, next_peak in list(pairwise(press_peaks.tolist()))[presses - 1 :: presses]:
        if piece[peak] == piece[next_peak]:
            between, depth = force[peak:next_peak], displacement[peak:next_peak]
            low = float(between.min())
            rise = max(min(force[peak], force[next_peak]) - low, 0.0)
            is_outside = depth <= depth.min() + _RELEASED * np.ptp(depth)
            outside = float(np.median(between[is_outside]))
            noise = _TO_SIGMA * float(np.median(np.abs(np.diff(between)))) if len(between) > 1 else 0.0
            # A sticky object pulls when it is touched, and before it detaches; the cut comes after that.
            pull_level = outside - max(_MAX_AIR_RISE * rise, _SIGMAS[1] * noise)
            retreat = scipy.ndimage.median_filter(between[: int(np.argmax(is_outside)) + 1], 5)
            after = int(np.argmin(retreat)) if retreat.min() < pull_level else 0
            low = outside if low < pull_level else low
            free = peak + after + np.flatnonzero(between[after:] <= low + _MAX_AIR_RISE * rise)
            begin, end = free[0], free[-1]
            steps_s = np.diff(time_s[begin : end + 1])
            is_pause = len(steps_s) and steps_s.max() > 0.5 * steps_s.sum()
            border[begin + 1 + np.argmax(steps_s) if is_pause else (begin + end + 1) // 2] = 1
    run = np.cumsum(border)
    counts = np.bincount(run)
    return run if counts.min() >= fewest else piece


_HOLD_SPEED = 0.05  # largest speed of a hold, relative to the usual speed
_REVERSAL_SPEED = 0.3  # least median speed in a reversal, relative to the speed around it (0.5 for a sine)
_MIN_REST = 3  # least number of samples at rest; a reversal of a triangle wave has fewer
_EDGE_SPEED = 0.5  # smoothed velocity at the start of a motion, relative to the usual speed
_ELASTIC = 0.5  # correlation of position and force above which the force follows the position
_PHASE_SAMPLES = 9  # samples that determine a phase jointly, so that noise does not create phases
_PHASES = np.array(  # phase by contact (rows: free air, pressed) and direction of motion (columns)
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

    A sample is in contact if it is below the surface. If the displacement does not show the surface, the
    force decides.

    Args:
        position: displacement, positive into the object, shape (n,).
        velocity: its derivative, shape (n,).
        force: force, positive in compression, shape (n,).
        run: run number of each sample, one block of samples for each run, shape (n,).
        pressed: mask of samples that are pressed or pulled, shape (n,); None to determine it.
    """
    if pressed is None and position.min() <= 0.0:
        pressed = np.asarray(position > 0.0)
    elif pressed is None:
        pressed = np.asarray(force > _force_levels(force, position).released)
        if correlation_coefficient(position[~pressed], force[~pressed]) > _ELASTIC:
            pressed = np.ones(len(position), dtype=np.bool_)
    usual_speed = _typical_size(velocity)
    is_moving = np.abs(velocity) > _HOLD_SPEED * usual_speed
    # A velocity that was derived over many samples starts before the motion and ends after it.
    change, half = np.empty(len(position)), _PHASE_SAMPLES // 2
    for rows in blocks(run):  # smaller of the displacements over some samples before and after each sample
        displacement = position[rows]
        padded = np.pad(displacement, half, mode="reflect", reflect_type="odd")  # extrapolates the motion
        before, after = displacement - padded[: -2 * half], padded[2 * half :] - displacement
        change[rows] = np.minimum(np.abs(before), np.abs(after))
    has_moved = change > _HOLD_SPEED * _typical_size(change)
    is_moving &= has_moved | (np.abs(velocity) > _EDGE_SPEED * usual_speed)
    direction = np.sign(velocity).astype(np.int8) * is_moving
    phase = np.empty(len(position), dtype=np.int64)
    for rows in blocks(run):
        window = min(_PHASE_SAMPLES, rows.stop - rows.start)
        smooth = np.asarray(scipy.ndimage.median_filter(direction[rows], window, mode="nearest"))
        touching = np.asarray(scipy.ndimage.median_filter(pressed[rows].astype(np.int8), 3, mode="nearest"))
        # without holds that are only reversals, as of a sine
        way, speed, parts = smooth.copy(), np.abs(velocity[rows]), list(blocks(smooth))
        for first, rest, last in zip(parts, parts[1:], parts[2:], strict=False):
            count = rest.stop - rest.start
            least = max(2 * count, _PHASE_SAMPLES)
            moves_on = min(first.stop - first.start, last.stop - last.start) >= least
            is_turn = smooth[first.start] != smooth[last.start]
            if smooth[rest.start] == 0 and moves_on and is_turn:
                speed_beside = min(speed[rest.start - 1], speed[rest.stop])
                if count < _MIN_REST or np.median(speed[rest]) > _REVERSAL_SPEED * speed_beside:
                    way[rest] = np.sign(velocity[rows][rest])
        phase[rows] = _PHASES[touching, way + 1]
    return phase


def _typical_size(signal: FloatArray) -> float:
    """Return the 90 % quantile of the absolute nonzero values of a signal (n,)."""
    sizes = np.abs(signal[signal != 0.0])
    return float(np.quantile(sizes, 0.9)) if len(sizes) else 0.0


_TAILS = (0.005, 0.995)  # quantiles that define the range of a signal
_ONE_SIDED_RATIO = 3.0  # least ratio of the larger to the smaller side of a one-sided signal
_PRESS_CORRELATION = 0.3  # least correlation of displacement and force in a press, with much free air
_OPPOSED_CORRELATION = -0.3  # correlation of velocity and force below which the force has the opposite sign
_MIN_OTHER_SIDE = 0.2  # least range on the smaller side, relative to the larger
_MIN_FORCE_CHANGE = 0.3  # least standard deviation of the force on one side, relative to the other
_FAR_OUT = 0.5  # least displacement that counts as far out, relative to the extreme
_FARTHEST_OUT = 0.9  # least displacement that counts as farthest out, relative to the extreme
_MAX_REST = 0.2  # largest force at rest farthest out, relative to its deviation on that side
_MIN_CHANGING_FORCE = 0.5  # least relative deviation of a force that does not rest farthest out
_MIN_SAMPLES = 20  # least number of samples far out, or near a level of the force
_SHALLOW = 0.02  # quantile of pressed depths; the force begins at most there
_MIN_PULL = 0.5  # least force of the weaker sign, relative to the stronger
_MIN_AUTOCORRELATION = 0.5  # least correlation of consecutive readings that are not only noise
_MIN_MOVE, _MIN_MOVES = 1e-3, 0.5  # least relative step of a move; share of moves below which holds dominate
_MIN_AIR_RANGE = 0.1  # share of the displacement's range that free air must span
_MIN_SLOPE = 0.2  # least slope of a force that follows the displacement, times the ratio of their ranges


@dataclass(frozen=True)
class PressSides:
    """Signs and zero of a displacement and its force."""

    displacement: float = 1.0  # factor that makes the displacement positive into the object: 1 or -1
    force: float = 1.0  # factor that makes the force positive in compression: 1 or -1
    # Displacement, after multiplication, at which the force begins or changes its sign [m]; often 0.
    zero_m: float = 0.0
    two_sided: bool = False  # whether the element can also pull: a spring or damper attached at both ends
    elastic: bool = True  # whether the force follows the displacement
    never_free: bool = False  # whether no displacement is free air, since the force is nowhere at rest


def press_sides(displacement: FloatArray, force: FloatArray, *, held: bool | None = None) -> PressSides:
    """Determine signs and zero of displacement and force of a press, spring or damper.

    Displacement, force, or both may be negative in compression. The force of an object that can only push has
    one sign. An element that can also pull has displacements and forces of both signs.

    Args:
        displacement: displacement in order of time, shape (n,).
        force: force of each sample, shape (n,).
        held: whether the element is held at both ends (True) or has a surface (False); None if unknown.
    """
    sides = _sides_of_object(displacement, force)
    if held is False:
        return sides
    is_two_sided = _is_two_sided(displacement, force)
    if not is_two_sided and _pulls_to_its_end(displacement, force):
        slope, offset = np.polyfit(displacement, force, 1)
        includes_length = np.abs(displacement).min() > np.ptp(displacement)
        zero_m = -float(offset / slope) if includes_length else 0.0
        return PressSides(force=float(np.sign(slope)), zero_m=zero_m, two_sided=True, never_free=True)
    # In free air a force is at rest: consecutive readings differ as much as any others. A force that changes
    # smoothly farthest outside the object belongs to an element that is attached at both ends.
    depth = sides.displacement * displacement - sides.zero_m
    is_farthest = depth <= _FARTHEST_OUT * min(depth.min(), 0.0)
    farthest = force[is_farthest]
    is_held = len(farthest) >= _MIN_SAMPLES and bool(np.std(farthest) > _MIN_CHANGING_FORCE * np.std(force))
    is_held = is_held and correlation_coefficient(farthest[1:], farthest[:-1]) > _MIN_AUTOCORRELATION
    is_held = is_held and not _rests_on_one_way(depth, force, is_farthest, float(np.std(force)))
    is_held = is_held or bool(held)
    if is_two_sided or is_held:
        correlation = correlation_coefficient(displacement, force)
        if is_held and abs(np.mean(displacement)) > np.ptp(displacement):  # includes the element's length
            correlation = np.sign(np.mean(displacement) * np.mean(force))
        if abs(correlation) > _ELASTIC:
            return PressSides(force=float(np.sign(correlation)), two_sided=True, never_free=is_held)
        is_opposed = correlation_coefficient(np.gradient(displacement), force) < _OPPOSED_CORRELATION
        sign = -1.0 if is_opposed else 1.0
        return PressSides(force=sign, two_sided=True, elastic=not is_two_sided, never_free=is_held)
    return sides


def _sides_of_object(displacement: FloatArray, force: FloatArray) -> PressSides:
    """Determine signs and zero of displacement and force (n,) of an object that can only push."""
    correlation = correlation_coefficient(displacement, force)
    until = int(np.argmax(np.abs(force))) + 1  # afterwards the object may soften or tear
    before = correlation_coefficient(displacement[:until], force[:until]) if until >= _MIN_SAMPLES else 0.0
    if abs(before) > _PRESS_CORRELATION > correlation * np.sign(before):
        displacement, force = displacement[:until], force[:until]
        correlation = before
    depth_sign, force_sign = 1.0, 1.0
    if correlation > _PRESS_CORRELATION and _is_negative(force):  # the zero of the displacement is arbitrary
        depth_sign = force_sign = -1.0
    elif correlation < -_PRESS_CORRELATION:
        depth_sign, force_sign = (1.0, -1.0) if _is_negative(force) else (-1.0, 1.0)
    zero_m = _find_zero(depth_sign * displacement, force_sign * force)
    near = _SHALLOW * float(np.ptp(displacement))
    if depth_sign < 0.0 and max(displacement[0] - displacement.min(), abs(displacement.min())) <= near:
        return PressSides()  # a displacement from about zero on would hardly press with the opposite sign
    return PressSides(depth_sign, force_sign, zero_m)


def _is_negative(signal: FloatArray) -> bool:
    """Return whether a signal (n,) is mostly below zero."""
    low, high = np.quantile(signal, _TAILS)
    return bool(-low > _ONE_SIDED_RATIO * max(high, 0.0) and low < high)


def _find_zero(displacement: FloatArray, force: FloatArray) -> float:
    """Return the displacement at which the force of a press begins [m]; 0 if the displacement starts there.

    The displacement has another zero if it is never positive, or if there is free air and its values are too
    large for the depth of a press. The force begins where a fit of a spring and damper to pressed samples
    crosses zero. A hold counts as one sample, since it may last longer than all motion.
    """
    step_m = _MIN_MOVE * float(np.ptp(displacement)) or 1.0
    moved = np.diff(np.floor(displacement / step_m), prepend=np.inf) != 0
    if np.mean(moved) < _MIN_MOVES:
        displacement, force = displacement[moved], force[moved]
    if correlation_coefficient(displacement, force) < _PRESS_CORRELATION:
        return 0.0  # there is no evidence of a press
    low, high = np.quantile(displacement, _TAILS)
    levels = _force_levels(force, displacement if low < 0.0 < high else np.ones_like(displacement))
    free = displacement[force <= levels.released]
    in_air = len(free) >= _MIN_SAMPLES and np.ptp(free) > _MIN_AIR_RANGE * (high - low)
    if high > 0.0 and not (low > high - low and in_air):
        return 0.0
    pressed = force > levels.pressed
    if not in_air or np.sum(pressed) < _MIN_SAMPLES:
        return float(low)
    columns = np.column_stack([displacement, np.gradient(displacement), np.ones(len(force))])
    stiffness, _, offset = np.linalg.lstsq(columns[pressed], force[pressed] - levels.free, rcond=None)[0]
    begins = -offset / stiffness if stiffness > 0.0 else high
    return float(np.clip(begins, np.min(free), np.quantile(displacement[pressed], _SHALLOW)))


def _pulls_to_its_end(displacement: FloatArray, force: FloatArray) -> bool:
    """Return whether a force (n,) of both signs follows the displacement (n,) up to the end where it pulls.

    A clamped object that relaxes while it is deformed pulls on its way back, wherever the zero of the
    displacement is. An object that sticks may pull as much, but it detaches: its force rests in free air at
    this end, at least on the way in.
    """
    stronger = np.sign(np.sum(np.quantile(force, _TAILS)))
    low, high = np.quantile(stronger * force, _TAILS)
    if -low <= _MIN_OTHER_SIDE * high:
        return False
    depth = np.sign(stronger * correlation_coefficient(displacement, force)) * displacement
    is_outermost = depth <= depth.min() + _MIN_AIR_RANGE * np.ptp(depth)
    direction = np.sign(np.gradient(depth))
    for way in (-1.0, 1.0):
        x, pull = (signal[is_outermost & (direction == way)] for signal in (depth, stronger * force))
        follows = len(x) >= _MIN_SAMPLES and correlation_coefficient(x, pull) > _ELASTIC
        if not follows or np.polyfit(x, pull, 1)[0] * np.ptp(depth) < _MIN_SLOPE * np.ptp(force):
            return False
    return True


def _is_two_sided(displacement: FloatArray, force: FloatArray) -> bool:
    """Return whether displacement and force (n,) belong to an element that can pull.

    Either of two observations indicates such an element:

    - The force is positive and negative at large displacements. An object that can only push would push there
      in both directions of motion, and a sticking object would pull only outside its surface.
    - Displacement and force are both positive and negative, and the force is not zero at the most negative
      displacements. A sticking object detaches there, and its force is then zero.
    """
    if len(force) > 1 and correlation_coefficient(force[1:], force[:-1]) >= _MIN_AUTOCORRELATION:
        extreme = displacement[np.argmax(np.abs(displacement))]
        deep = force[displacement * np.sign(extreme) > _FAR_OUT * abs(extreme)]
        low, high = np.quantile(deep, [0.1, 0.9]) if len(deep) >= _MIN_SAMPLES else (0.0, 0.0)
        if min(-low, high) > _MIN_PULL * max(-low, high) > _MIN_PULL * _MIN_PULL * np.abs(force).max():
            return True
    ends = [np.quantile(signal, _TAILS) for signal in (displacement, force)]
    if any(min(-low, high) <= _MIN_OTHER_SIDE * max(-low, high) for low, high in ends):
        return False
    far, pushing = displacement < _FAR_OUT * ends[0][0], displacement > _FAR_OUT * ends[0][1]
    enough = min(np.sum(far), np.sum(pushing)) >= _MIN_SAMPLES
    if not enough or np.std(force[far]) <= _MIN_FORCE_CHANGE * np.std(force[pushing]):
        return False
    is_farthest = displacement < _FARTHEST_OUT * ends[0][0]
    return not _rests_on_one_way(displacement, force, is_farthest, float(np.std(force[far])))


def _rests_on_one_way(depth: FloatArray, force: FloatArray, rows: BoolArray, deviation: float) -> bool:
    """Return whether the force (n,) rests in some rows (n,) throughout, or on the way in from there.

    An object that sticks may still pull when the tool turns, but the tool comes back to it through free air.
    """
    parts = force[rows], force[rows & (np.gradient(depth) > 0.0)]
    return any(
        len(part) >= _MIN_SAMPLES and np.sqrt(np.mean(part**2)) < _MAX_REST * deviation for part in parts
    )
