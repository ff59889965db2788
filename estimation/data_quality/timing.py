"""Check whether effort and motion share a clock, and whether rows were lost between samples."""

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.model import Model
from palpate.estimation.signals.blocks import blocks
from palpate.estimation.signals.runwise import is_even, sample_time, shift
from palpate.estimation.statistics.correlation import Misfit, misfit
from palpate.estimation.statistics.least_squares import solve

_FARTHEST_S, _MOST_SHIFTS = 0.1, 50  # largest time shift, in seconds and in samples
_COARSE = 21  # shifts of the coarse search
_NOISE = 1.06  # largest ratio of an error to the noise between samples for an adequate fit
_BETTER = 1.05  # least ratio of the errors without and with a shift
_CLEARLY = 50.0  # least chi-square with one degree of freedom: seven standard deviations
_MOST_SAMPLES = 6_000  # most samples that are used: the first whole runs
_LEAST_SAMPLES = 200
_NEIGHBOURS = 5  # steps on each side that determine the local speed
_FAST = 0.3  # least step, relative to the usual largest, at which a jump is distinguishable from noise
_REGULAR = 0.15  # largest median difference between neighboring steps, relative to a step
_JUMPS = 1.7  # ratio to neighboring steps from which a step is a jump
_MOST_JUMPS = 0.1  # share of steps; more jumps belong to the motion or to an encoder's steps
_FINE, _MOST_FINE = 4.0, 0.25  # encoder steps per motion step above which a larger share may be jumps
_FEWEST_JUMPS = 3
_WHOLE, _MOSTLY = 0.25, 0.8  # deviation of a jump from whole steps, and share of the jumps within it


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
    subset = data.of_runs(runs[: max(1, int(np.searchsorted(np.cumsum(counts), _MOST_SAMPLES, "right")))])
    data = subset.select(np.arange(min(len(subset), _MOST_SAMPLES)))
    step_s = sample_time(data.time_s, data.run)
    farthest_s = min(_FARTHEST_S, _MOST_SHIFTS * step_s)
    # Use samples whose motion is known for that time before and after; a contact must be pressed throughout.
    rows = np.ones(len(data), dtype=np.bool_)
    for run in blocks(data.run):
        time_s = data.time_s[run]
        rows[run] = (time_s >= time_s[0] + farthest_s) & (time_s <= time_s[-1] - farthest_s)
    if data.kind is ChannelKind.CONTACT:
        width = 2 * int(np.ceil(farthest_s / step_s)) + 1
        rows &= np.convolve(data.engaged, np.ones(width, dtype=np.int64), "same") == width
    if 2.0 * step_s > farthest_s or np.sum(rows) < _LEAST_SAMPLES:
        return None
    columns = model.regression(data, {}).columns

    def left(delay_s: float) -> tuple[float, Misfit]:
        """Return the root mean square residual of the shifted model, and its comparison with the noise."""
        shifted = shift(columns, data.time_s, data.run, delay_s)[rows]
        residuals = data.effort[rows] - shifted @ solve(shifted, data.effort[rows]).gains
        size = float(np.sqrt(np.mean(residuals**2)))
        return size, misfit(residuals, data.run[rows], np.ones(len(residuals), dtype=np.bool_))

    recorded, noise = left(0.0)
    if recorded < _BETTER * noise.noise:
        return None
    tried = np.linspace(-farthest_s, farthest_s, _COARSE)
    rough_s, width_s = tried[np.argmin([left(delay_s)[0] for delay_s in tried.tolist()])], tried[1] - tried[0]
    best_s = float(
        scipy.optimize.minimize_scalar(
            lambda delay_s: left(delay_s)[0],
            bounds=(rough_s - width_s, rough_s + width_s),
            method="bounded",
            options={"xatol": 0.1 * step_s},
        ).x
    )
    error, noise = left(best_s)
    is_noise = 0.0 < error < _NOISE * noise.noise and recorded > _BETTER * error
    if not is_noise or np.sum(rows) * ((recorded / error) ** 2 - 1.0) < _CLEARLY:
        return None
    unit, side = data.kind.effort_unit, "late" if best_s > 0.0 else "early"
    return (
        f"the effort is {1e3 * abs(best_s):.2g} ms {side} relative to the motion: the error of "
        f"{model.name} is {recorded:.3g} {unit} as recorded, and falls to the noise level of "
        f"{error:.3g} {unit} if shifted; align their times in the file"
    )


def lost_rows(data: ChannelData) -> str | None:
    """Report missing rows in data with even time steps, at which the motion jumps by several steps.

    If rows were lost and the times renumbered, the recorded motion is faster than the real one.

    Args:
        data: the channel.
    """
    if len(data) < _LEAST_SAMPLES or not is_even(data.time_s, data.run):
        return None
    steps, usual = np.zeros(len(data)), np.zeros(len(data))
    for rows in blocks(data.run):
        if rows.stop - rows.start > 2 * _NEIGHBOURS + 1:
            step = np.diff(data.position[rows])
            steps[rows.start : rows.stop - 1] = step
            beside = np.median(sliding_window_view(step, 2 * _NEIGHBOURS + 1), axis=1)
            usual[rows.start + _NEIGHBOURS : rows.stop - 1 - _NEIGHBOURS] = beside
    fast = np.abs(usual) > _FAST * float(np.quantile(np.abs(usual), 0.95))
    if np.sum(fast) < _LEAST_SAMPLES // 2:
        return None
    ratio = steps[fast] / usual[fast]
    jumps = ratio > _JUMPS
    regular = float(np.median(np.abs(ratio - 1.0))) < _REGULAR
    is_fine = float(np.median(np.abs(usual[fast]))) > _FINE * grid_step(data.position)
    most = _MOST_FINE if is_fine else _MOST_JUMPS
    if not regular or np.sum(jumps) < _FEWEST_JUMPS or np.mean(jumps) > most:
        return None
    if np.sum(ratio < 2.0 - _JUMPS) > _MOST_JUMPS * np.sum(jumps):  # noise causes as many short steps
        return None
    if np.mean(np.abs(ratio[jumps] - np.round(ratio[jumps])) < _WHOLE) < _MOSTLY:
        return None
    lost = float(np.sum(ratio[jumps] - 1.0)) / len(ratio)
    return (
        f"the motion jumps by {np.median(ratio[jumps]):.2g} steps at {np.sum(jumps)} places although "
        f"the times are evenly spaced: about {100.0 * lost:.1f} % of the rows seem to be lost, so "
        "effects of the velocity are estimated wrongly; record all rows, or restore the true times"
    )
