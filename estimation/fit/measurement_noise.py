"""Noise of a channel: the residual of a complete model.

Noise of the effort is estimated from free air, or from frequencies above those of the motion if there is no
free air or the noise grows with the effort. Reading errors of the motion add noise through the model. Both
are estimated with the base model, so they do not depend on added effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate import with_unit
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.fit_problem import Solution, held_out_residual, rmse
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import identify_measurement_model, with_derived_signals
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.motion import is_constant_in_runs
from palpate.robot_io.types import FloatArray, IntArray

MIN_RATIO = 1.25  # least ratio of a run's predicted error to its own error; smaller ratios are not tested
_SAMPLES_PER_VALUE = 2  # least number of samples per fitted value in a run that is fitted alone


@dataclass(frozen=True)
class RunHeterogeneity:
    """Runs that do not follow one law."""

    run: int  # the run with the largest ratio of the predicted error to the error when fitted alone
    predicted: float  # root mean square error of all runs, each predicted from the others
    alone: float  # the same with each run fitted alone
    own_residual: FloatArray  # residual of each run fitted alone, shape (n,); 0 if a run is too short
    # Rows (k,) of each run that was fitted alone, and an orthonormal basis (k, p) of what its fit can remove.
    fits: Sequence[tuple[IntArray, FloatArray]]
    run_predicted: float  # error of `run`, predicted from the others
    run_alone: float  # the same, fitted alone

    def noise(self, rng: np.random.Generator) -> FloatArray:
        """Return the residuals of the runs with random values in place of what their fits removed, (n,).

        Without these, the noise of a short run would have too little variance at low frequencies.

        Args:
            rng: random generator.
        """
        noise = self.own_residual.copy()
        for rows, basis in self.fits:
            count, removed = basis.shape
            deviation = np.sqrt(np.sum(noise[rows] ** 2) / (count - removed))
            noise[rows] += basis @ rng.normal(0.0, deviation, removed)
        return noise


def run_heterogeneity(
    blocked: BlockedData, solution: Solution, least: float = MIN_RATIO
) -> RunHeterogeneity | None:
    """Measure how much runs disagree about gains and zero; None below `least`, or with too few long runs.

    The effort must change within runs, because a zero of each run always fits a constant.

    Args:
        blocked: the channel on blocks.
        solution: the model fitted to all runs.
        least: least ratio of the error predicted from other runs to the error of runs fitted alone.
    """
    data = blocked.data
    if is_constant_in_runs(data):
        return None
    predicted = held_out_residual(blocked, solution)
    slopes, effort = solution.model.linearize(data, solution.parameters)
    free = [name not in solution.model.held for name in solution.model.gains]
    slopes = np.column_stack([slopes[:, free], np.ones(len(data))])  # each run may have its own zero
    residual = data.effort - effort
    alone, own_residual = np.full(len(data), np.nan), np.zeros(len(data))
    fits: list[tuple[IntArray, FloatArray]] = []
    for run_rows in rows_of_runs(data.run):
        rows = run_rows[np.isfinite(predicted[run_rows])]
        scale = np.linalg.norm(slopes[rows], axis=0)
        columns = slopes[rows] / np.where(scale > 0.0, scale, 1.0)
        directions, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        basis = directions[:, sizes > np.finfo(float).eps * max(columns.shape) * sizes.max(initial=0.0)]
        count, rank = basis.shape
        if count < _SAMPLES_PER_VALUE * max(rank, 1):
            predicted[rows] = np.nan  # too short to be fitted alone
            continue
        own_residual[rows] = residual[rows] - basis @ (basis.T @ residual[rows])
        alone[rows] = own_residual[rows] * np.sqrt(count / (count - rank))
        fits.append((rows, basis))
    if len(fits) < 2 or not rmse(predicted) > least * rmse(alone):
        return None
    errors = [(rmse(predicted[rows]), rmse(alone[rows])) for rows, _ in fits]
    worst = int(np.argmax([together**2 - single**2 for together, single in errors]))
    run = int(data.run[fits[worst][0][0]])
    return RunHeterogeneity(run, rmse(predicted), rmse(alone), own_residual, fits, *errors[worst])


_FREE_AIR_SHARE = 0.9  # share of the samples before a contact that is used; the last ones may be in contact
_MIN_SAMPLES = 50  # samples needed for an estimate
# Short stretches before contact underestimate slow noise, and are only used if the long ones are few.
_MIN_IN_RUN, _ENOUGH = 20, 200
_GROWTH = 1.2  # ratio of the noise of all readings to that in free air above which it grows with the effort
_DIFFERENCES = (1.0, -3.0, 3.0, -1.0)  # third difference of neighboring readings, which removes smooth motion
# Quantile up to which differences are used, and the RMS of normal noise up to it in standard deviations.
_QUANTILE, _RMS_BELOW_QUANTILE = 0.99, 0.9616
_JUMP_RATIO = 5.0  # ratio to the mean distance between readings above which the motion jumps
_REVERSAL = 0.1  # speed, relative to the root mean square, below which a joint may reverse
_CLEARLY_BELOW = 0.95  # ratio to a bound of the noise below which an error is the better bound
_WHITE_RATIO = 1.2  # ratio of differences at twice the distance up to which they contain no motion
_REPEATED = 0.01  # largest difference between runs with the same motion, relative to the range of positions
# Ratio of the noise from repeated runs to that from neighboring readings above which part of it is slow.
_SLOW_NOISE_RATIO = 1.5
_SHOWS = 1.1  # ratio of the noise to that of the effort above which errors of the motion are stated
_SEED = 0  # seed of simulated readings: a channel always has the same noise


class NoiseSource(StrEnum):
    """How the noise of a channel was estimated."""

    FREE_AIR = "free air"
    NEIGHBORS = "neighboring readings"  # differences, which contain only noise faster than the motion
    REPEATS = "repeated runs"  # an upper bound: runs may differ by more than noise
    EACH_RUN = "runs fitted by themselves"  # an upper bound: the base model may be incomplete in each run
    FLEXIBLE = "a flexible regression"  # an upper bound: it may not follow every signal
    MODEL = "the model's own error"  # an upper bound: it contains the noise


@dataclass(frozen=True)
class MeasurementNoise:
    """Noise level of a channel, root mean square [effort]."""

    value: float  # residual of a complete model, or an upper bound of it
    source: NoiseSource
    effort: float | None  # noise of the effort itself; None if only an upper bound of the total is known
    motion: float  # noise of the prediction due to reading errors of the motion, for the base model

    @property
    def is_bound(self) -> bool:
        """Whether `value` is an upper bound of the noise."""
        return self.effort is None

    def below(self, error: float) -> "MeasurementNoise":
        """Return the noise; if only an upper bound is known, it is also below the error of every model.

        Args:
            error: error of a model in held-out runs [effort].
        """
        if not self.is_bound or error >= self.value:
            return self
        source = NoiseSource.MODEL if error < _CLEARLY_BELOW * self.value else self.source
        return replace(self, value=error, source=source)

    @property
    def includes_motion(self) -> bool:
        """Whether reading errors of the motion are a relevant part of a known noise."""
        return self.effort is not None and self.value > _SHOWS * self.effort

    def describe(self, unit: str) -> str:
        """Return the noise in words, see `describe_noise`.

        Args:
            unit: unit of the effort.
        """
        return describe_noise(
            with_unit(self.value, unit), self.source, at_most=self.is_bound, motion=self.includes_motion
        )


def describe_noise(size: str, source: NoiseSource, *, at_most: bool, motion: bool) -> str:
    """Describe a noise level: "at most 0.031 N, from repeated runs".

    Args:
        size: noise level with its unit.
        source: method of estimation.
        at_most: whether the level is only an upper bound.
        motion: whether reading errors of the motion are a relevant part of it.
    """
    cause = f"{source.value} and errors of the motion" if motion else source.value
    return f"{'at most ' if at_most else ''}{size}, from {cause}"


_KNOWN = WeakKeyDictionary[FitResult, MeasurementNoise]()


def measurement_noise(base: FitResult) -> MeasurementNoise:
    """Return the noise of a channel, which is estimated once for each fit.

    Args:
        base: the base model fitted to the channel, without added effects.
    """
    if base not in _KNOWN:
        _KNOWN[base] = _estimate_noise(base)
    return _KNOWN[base]


def _estimate_noise(base: FitResult) -> MeasurementNoise:
    data = base.data.select(np.isin(base.data.run, base.data.run[base.scored]))  # the scored runs
    bound, source = base.smooth_law_error, NoiseSource.FLEXIBLE
    differences = []  # differences between the residuals of runs with the same motion
    residual = base.data.effort - base.predict(base.solution.parameters)
    position = base.data.position
    for first, second in pairwise(rows_of_runs(base.data.run)):
        count = min(len(first), len(second))
        earlier, later = first[:count], second[:count]
        distance = rmse(position[earlier] - position[later]) if count >= _MIN_SAMPLES else np.inf
        scored = base.scored[earlier] & base.scored[later]
        if distance <= _REPEATED * float(np.ptp(position)) and scored.any():
            differences.append((residual[earlier] - residual[later])[scored])
    repeated = rmse(np.concatenate(differences)) / np.sqrt(2.0) if differences else np.inf
    if repeated < bound:
        bound, source = repeated, NoiseSource.REPEATS
    alone = run_heterogeneity(base.problem.blocked, base.solution, least=0.0)
    if base.validation is None and alone is not None and alone.alone < bound:
        bound, source = alone.alone, NoiseSource.EACH_RUN
    # Compute the change of the prediction with a simulated measurement of the same motion.
    measurement = identify_measurement_model(base.data)
    smooth, simulated = (
        base.model.predict(with_derived_signals(motion, base.data), base.solution.parameters)
        for motion in (measurement.smoothed_motion, measurement.simulate(np.random.default_rng(_SEED)))
    )
    # Where reading errors make or break contact, the prediction jumps at the surface of the base model.
    is_contact = base.data.kind is ChannelKind.CONTACT
    jumps = is_contact & ((smooth == 0.0) != (simulated == 0.0))
    motion_noise = rmse(np.where(base.scored & ~jumps, simulated - smooth, np.nan))
    air, fast = free_air_noise(data), fast_noise(data)
    # A sensor that reads zero in free air does not show its noise. Both estimates vary by chance.
    if air and _CLEARLY_BELOW * air <= bound:
        effort, effort_source = min(air, bound), NoiseSource.FREE_AIR
        if fast and fast > _GROWTH * air:
            effort, effort_source = min(fast, bound), NoiseSource.NEIGHBORS
        value = min(float(np.hypot(effort, motion_noise)), bound)
        return MeasurementNoise(value, effort_source, effort, motion_noise)
    is_slower = (
        source is NoiseSource.REPEATS and fast and bound > _SLOW_NOISE_RATIO * np.hypot(fast, motion_noise)
    )
    if fast and fast <= bound and not is_slower:
        value = min(float(np.hypot(fast, motion_noise)), bound)
        return MeasurementNoise(value, NoiseSource.NEIGHBORS, fast, motion_noise)
    return MeasurementNoise(bound, source, None, motion_noise)


def rows_before_contact(data: ChannelData) -> list[IntArray]:
    """Return the samples of each run that are clearly before its first contact, if there are enough in all.

    Args:
        data: the channel.
    """
    parts = []
    for rows in rows_of_runs(data.run):
        pressed = data.engaged[rows]
        before = rows[: int(np.argmax(pressed)) if pressed.any() else len(rows)]
        before = before[: int(_FREE_AIR_SHARE * len(before))]
        if len(before) >= _MIN_IN_RUN:
            parts.append(before)
    long = [part for part in parts if len(part) >= _MIN_SAMPLES]
    if sum(map(len, long)) >= _ENOUGH:
        return long
    return parts if sum(map(len, parts)) >= _MIN_SAMPLES else []


def free_air_noise(data: ChannelData) -> float | None:
    """Estimate the noise before the first contact of each run, about the run's mean; None if unknown.

    Args:
        data: the channel.
    """
    if data.kind is not ChannelKind.CONTACT:
        return None
    parts = [data.effort[rows] - data.effort[rows].mean() for rows in rows_before_contact(data)]
    return rmse(np.concatenate(parts)) if parts else None


def fast_noise(data: ChannelData) -> float | None:
    """Estimate white noise from third differences; None if the differences contain slower signals.

    The largest differences are excluded, since the effort may jump, as in a snap-through. If the differences
    of a joint still contain more than noise, those across its reversals are excluded, where friction jumps.
    P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77 (1990).

    Args:
        data: the channel.
    """
    speed = np.abs(data.velocity)
    may_reverse = speed < _REVERSAL * rmse(speed)
    efforts, between_reversals = list[FloatArray](), list[FloatArray]()  # in stretches of smooth motion
    for rows in rows_of_runs(data.run):
        moved = np.abs(np.diff(data.position[rows], prepend=data.position[rows[0]]))
        jumps = moved > _JUMP_RATIO * moved.mean()  # single steps between holds
        efforts += np.split(data.effort[rows], np.flatnonzero(jumps))
        between_reversals += np.split(data.effort[rows], np.flatnonzero(jumps | may_reverse[rows]))
    noise = _white_noise(efforts, (1, 2))
    if noise is None and data.kind is not ChannelKind.CONTACT:
        noise = _white_noise(between_reversals, (1, 2, 4))
    return noise


def _white_noise(efforts: Sequence[FloatArray], distances: Sequence[int]) -> float | None:
    """Return the noise of neighboring readings, or None if it is larger at a greater distance."""
    near, *far = (size_of_differences(efforts, distance) for distance in distances)
    is_white = near and all(size is not None and 0.0 < size <= _WHITE_RATIO * near for size in far)
    return near if is_white else None


def size_of_differences(signals: Sequence[FloatArray], distance: int) -> float | None:
    """Return the root mean square of third differences, scaled to the standard deviation of white noise.

    The largest differences, and those of readings that are not finite, are excluded. The result is None if
    too few remain.

    Args:
        signals: signal of each stretch, shape (n,) each.
        distance: distance between the readings of a difference [samples].
    """
    parts = []
    for signal in signals:
        count = max(len(signal) - 3 * distance, 0)
        shifted = np.stack([signal[k * distance : k * distance + count] for k in range(4)])
        parts.append(np.array(_DIFFERENCES) @ shifted)
    sizes = np.abs(np.concatenate([np.empty(0), *parts]))
    sizes = np.sort(sizes[np.isfinite(sizes)])
    if len(sizes) < _MIN_SAMPLES:
        return None
    return (
        rmse(sizes[: int(_QUANTILE * len(sizes))]) / _RMS_BELOW_QUANTILE / float(np.linalg.norm(_DIFFERENCES))
    )
