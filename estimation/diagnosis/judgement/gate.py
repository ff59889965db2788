"""Whether a channel can be diagnosed at all; if not, the reason in one sentence."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import median_filter

from estimation.channel import ChannelData, ChannelKind
from estimation.diagnosis.bench.colour import ORDER, Colour
from estimation.diagnosis.bench.frame import block_length, frame_of
from estimation.diagnosis.judgement.copied import copied
from estimation.diagnosis.judgement.folded import folded
from estimation.diagnosis.judgement.turns import strange_turns
from estimation.model import Model
from estimation.signals.blocks import rows_of_runs
from estimation.signals.runwise import per_run, sample_time
from robot_io.types import BoolArray, FloatArray

LEAST_SAMPLES = 100
SINGLE_RUN = "a single run"  # how the reason begins where only the division into runs is missing
_MOST_BLOCKS = 300_000  # 25 minutes of blocks of 5 ms: memory grows with them
_LONGEST_CONTACT_M = 0.2  # deeper indentations than this are a mistaken unit
_STIFFEST_N_M = 1e7
_SOFTEST_N_M = 1e-2
_FASTEST_RAD_S = 300.0
_STUCK_SHARE = 0.3  # of the loaded samples at one extreme value: the sensor was at its end
_STILL = 1e-3  # of the range of positions, that a held one stays within
# Free air at a sensor's lower end: how much of it, how far from zero (of all readings' range), how many of
# the readings above are distinct, and how alike neighbouring bends of them are (-0.67 in white noise).
_MOST_OF_AIR, _OFF_ZERO, _FINE, _NOISY = 0.7, 0.01, 0.5, -0.3
# Readings in all, with which a sensor says little, or is coarse. Each edge between two of them tells one
# point of the curve: a straight one, bent by a damper, needs four to be seen to be right or wrong.
# A joint meets each edge in many states of motion, but a single edge gives no scale.
_TOO_FEW_LEVELS, _TOO_FEW_OF_A_JOINT, _FEW_LEVELS = 5, 3, 50
_GLITCH = 25.0  # times the usual distance between neighbours
_MOST_GLITCHES = 0.01
_SPIKE = 0.2  # of the range of the effort; what stands out by less does no harm
_COVERED = 0.3  # of the range of positions, that each fifth of a single recording goes through to be held out
_DEEP, _LET_GO = (
    0.5,
    0.1,
)  # of the deepest indentation: a press goes from the one to the other, however shaken
_SAME_SHAPE = 0.7  # correlation, half of the variance: it is this position's velocity, whatever its scale
_OTHER_SCALE = 1.5  # smoothing takes less than a third off a velocity; a mistaken unit is off by ten and more
_LEAST_PRESSED = 0.01  # of the samples
# Standard deviations of free air, that one in twenty pressed samples is above: of noise, 1 in 16 000 is.
_ABOVE_AIR, _ONE_IN_TWENTY = 4.0, 0.95
_TO_SIGMA = 1.4826  # of the median deviation, for normal noise
_SHIFTS_S = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # as of clocks that were started by hand
_JOINED, _APART = 0.9, 0.5  # correlations of depth and force: any spring's is above the one
_LOADED = 0.3  # of the largest effort
# Times that one run's samples may last longer than another's: a time constant is off by as much, which is as
# large as the error of one that is just found; and steps by which a run tells how long they last.
_OTHER_RATE, _FEWEST_STEPS = 1.2, 10
_LEAST_EXPLAINED = 0.1  # share of a force's variance that depth and velocity explain, whatever the object is


def usable(data: ChannelData) -> BoolArray:
    """Samples that are no glitches of the reader, shape (n,): single readings far off both neighbours."""
    if len(data) == 0:
        return np.ones(0, dtype=np.bool_)
    smooth = per_run(lambda effort: np.asarray(median_filter(effort, 5)), data.effort, data.run)
    off = np.abs(data.effort - smooth)
    usual = float(np.median(off[off > 0.0])) if (off > 0.0).any() else 0.0
    level = max(_GLITCH * usual, _SPIKE * float(np.ptp(smooth)))
    good = np.asarray(off <= level)
    return good if np.mean(~good) <= _MOST_GLITCHES else np.ones(len(data), dtype=np.bool_)


def refuse(data: ChannelData, model: Model | None = None) -> str | None:
    """The reason why this channel cannot be diagnosed, and the remedy; None if it can.

    Args:
        data: the channel.
        model: what is to explain it. One with nothing to fit knows what readings at the end of a sensor's
            range should have been, so that these are no reason.
    """
    known = model is not None and not model.gains and not model.inner
    checks = _CHECKS if known else (*_CHECKS, _saturated)
    return next(filter(None, (check(data) for check in checks)), None) or strange_turns(data, model)


def spoilt(data: ChannelData, model: Model) -> str | None:
    """What is wrong with the readings or the motion, whatever is asked of them; None if nothing shows.

    Unlike `refuse`, it asks for nothing to be held out.
    """
    good = data.select(usable(data))
    reasons = (check(good) for check in (*_OF_THE_SIGNALS, _saturated))
    return next(filter(None, reasons), None) or strange_turns(good, model)


def _length(data: ChannelData) -> str | None:
    if len(data) < LEAST_SAMPLES:
        return f"only {len(data)} samples; record at least {LEAST_SAMPLES}"
    return None


def _size(data: ChannelData) -> str | None:
    """Refuse before anything takes time and memory."""
    lengths = np.unique(data.run, return_counts=True)[1]
    count = int(np.sum(lengths // block_length(data)))
    if count > _MOST_BLOCKS:
        more = f"{count} blocks are more than can be searched, {_MOST_BLOCKS}"
        return f"{more}; take some of the runs with --where"
    return None


def _variation(data: ChannelData) -> str | None:
    for what, signal in (("effort", data.effort), ("position", data.position)):
        if np.ptp(signal) <= 1e-12 * max(1.0, float(np.max(np.abs(signal)))):
            return f"the {what} never changes; check the sensor and the column"
    return None


def _runs(data: ChannelData) -> str | None:
    """One run must cover its motion several times over, so that parts of it can be held out."""
    if len(data.runs) > 1:
        return None
    if data.kind is ChannelKind.CONTACT:
        presses = _presses(data)
        if presses > 1:
            return f"{SINGLE_RUN} with {presses} presses; number them in a column `run` of the data file"
        return f"{SINGLE_RUN}, so nothing can be held out to judge by; probe at least three times"
    parts = np.array_split(data.position, 5)
    ranges = np.array([np.ptp(part) for part in parts])
    if ranges.min() < _COVERED * np.ptp(data.position):
        return f"{SINGLE_RUN} that goes through its motion once; record at least three runs"
    return None


def _presses(data: ChannelData) -> int:
    """How often the object was pressed to half of the deepest indentation, after it was let go."""
    deepest = float(data.position.max())
    sides = np.where(data.position > _DEEP * deepest, 1, np.where(data.position < _LET_GO * deepest, -1, 0))
    met = sides[sides != 0]
    return int(np.count_nonzero((met[1:] > 0) & (met[:-1] < 0)) + (len(met) > 0 and met[0] > 0))


def _units(data: ChannelData) -> str | None:
    if data.kind is ChannelKind.CONTACT:
        deepest = float(data.position.max())
        if deepest > _LONGEST_CONTACT_M:
            return f"the deepest indentation is {deepest:.3g} m; is the displacement in millimetres?"
        pressed = data.engaged
        if pressed.any():
            slope = float(np.ptp(data.effort)) / max(deepest, 1e-12)
            if not _SOFTEST_N_M < slope < _STIFFEST_N_M:
                return f"force over depth is {slope:.3g} N/m; check the units of both"
    if data.kind is ChannelKind.REVOLUTE and float(np.quantile(np.abs(data.velocity), 0.9)) > _FASTEST_RAD_S:
        return "the joint turns faster than 300 rad/s most of the time; is the angle in degrees?"
    return None


def _time(data: ChannelData) -> str | None:
    """The velocity must be the position's slope: else times, or units of one of them, are off."""
    step = sample_time(data.time_s, data.run)
    slope = per_run(lambda x: np.gradient(x, step) if len(x) > 1 else 0.0 * x, data.position, data.run)
    energy = float(slope @ slope)
    if energy == 0.0:
        return None
    ratio, likeness = float(slope @ data.velocity) / energy, _likeness(slope, data.velocity)
    if likeness > _SAME_SHAPE and not 1.0 / _OTHER_SCALE < ratio < _OTHER_SCALE:
        return f"the velocity is {ratio:.3g} times the slope of the position; check times and units"
    return None


