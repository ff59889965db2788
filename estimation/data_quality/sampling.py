"""Check the samples, runs, depths, speeds and clocks of a channel."""

from itertools import pairwise

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.blocks import PIECES, block_length
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import blocks
from palpate.estimation.signals.motion import has_constant_speed, is_one_pass, never_returns
from palpate.estimation.signals.runwise import is_even, sample_time, shift
from palpate.estimation.statistics.correlation import noise_between_samples
from palpate.estimation.statistics.least_squares import solve
from palpate.robot_io.types import FloatArray

MIN_SAMPLES = 60
SINGLE_RUN = "only one run"  # start of the reason if only the division into runs is missing
_MAX_BLOCKS = 300_000  # 25 minutes of blocks of 5 ms; limits the memory
_MIN_SHARED = 0.1  # share of a run's depths that another run must reach for a prediction
_MIN_TRAVEL = 3.0  # least path of a single recording of repeated motion, in ranges of position


def wrong_size(data: ChannelData) -> str | None:
    """Report too few samples, or more than can be searched; None otherwise.

    Args:
        data: the channel; only whole blocks of `block_length` samples count toward the limit of the search.
    """
    if len(data) < MIN_SAMPLES:
        return f"only {len(data)} samples; record at least {MIN_SAMPLES}"
    lengths = np.unique(data.run, return_counts=True)[1]
    count = int(np.sum(lengths // block_length(data)))
    if count > _MAX_BLOCKS:
        excess = f"{count} blocks of data are more than the {_MAX_BLOCKS} that can be searched"
        advice = f"some of the {len(lengths)} runs with --where run=N,N ..."
        return f"{excess}; take {advice if len(lengths) > 1 else 'shorter recordings'}"
    return None


def no_shared_depth(data: ChannelData) -> str | None:
    """Report that no two runs of a contact have similar depths, so none can be held out; else None.

    Depths are similar if their ranges overlap by more than a tenth of the smaller range.

    Args:
        data: the channel; a joint and a single run are not reported here.
    """
    if data.kind is not ChannelKind.CONTACT or len(data.runs) == 1:
        return None
    depths = [data.position[data.engaged & (data.run == run)] for run in data.runs]
    ranges = sorted((float(depth.min()), float(depth.max())) for depth in depths if len(depth))
    if len(ranges) == 1:
        return f"{SINGLE_RUN} of {len(data.runs)} touches the object; record at least three that do"
    spans = [_MIN_SHARED * (high - low) for low, high in ranges]
    shared = (before[1] - after[0] for before, after in pairwise(ranges))
    if ranges and all(depth <= min(pair) for depth, pair in zip(shared, pairwise(spans), strict=True)):
        return (
            f"no two of {len(ranges)} runs have similar depths, so none can be predicted from the "
            "others; press repeatedly to the same depth"
        )
    return None


def never_repeated(data: ChannelData) -> str | None:
    """Report effects that cannot be distinguished because the motion does not return or repeat; else None.

    Args:
        data: the channel. Several runs of a joint repeat the motion; a single run does if its pieces, of
            equal numbers of samples, cover at least three times the range of positions in all.
    """
    if len(data.runs) > 1:
        if data.kind is not ChannelKind.CONTACT or not never_returns(data.position, data.run):
            return None
        if is_one_pass(data.time_s, data.position, data.run):
            return (
                "all runs go one way at one speed, so relaxation, friction, damping and the sensor's range "
                "cannot be distinguished from the elastic law; hold, return, or add runs at another speed"
            )
        return "no run returns, so friction cannot be told from elastic shape; record a run that returns"
    travel = sum(np.ptp(part) for part in np.array_split(data.position, PIECES))
    if travel >= _MIN_TRAVEL * np.ptp(data.position):
        return None
    is_contact = data.kind is ChannelKind.CONTACT and never_returns(data.position, data.run)
    if is_contact and has_constant_speed(data.velocity[data.engaged]):
        return (
            f"{SINGLE_RUN} was recorded, and it goes through its motion once at one speed. Changes with "
            "time, speed and position therefore cannot be separated, and a damper acts like a constant "
            "force; record at least three runs, at several speeds"
        )
    return (
        f"{SINGLE_RUN} was recorded, and it goes through its motion once, so changes with time and with "
        "position cannot be separated; record at least three runs"
    )


def single_speed(data: ChannelData) -> str | None:
    """Report runs that return but have only one speed; None otherwise.

    Args:
        data: the channel; a joint is not reported.
    """
    has_one_speed = data.kind is ChannelKind.CONTACT and has_constant_speed(data.velocity[data.engaged])
    if not has_one_speed or never_returns(data.position, data.run):
        return None
    return (
        "all motion is at one speed, so dependence on the rate cannot be distinguished from friction; add "
        "runs at another speed"
    )


_MAX_SHIFT_S, _MAX_SHIFT = 0.1, 50  # largest time shift, in seconds and in samples
_COARSE = 21  # shifts of the coarse search
_MAX_EXCESS = 1.06  # largest ratio of an error to the noise between samples for an adequate fit
_MIN_GAIN = 1.05  # least ratio of the errors without and with a shift
_MIN_CHI2 = 50.0  # least chi-square with one degree of freedom: seven standard deviations
_MAX_SAMPLES = 6_000  # most samples that are used: the first whole runs
_MIN_SAMPLES = 200
_NEIGHBORS = 5  # steps on each side that determine the local speed
_MIN_STEP = 0.3  # least step, relative to the usual largest, at which a jump is distinguishable from noise
_MAX_SPREAD = 0.15  # largest median difference between neighboring steps, relative to a step
_MIN_JUMP = 1.7  # ratio to neighboring steps from which a step is a jump
_MAX_JUMPS = 0.1  # share of steps; more jumps belong to the motion or to an encoder's steps
_FINE, _MAX_FINE = 4.0, 0.25  # encoder steps per motion step above which a larger share may be jumps
_MIN_JUMPS = 3
_MAX_OFF, _MIN_WHOLE = 0.25, 0.8  # deviation of a jump from whole steps, and share of the jumps within it


def time_offset(data: ChannelData, model: Model | None) -> str | None:
    """Report a time shift between effort and motion that alone explains the model's error; None otherwise.

    The model is fitted to the effort with a shifted motion. A model that lacks an effect rarely leads to a
    warning, since no shift reduces its error to the noise.

    Args:
        data: the channel.
        model: the base model; the check only applies to models without inner parameters.
    """
    is_linear = model is not None and bool(model.gains) and not model.inner
    if model is None or not is_linear or not all(effect.applies_to(data) for effect in model.effects):
        return None
    # Use the first whole runs within the limit of samples, or the first samples of the first run.
    runs, counts = np.unique(data.run, return_counts=True)
    subset = data.of_runs(runs[: max(1, int(np.searchsorted(np.cumsum(counts), _MAX_SAMPLES, "right")))])
    data = subset.select(np.arange(min(len(subset), _MAX_SAMPLES)))
    step_s = sample_time(data.time_s, data.run)
    max_s = min(_MAX_SHIFT_S, _MAX_SHIFT * step_s)
    # Use samples whose motion is known for that time before and after; a contact must be pressed throughout.
    rows = np.ones(len(data), dtype=np.bool_)
    for run in blocks(data.run):
        time_s = data.time_s[run]
        rows[run] = (time_s >= time_s[0] + max_s) & (time_s <= time_s[-1] - max_s)
    if data.kind is ChannelKind.CONTACT:
        width = 2 * int(np.ceil(max_s / step_s)) + 1
        rows &= np.convolve(data.engaged, np.ones(width, dtype=np.int64), "same") == width
    if 2.0 * step_s > max_s or np.sum(rows) < _MIN_SAMPLES:
        return None
    columns = model.regression(data, {}).columns

    def fit_shifted(delay_s: float) -> tuple[float, FloatArray]:
        """Return the root mean square residual of the shifted model, and the residuals."""
        shifted = shift(columns, data.time_s, data.run, delay_s)[rows]
        residuals = data.effort[rows] - shifted @ solve(shifted, data.effort[rows])
        return float(np.sqrt(np.mean(residuals**2))), residuals

    (recorded, residuals), every = fit_shifted(0.0), np.ones(np.count_nonzero(rows), dtype=np.bool_)
    noise = noise_between_samples(residuals, data.run[rows], every)
    if recorded < _MIN_GAIN * noise:
        return None
    grid_s = np.linspace(-max_s, max_s, _COARSE)
    rough_s, width_s = grid_s[np.argmin([fit_shifted(s)[0] for s in grid_s.tolist()])], grid_s[1] - grid_s[0]
    best_s = float(
        scipy.optimize.minimize_scalar(
            lambda delay_s: fit_shifted(delay_s)[0],
            bounds=(rough_s - width_s, rough_s + width_s),
            method="bounded",
            options={"xatol": 0.1 * step_s},
        ).x
    )
    error, residuals = fit_shifted(best_s)
    noise = noise_between_samples(residuals, data.run[rows], every)
    is_noise = 0.0 < error < _MAX_EXCESS * noise and recorded > _MIN_GAIN * error
    if not is_noise or np.sum(rows) * ((recorded / error) ** 2 - 1.0) < _MIN_CHI2:
        return None
    unit, side = data.effort_unit, "late" if best_s > 0.0 else "early"
    return (
        f"the effort is {1e3 * abs(best_s):.2g} ms {side} relative to the motion: the error of {model.name} "
        f"is {with_unit(recorded, unit)} as recorded, and falls to the noise level of "
        f"{with_unit(error, unit)} if the effort is shifted by this time; align effort and motion in the file"
    )


def lost_rows(data: ChannelData) -> str | None:
    """Report missing rows in data with even time steps, at which the motion jumps by several steps.

    If rows were lost and the times renumbered, the recorded motion is faster than the real one.

    Args:
        data: the channel.
    """
    if len(data) < _MIN_SAMPLES or not is_even(data.time_s, data.run):
        return None
    steps, typical, spread = np.zeros(len(data)), np.zeros(len(data)), np.zeros(len(data))
    for rows in blocks(data.run):
        if rows.stop - rows.start > 2 * _NEIGHBORS + 1:
            step = np.diff(data.position[rows])
            steps[rows.start : rows.stop - 1] = step
            inner = slice(rows.start + _NEIGHBORS, rows.stop - 1 - _NEIGHBORS)
            windows = sliding_window_view(step, 2 * _NEIGHBORS + 1)
            typical[inner] = np.median(windows, axis=1)
            spread[inner] = np.median(np.abs(windows - typical[inner, None]), axis=1)
    # At a reversal, steps differ although no row is lost.
    is_steady = spread <= _MAX_SPREAD * np.abs(typical)
    is_fast = is_steady & (np.abs(typical) > _MIN_STEP * float(np.quantile(np.abs(typical), 0.95)))
    if np.sum(is_fast) < _MIN_SAMPLES // 2:
        return None
    ratio = steps[is_fast] / typical[is_fast]
    jumps = ratio > _MIN_JUMP
    is_regular = float(np.median(np.abs(ratio - 1.0))) < _MAX_SPREAD
    is_fine = float(np.median(np.abs(typical[is_fast]))) > _FINE * grid_step(data.position)
    max_share = _MAX_FINE if is_fine else _MAX_JUMPS
    if not is_regular or np.sum(jumps) < _MIN_JUMPS or np.mean(jumps) > max_share:
        return None
    if np.sum(ratio < 2.0 - _MIN_JUMP) > _MAX_JUMPS * np.sum(jumps):  # noise causes as many short steps
        return None
    if np.mean(np.abs(ratio[jumps] - np.round(ratio[jumps])) < _MAX_OFF) < _MIN_WHOLE:
        return None
    lost = float(np.sum(ratio[jumps] - 1.0)) / len(ratio)
    return (
        f"the motion jumps by {np.median(ratio[jumps]):.2g} steps at {np.sum(jumps)} places although the "
        f"times are evenly spaced. About {100.0 * lost:.1f} % of the rows therefore seem to be lost, and "
        "effects of the velocity are estimated wrongly; record all rows, or restore the true times"
    )
