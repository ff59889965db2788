"""Residual diagnostics that a flexible regression on the signals cannot replace.

They detect runs that follow different laws, and residuals that oscillate or exceed the noise. The cause of a
difference between runs (another specimen, zero or sensor) is not among the signals, so a regression on them
cannot reveal it. Oscillations and errors of few samples do not depend on any signal either.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

from palpate.estimation.budget.held_out import fit_each_run
from palpate.estimation.budget.laws import periodic_columns
from palpate.estimation.channel import ChannelKind
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.bootstrap import bootstrap_samples, sequential_test
from palpate.estimation.estimate import rounded, with_unit
from palpate.estimation.fit.blocks import BlockedData, is_moving
from palpate.estimation.fit.fit_problem import held_out_residual, rmse
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import MeasurementModel, with_derived_signals
from palpate.estimation.fit.measurement_noise import (
    MeasurementNoise,
    RunHeterogeneity,
    fast_noise,
    free_air_noise,
    measurement_noise,
    rows_before_contact,
    run_heterogeneity,
    size_of_differences,
)
from palpate.estimation.signals.blocks import block_index, number_stretches, rows_of_runs
from palpate.estimation.signals.periodicity import strongest_frequency
from palpate.estimation.signals.runwise import sample_time
from palpate.estimation.statistics.noise import robust_sigma
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_CLEARLY = 0.5  # largest error of separately fitted runs, relative to the noise level, for incomplete models
# Least ratio of a residual to bootstrap samples. The second applies if only white noise could be estimated,
# because slower noise is then missing from the samples.
_EXCESS, _EXCESS_OF_WHITE = 2.5, 3.0
_MAX_DEVIATION = 4.0  # greatest deviation that counts as noise, in robust standard deviations
_EXCESS_OF_LINE = 3.0  # least ratio of an error to its part without an oscillation
_MIN_SHARED = 0.5  # least share of the residual's variance that neighboring blocks have in common
_SAMPLES = 4  # number of bootstrap samples; the largest one is compared
_SMOOTH_GROWTH = 1.6  # growth of differences at twice the distance; a random walk, the slowest noise: sqrt(2)
_NEGLIGIBLE = 0.1  # largest share of the residual that errors of the motion cause where they do not matter
_MIN_REACH = 0.05  # least share of the longest run over which differences must grow
_MIN_BLOCKS = 40  # blocks needed in contact and in free air, or in motion and at rest
_PROMINENT = 40.0  # height of a spectral line relative to the median around it; noise reaches 10
_MAX_RUNS = 30  # largest number of runs that are fitted with separate waves
_EXPLAINS = 1.1  # largest error with one gain of each run, relative to that of runs fitted alone
_NEARLY_NOISE = (
    2.0  # largest error of runs fitted alone, relative to the noise; above it, an effect is missing
)
_DISTINCT = 1.5  # least ratio of the error with the next best gain
_GAIN_OF_WAVES = 0.7  # largest error with waves fitted to each run, relative to the model's error
_FEW = 0.05  # share of the samples with the largest errors
_PEAKED = 0.8  # least share of the squared error in these samples that is not noise; normal noise has 0.28
RARE_EVENTS = "rare events"  # signal of an error that is concentrated in few samples
_PEAK = 0.2  # least share of the variance at a reported frequency


@dataclass(frozen=True)
class ResidualFinding:
    """Reason why a model is incomplete although no flexible regression improves it."""

    reason: str  # reason in words
    depends_on: str  # quantity on which the residual depends
    fits_each_run: bool = False  # whether the model explains each run alone, but with different gains


def check_residuals(
    end: FitResult, measurement: MeasurementModel, rng: np.random.Generator, *, complete: bool
) -> ResidualFinding | None:
    """Check the residual for evidence that does not depend on any signal of the data; None if there is none.

    Args:
        end: the model.
        measurement: how motion and effort were measured.
        rng: random generator for bootstrap samples.
        complete: whether no flexible regression improves it; else only clear differences between runs count.
    """
    unit = end.data.effort_unit
    heterogeneity = run_heterogeneity(end.problem.blocked, end.solution)
    if not complete and not (heterogeneity and heterogeneity.alone < _CLEARLY * end.floor()):
        return None
    if complete and (left := _error_with_own_waves(end)) is not None:
        return ResidualFinding(
            "the error is periodic in position, with a different phase in each run. With a wave fitted to "
            f"each run, the error would be {with_unit(left, unit)}; start each run from the same reference "
            "position",
            "run",
        )
    if heterogeneity and _is_heterogeneous(heterogeneity, end, measurement, rng):
        return ResidualFinding(
            f"the runs do not follow one law: run {heterogeneity.run} has an error of "
            f"{with_unit(heterogeneity.run_predicted, unit)} when predicted from the other runs, but "
            f"{with_unit(heterogeneity.run_alone, unit)} when fitted alone; did "
            "something change between the runs, such as the object or a sensor?",
            "run",
            fits_each_run=True,
        )
    excess = exceeds_noise(end, measurement, rng)
    if not excess:
        return _oscillation(end)
    swings = f"; it oscillates at {excess.frequency_hz:.3g} Hz" if excess.frequency_hz else ""
    return ResidualFinding(
        f"the residual {excess.where}, {with_unit(excess.acting, unit)}, is "
        f"{excess.acting / excess.expected:.0f} times the noise {excess.reference} and does not "
        f"look like noise{swings}; no signal of the data explains it",
        "time",
    )


def differing_parameter(fit: FitResult) -> str | None:
    """Name the gain that differs between runs, with its range; None unless exactly one explains the error.

    A gain explains it if the model leaves, with another value of this gain in each run, about the error of
    runs that are fitted alone, and clearly less than with any other gain.

    Args:
        fit: a model without differences between runs.
    """
    heterogeneity = run_heterogeneity(fit.problem.blocked, fit.solution)
    if heterogeneity is None or heterogeneity.alone > _NEARLY_NOISE * measurement_noise(fit).value:
        return None
    model = fit.solution.model
    slopes, effort = model.linearize(fit.problem.blocked.data, fit.solution.parameters)
    rows = heterogeneity.own_residual != 0.0
    run = np.unique(fit.problem.blocked.data.run[rows], return_inverse=True)[1]
    residual = (fit.problem.blocked.data.effort - effort)[rows]
    columns = {name: slopes[rows, k] for k, name in enumerate(model.gains) if name not in model.held}
    if not any(np.ptp(column) == 0.0 for column in columns.values()):
        columns[""] = np.ones(len(run))  # the zero of each run
    errors, ranges = dict[str, float](), dict[str, tuple[float, float]]()
    for name, column in columns.items():
        own = column[:, None] * (run[:, None] == np.arange(run.max() + 1))
        design = np.column_stack([*(other for key, other in columns.items() if key != name), own])
        scale = np.linalg.norm(design, axis=0)
        scale[scale == 0.0] = 1.0
        gains = np.linalg.lstsq(design / scale, residual, rcond=None)[0] / scale
        values = fit.solution.parameters.get(name, 0.0) + gains[-own.shape[1] :]
        errors[name], ranges[name] = rmse(residual - design @ gains), (values.min(), values.max())
    best, *others = sorted(errors, key=errors.__getitem__)
    limit = _EXPLAINS * heterogeneity.alone
    if errors[best] > limit or (others and errors[others[0]] < _DISTINCT * errors[best]):
        return None
    low, high = ranges[best]
    unit = model.gains[best].unit_of(fit.data) if best else fit.data.effort_unit
    return f"{best or 'the zero'} ({low:.3g} to {with_unit(high, unit)})"


def _error_with_own_waves(end: FitResult) -> float | None:
    """Return the error with position-periodic waves fitted to each run [effort]; None without improvement."""
    blocked, used = end.problem.blocked, end.problem.used
    runs = len(np.unique(blocked.run[used]))
    if end.data.kind is ChannelKind.CONTACT or not 1 < runs <= _MAX_RUNS:
        return None
    run, position = blocked.run[used], blocked.reduce(end.data.position)[used]
    residual = end.solution.residual[used]
    waves = periodic_columns(position, residual, is_angle=end.data.kind.is_angle, run=run)
    zero, number = np.ones((len(residual), 1)), np.unique(run, return_inverse=True)[1]
    left = fit_each_run(residual, np.hstack([zero, waves]), number)
    is_better = rmse(left) < _GAIN_OF_WAVES * rmse(fit_each_run(residual, zero, number))
    return end.rmse * rmse(left) / rmse(residual) if is_better else None


def periodic_component(end: FitResult) -> tuple[float, float] | None:
    """Find the residual's strongest spectral line, frequency [Hz] and share of the variance; None if weak.

    Args:
        end: the model.
    """
    blocked = end.problem.blocked
    line = _strongest_line(blocked, blocked.reduce(held_out_residual(blocked, end.solution)))
    return None if line is None or line[1] < _PEAK or line[2] < _PROMINENT else line[:2]


def _strongest_line(blocked: BlockedData, residual: FloatArray) -> tuple[float, float, float] | None:
    """See `strongest_frequency`; the residual is given on blocks, shape (m,)."""
    step_s = sample_time(blocked.data.time_s, blocked.data.run) * blocked.rows.shape[1]
    return strongest_frequency(blocked.time_s, blocked.run, residual, step_s)


def _oscillation(end: FitResult) -> ResidualFinding | None:
    """Report an oscillation of the residual that exceeds the noise in free air; None without one."""
    line, unit = periodic_component(end), end.data.effort_unit
    if line is None:
        return None
    size, remainder = np.sqrt(line[1]) * end.rmse, np.sqrt(1.0 - line[1]) * end.rmse
    in_air = (1.0 + SMALL) * (free_air_noise(end.data) or 0.0)
    if end.rmse <= min(in_air, _EXCESS_OF_LINE * remainder):
        return None
    return ResidualFinding(
        f"the error oscillates at {line[0]:.3g} Hz with {with_unit(size, unit)} rms, but no signal of the "
        "data oscillates at this frequency",
        "time",
    )


def find_rare_events(end: FitResult, noise: MeasurementNoise) -> ResidualFinding | None:
    """Report an error concentrated in few samples; None without one, or if it is within measured noise.

    Args:
        end: a model that no flexible regression improves.
        noise: noise level of the channel.
    """
    squares = np.sort(end.solution.residual[end.problem.used] ** 2)
    share = float(squares[int((1.0 - _FEW) * len(squares)) :].sum() / max(squares.sum(), 1e-300))
    is_noise = not noise.is_bound and end.rmse <= _EXCESS * noise.value
    if share < _PEAKED or is_noise:
        return None
    return ResidualFinding(
        f"{100 * _FEW:.0f} % of the samples hold {100 * share:.0f} % of the squared error, as "
        "happens after impacts, a breakaway or lost readings; look at the effort where the error is largest",
        RARE_EVENTS,
    )


def find_excess_error(end: FitResult, noise: MeasurementNoise, by_motion: float) -> ResidualFinding | None:
    """Report an error far above a measured noise that no other check finds; None without one.

    Slow noise may be missing from a noise that was estimated from neighboring readings.

    Args:
        end: a model that no flexible regression improves.
        noise: noise level of the channel.
        by_motion: error that smoothing and encoder steps of the motion may cause in addition [effort].
    """
    if noise.is_bound or end.rmse <= np.hypot(_EXCESS_OF_WHITE * noise.value, by_motion):
        return None
    return ResidualFinding(
        f"the residual is {rounded(end.rmse / noise.value, 2)} times the noise, and no signal of the data "
        "explains it",
        "time",
    )


def _is_heterogeneous(
    heterogeneity: RunHeterogeneity, end: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> bool:
    """Test whether runs differ more than runs simulated from one law."""

    def excess(heterogeneity: RunHeterogeneity | None) -> float:
        return heterogeneity.predicted / heterogeneity.alone - 1.0 if heterogeneity else 0.0

    def statistics() -> Iterator[float]:
        while True:
            noise = end.problem.blocked.reduce(heterogeneity.noise(rng))
            problem, solution = next(bootstrap_samples(end, measurement, rng, noise))
            yield excess(run_heterogeneity(problem.blocked, solution, 0.0))

    return sequential_test(excess(heterogeneity), statistics()).is_significant


@dataclass(frozen=True)
class ExcessVariance:
    """Residual variance in contact, after it, or while a joint moves, that exceeds the noise."""

    acting: float  # root mean square residual in this condition, on blocks [effort]
    expected: float  # the same for bootstrap samples with the reference noise [effort]
    frequency_hz: float | None  # frequency of an oscillation; None if there is none
    where: str  # "in contact", "after contact" or "in motion"
    reference: str  # condition in which the noise was measured, such as "in free air"


@dataclass(frozen=True)
class _Condition:
    """Blocks whose residual is compared with the noise, and blocks that show the noise alone."""

    where: str  # as in `ExcessVariance`
    acting: BoolArray  # shape (m,)
    still: BoolArray  # shape (m,)
    reference: str  # as in `ExcessVariance`
    stretch: IntArray | None = None  # stretch of each block (m,) whose mean is subtracted; None for no mean

    def residual(self, values: FloatArray) -> FloatArray:
        """Return residuals without the mean of each stretch on the blocks of this condition, shape (m,).

        Args:
            values: residual of each block, shape (m,); returned itself if no mean is subtracted.
        """
        if self.stretch is None:
            return values
        left = values.copy()
        left[self.acting] = _about_means(values, self.stretch, self.acting)
        return left


def exceeds_noise(
    fit: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> ExcessVariance | None:
    """Compare the residual in contact with the noise in free air; None if it does not exceed the noise.

    The residual just after a contact is compared with the noise before it, since the object may still pull
    the tool. For a joint, the residual in motion is compared with the noise at rest. Without free air or
    rest, white noise is estimated from differences of neighboring readings. Noise may grow with the effort,
    so only the part of the residual that neighboring blocks share is compared. Bootstrap samples include
    errors of the measured motion, such as encoder steps.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
        rng: for bootstrap samples.
    """
    blocked = fit.problem.blocked
    residual = blocked.reduce(held_out_residual(blocked, fit.solution))
    usable = blocked.trusted & np.isfinite(residual)
    excesses = (
        _excess(fit, measurement, rng, np.where(usable, residual, np.nan), condition)
        for condition in _conditions(blocked, usable)
    )
    return next((excess for excess in excesses if excess), None)


def _conditions(blocked: BlockedData, usable: BoolArray) -> list[_Condition]:
    """List the conditions that are compared with the noise; `usable` is the mask (m,) of scored blocks."""
    if blocked.data.kind is not ChannelKind.CONTACT:
        moving = is_moving(blocked.data, blocked.rows)
        return [_Condition("in motion", usable & moving, usable & ~moving, "at rest")]
    engaged = blocked.data.engaged[blocked.rows]
    touched = np.asarray(engaged.any(axis=1))
    free = ~touched
    contact = _Condition("in contact", usable & engaged.all(axis=1), usable & free, "in free air")
    early = np.zeros(len(blocked.data), dtype=np.bool_)
    early[np.concatenate([np.empty(0, dtype=np.int64), *rows_before_contact(blocked.data)])] = True
    before = usable & early[blocked.rows].all(axis=1)
    if before.sum() < _MIN_BLOCKS:
        return [contact]
    # Compare stretches of equal length about their means: slow noise grows with the length of a stretch, and
    # the zero of a sensor may drift during a contact.
    after = np.zeros_like(touched)
    for rows in rows_of_runs(blocked.run):
        after[rows] = free[rows] & np.logical_or.accumulate(touched[rows])
    stretch = number_stretches(after, blocked.run)
    first, number = block_index(stretch)
    run = np.unique(blocked.run, return_inverse=True)[1]
    is_early = np.arange(len(blocked)) - first[number] < np.bincount(run, weights=before)[run]
    return [contact, _Condition("after contact", usable & after & is_early, before, "in free air", stretch)]


def _excess(
    fit: FitResult,
    measurement: MeasurementModel,
    rng: np.random.Generator,
    residual: FloatArray,
    condition: _Condition,
) -> ExcessVariance | None:
    """Compare the residual (m,), which is NaN on unused blocks, with the noise under one condition."""
    blocked, acting = fit.problem.blocked, condition.acting
    if acting.sum() < _MIN_BLOCKS:
        return None
    left = condition.residual(residual)
    slow = _shared_by_neighbors(left, blocked.run, acting)
    if slow**2 < _MIN_SHARED * rmse(left[acting]) ** 2:
        return None
    reference, least = condition.reference, _EXCESS
    # A sensor that reads the same everywhere in free air does not show its noise there.
    if condition.still.sum() >= _MIN_BLOCKS and np.any(
        still := _without_outliers(residual, blocked.run, condition.still)
    ):
        noise = still
    elif np.any(air := _free_air_on_blocks(blocked)):
        noise = air
    elif white := _white_noise(fit, residual, measurement, rng):
        noise, reference = rng.normal(0.0, white, len(blocked)), "of neighboring readings"
        least = _EXCESS_OF_WHITE
    else:
        return None
    simulated = []
    samples = bootstrap_samples(fit, measurement, rng, np.resize(noise, len(blocked)))
    for problem, solution in islice(samples, _SAMPLES):
        sample = problem.blocked.reduce(held_out_residual(problem.blocked, solution))
        simulated.append(rmse(condition.residual(sample)[acting]))
    expected = float(np.median(simulated))
    if expected == 0.0 or slow < least * max(simulated):  # equal readings do not show their noise here either
        return None
    line = _strongest_line(blocked, np.where(acting, left, np.nan))
    frequency_hz = line[0] if line and line[1] > _PEAK else None
    size = rmse(left[acting])
    return ExcessVariance(size, expected, frequency_hz, condition.where, reference)


def _free_air_on_blocks(blocked: BlockedData) -> FloatArray:
    """Return block averages of the effort before contact about the mean of each run, shape (k,)."""
    data, block, means = blocked.data, blocked.rows.shape[1], [np.empty(0)]
    if data.kind is ChannelKind.CONTACT:
        for rows in rows_before_contact(data):
            readings = data.effort[rows[: len(rows) // block * block]]
            # Equal readings must give zeros without rounding errors.
            block_means = (readings - readings[:1]).reshape(-1, block).mean(axis=1)
            means.append(block_means - block_means.mean())
    return np.concatenate(means)


def _motion_noise(fit: FitResult, measurement: MeasurementModel, rng: np.random.Generator) -> float:
    """Return the error of the prediction that errors of the measured motion cause [effort]."""
    motions = (measurement.simulate(rng), measurement.simulate(rng, share=0.0))
    efforts = [
        fit.model.predict(with_derived_signals(motion, fit.data), fit.solution.parameters)
        for motion in motions
    ]
    return rmse(fit.problem.blocked.reduce(np.subtract(*efforts))[fit.problem.used])


def _white_noise(
    fit: FitResult, residual: FloatArray, measurement: MeasurementModel, rng: np.random.Generator
) -> float | None:
    """Return the standard deviation of the white part of a residual (m,); None if all may be noise."""
    # Differences of white noise do not depend on the distance, and those of a random walk grow by sqrt(2) if
    # it doubles. Faster growth indicates a smooth signal, except over a small part of a run, where it may be
    # noise of a filtered sensor. P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77 (1990).
    blocked = fit.problem.blocked
    if white := fast_noise(fit.data):
        return white / float(np.sqrt(blocked.rows.shape[1]))
    runs = rows_of_runs(blocked.run)
    longest = max(len(rows) for rows in runs)
    widest = max((half for windows in fit.filters for half, _ in windows), default=0)
    if widest and _motion_noise(fit, measurement, rng) <= _NEGLIGIBLE * rmse(residual):
        widest = 0
    distance, sizes = 1 + widest // blocked.rows.shape[1], []
    while 6 * distance <= longest:
        size = size_of_differences([residual[rows] for rows in runs], distance)
        if size is None:
            break
        sizes.append((distance, size))
        distance *= 2
    grows = [after > _SMOOTH_GROWTH * before for (_, before), (_, after) in pairwise(sizes)]
    if not any(grows):
        return None
    largest = max(size for _, size in sizes)
    reach = next(distance for distance, size in sizes if size >= 0.5 * largest)
    return sizes[grows.index(True)][1] if 3 * reach >= _MIN_REACH * longest else None


def _about_means(residual: FloatArray, run: IntArray, chosen: BoolArray) -> FloatArray:
    """Subtract the mean of each run or stretch from the residual on chosen blocks, (k,), in their order."""
    parts = [residual[chosen & (run == number)] for number in np.unique(run[chosen])]
    return np.concatenate([part - part.mean() for part in parts])


def _without_outliers(residual: FloatArray, run: IntArray, chosen: BoolArray) -> FloatArray:
    """Return the residual on chosen blocks about each run's median, (k,), with outliers moved to a limit."""
    parts = [residual[chosen & (run == number)] for number in np.unique(run[chosen])]
    noise = np.concatenate([part - np.median(part) for part in parts])
    # P. J. Huber, Robust Statistics (1981). There is no limit if most blocks are equal, as at rest.
    limit = _MAX_DEVIATION * robust_sigma(noise) or np.inf
    return np.asarray(np.clip(noise, -limit, limit))


def _shared_by_neighbors(residual: FloatArray, run: IntArray, chosen: BoolArray) -> float:
    """Return the root mean square of the part that neighboring blocks share [effort]; 0 for white noise."""
    pairs = chosen[1:] & chosen[:-1] & (run[1:] == run[:-1])
    if pairs.sum() < _MIN_BLOCKS // 2:
        return 0.0
    return float(np.sqrt(max(np.mean(residual[1:][pairs] * residual[:-1][pairs]), 0.0)))