def _contact(data: ChannelData) -> str | None:
    if data.kind is not ChannelKind.CONTACT:
        return None
    pressed = data.engaged
    if pressed.mean() < _LEAST_PRESSED:
        return "no contact: the displacement is never positive; press the object"
    if not pressed.all():
        air = data.effort[~pressed]
        spread = _TO_SIGMA * float(np.median(np.abs(air - np.median(air))))
        if np.quantile(np.abs(data.effort[pressed] - np.median(air)), _ONE_IN_TWENTY) < _ABOVE_AIR * spread:
            return "no contact: the force while pressed is no more than the noise in free air"
    if _likeness(np.where(pressed, data.position, 0.0), data.effort) < 0.0:
        return "force falls with depth; check the sign of force and displacement"
    return _stranger(data)


def _stranger(data: ChannelData) -> str | None:
    """A force that has next to nothing to do with the motion."""
    pressed = data.select(data.engaged)
    motion = np.column_stack([pressed.position, pressed.velocity, np.ones(len(pressed))])
    size = np.linalg.norm(motion, axis=0)
    motion = motion / np.where(size > 0.0, size, 1.0)
    left = pressed.effort - motion @ np.linalg.lstsq(motion, pressed.effort, rcond=1e-9)[0]
    share = 1.0 - float(np.var(left) / np.var(pressed.effort)) if np.ptp(pressed.effort) > 0.0 else 0.0
    if share < _LEAST_EXPLAINED:
        return f"depth and velocity explain {100.0 * share:.0f} % of the force; do they belong together?"
    return None


def _resolution(data: ChannelData) -> str | None:
    levels = len(np.unique(data.effort))
    if levels < (_TOO_FEW_LEVELS if data.kind is ChannelKind.CONTACT else _TOO_FEW_OF_A_JOINT):
        return f"only {levels} different readings: the sensor's steps are too coarse for this effort"
    return None


def _saturated(data: ChannelData) -> str | None:
    if len(np.unique(data.effort)) < _FEW_LEVELS:
        return None  # coarse steps, of which the last is often met
    size = np.abs(data.effort)
    loaded = size > _LOADED * size.max()
    for extreme in (data.effort.max(), data.effort.min()):
        stuck = data.effort == extreme
        share = float(np.mean(stuck[loaded]))
        moves = float(np.ptp(data.position[stuck])) > _STILL * float(np.ptp(data.position))
        if share > _STUCK_SHARE and moves:  # in data without noise, a hold shows one reading too
            return f"{100 * share:.0f} % of the loaded samples show {extreme:.6g}: the sensor is at its end"
    return _stuck_in_air(data)


def _stuck_in_air(data: ChannelData) -> str | None:
    """A lower end that free air lies beyond: one reading there, not zero, and noise as soon as it is left.

    A dead band about zero reads zero; a sensor with coarse steps, and data without noise, may well show one
    reading in free air.
    """
    lowest = float(data.effort.min())
    air, above = data.effort[~data.engaged], data.effort[data.effort > lowest]
    if data.kind is not ChannelKind.CONTACT or data.tare is not None or not len(air):
        return None
    share = float(np.mean(air == lowest))
    off_zero = abs(lowest) > _OFF_ZERO * float(np.ptp(data.effort))
    if share < _MOST_OF_AIR or not off_zero or len(np.unique(above)) < _FINE * len(above):
        return None
    bends = np.diff(data.effort, 2)[data.effort[1:-1] > lowest]
    if len(bends) < LEAST_SAMPLES or _likeness(bends[1:], bends[:-1]) > _NOISY:
        return None
    return (
        f"{100 * share:.0f} % of free air shows exactly {lowest:.6g}, and nothing shows less: "
        "the sensor is at its lower end; shift its range, or preload it"
    )


def _rates(data: ChannelData) -> str | None:
    """What remembers (a lag, a delay, a relaxation) counts samples: these must last as long in all runs."""
    steps = [np.diff(data.time_s[rows]) for rows in rows_of_runs(data.run)]
    usual = np.array([np.median(step) for step in steps if len(step) >= _FEWEST_STEPS])
    if len(usual) == 0 or usual.max() < _OTHER_RATE * usual.min():
        return None
    return (
        f"runs were sampled every {1e3 * usual.min():.4g} ms and every {1e3 * usual.max():.4g} ms; resample "
        "them to one rate, or take those of one with --where"
    )


def _offset(data: ChannelData) -> str | None:
    """Effort and motion must belong to the same moment: look for a shift that joins them far better."""
    if data.kind is not ChannelKind.CONTACT:
        return None
    pressed = np.where(data.engaged, data.position, 0.0)
    step = sample_time(data.time_s, data.run)
    now = _likeness(pressed, data.effort)
    for seconds in _SHIFTS_S:
        shift = round(seconds / step)
        if shift and abs(shift) < len(pressed) // 4:
            then = _likeness(np.roll(pressed, shift), data.effort)
            if then > _JOINED and now < _APART:
                return f"the force belongs to the motion of {-seconds:+.1f} s; align their times"
    return None


def _blocks(data: ChannelData) -> str | None:
    """There must be a block to fit to, and one to hold out, in another run if there are several.

    So many in a row as the noise's colour needs, too: a run that is shorter says nothing of its noise.
    """
    least, lengths = block_length(data), np.unique(data.run, return_counts=True)[1]
    parts = lengths // least if len(lengths) == 1 else lengths >= least
    if parts.sum() < 2:
        return f"fewer than two runs have {least} samples or more; record longer runs"
    frame = frame_of(data)
    if len(np.unique(frame.fold[frame.trusted])) < 2:
        return "in one run at most something moves, so nothing can be held out to judge by; record more runs"
    if len(np.unique(frame.fold[Colour(np.zeros(ORDER)).kept(frame.run, frame.trusted)])) < 2:
        return f"fewer than two runs go on for {(ORDER + 1) * least} samples or more; record longer runs"
    return None


def _likeness(one: FloatArray, other: FloatArray) -> float:
    """Correlation, 0 where one of them is constant."""
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


_Check = Callable[[ChannelData], str | None]
_OF_THE_SIGNALS: tuple[_Check, ...] = (_variation, _units, _time, _offset, _contact, _resolution, folded)
_CHECKS: tuple[_Check, ...] = (
    _length,
    _size,
    _variation,
    _runs,
    copied,
    _rates,
    *_OF_THE_SIGNALS[1:],
    _blocks,
)
