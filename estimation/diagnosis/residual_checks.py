"""Residual diagnostics that a flexible regression on the signals cannot replace.

They detect runs that follow different laws, and residuals that oscillate or exceed the noise. The cause of a
difference between runs (another specimen, zero or sensor) is no signal of the data, so held-out runs cannot
reveal it. Oscillations do not follow any signal either.
"""

from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

from palpate.estimation.budget.held_out import fit_each_run
from palpate.estimation.budget.laws import periodic_columns
from palpate.estimation.channel import ChannelKind
from palpate.estimation.diagnosis.bootstrap import SMALL, bootstrap_samples, sequential_test
from palpate.estimation.fit.blocks import BlockedData, is_moving
from palpate.estimation.fit.fit_problem import held_out_residual, rmse
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.measurement_model import MeasurementModel
from palpate.estimation.fit.measurement_noise import fast_noise, free_air_noise, size_of_differences
from palpate.estimation.fit.run_heterogeneity import RunHeterogeneity, run_heterogeneity
from palpate.estimation.signals.blocks import rows_of_runs
from palpate.estimation.signals.periodicity import strongest_frequency
from palpate.estimation.signals.runwise import sample_time
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_CLEARLY = 0.5  # error of runs fitted alone, relative to the noise level, if the model is not complete
_EXCESS = (
    3.0  # least ratio of a residual to bootstrap samples, or of an error to the rest beside an oscillation
)
_LEAST_SHARED = 0.5  # least share of the residual's variance that neighboring blocks have in common
_SAMPLES = 4  # bootstrap samples, of which the largest is compared
_SMOOTH_GROWTH = (
    1.6  # growth of differences at twice the distance; a random walk, the slowest noise, has sqrt(2)
)
_LEAST_REACH = 0.05  # of the longest run, over which differences must grow
_LEAST_BLOCKS = 40  # in contact and in free air, or in motion and at rest
_PROMINENT = 40.0  # height of a spectral line over the median around it; noise reaches 10
_MOST_RUNS = 30  # that are fitted with waves of their own
_GAIN_OF_WAVES = 0.7  # largest error, relative to the model's, with waves fitted to each run
_PEAK = 0.2  # least share of the variance at a reported frequency


@dataclass(frozen=True)
class ResidualFinding:
    """Why a model is incomplete although no flexible regression improves it."""

    reason: str  # a sentence
    depends_on: str  # what the residual depends on


def check_residuals(
    end: FitResult, measurement: MeasurementModel, rng: np.random.Generator, *, complete: bool
) -> ResidualFinding | None:
    """Look for evidence against a model that no signal of the data shows; None if there is none.

    Args:
        end: the model.
        measurement: how motion and effort were measured.
        rng: for bootstrap samples.
        complete: whether a flexible regression does not improve the model. If it does, only a clear
            difference between runs is reported.
    """
    unit = end.data.kind.effort_unit
    heterogeneity = run_heterogeneity(end.problem.blocked, end.solution)
    if not complete and not (heterogeneity and heterogeneity.alone < _CLEARLY * end.floor()):
        return None
    if complete and (left := _error_with_own_waves(end)) is not None:
        return ResidualFinding(
            "the error ripples over the position, with a different phase in each run: a wave fitted to each "
            f"run would leave {left:.3g} {unit}; begin each run at the same reference position",
            "run",
        )
    if heterogeneity and _is_heterogeneous(heterogeneity, end, measurement, rng):
        return ResidualFinding(
            f"the runs do not follow one law: run {heterogeneity.run} is off by "
            f"{heterogeneity.run_predicted:.3g} {unit} when predicted from the others, by "
            f"{heterogeneity.run_alone:.3g} {unit} when fitted alone; was "
            "something else probed, or a sensor changed?",
            "run",
        )
    excess = exceeds_noise(end, measurement, rng)
    if not excess:
        return _oscillation(end)
    swings = f" and oscillates at {excess.frequency_hz:.3g} Hz" if excess.frequency_hz else ""
    return ResidualFinding(
        f"the residual {excess.where}, {excess.acting:.3g} {unit}, is {excess.acting / excess.expected:.0f} "
        f"times the noise {excess.reference} and does not look like noise{swings}; no signal of the data "
        "explains it",
        "time",
    )


def _error_with_own_waves(end: FitResult) -> float | None:
    """Error with waves over the position fitted to each run [effort]; None if they do not help."""
    blocked, used = end.problem.blocked, end.problem.used
    runs = len(np.unique(blocked.run[used]))
    if end.data.kind is ChannelKind.CONTACT or not 1 < runs <= _MOST_RUNS:
        return None
    run, position = blocked.run[used], blocked.reduce(end.data.position)[used]
    residual = end.solution.residual[used]
    waves = periodic_columns(position, residual, is_angle=end.data.kind.is_angle, run=run)
    columns = np.column_stack([np.ones(len(residual)), waves])
    left = fit_each_run(residual, columns, np.unique(run, return_inverse=True)[1])
    is_better = rmse(left) < _GAIN_OF_WAVES * rmse(residual)
    return end.rmse * rmse(left) / rmse(residual) if is_better else None


def periodic_component(end: FitResult) -> tuple[float, float] | None:
    """Find the frequency [Hz] of the residual's strongest line and its share of the variance; None if weak.

    Runs may differ in phase.

    Args:
        end: the model.
    """
    blocked = end.problem.blocked
    line = _strongest_line(blocked, blocked.reduce(held_out_residual(blocked, end.solution)))
    return None if line is None or line[1] < _PEAK or line[2] < _PROMINENT else line[:2]


def _strongest_line(blocked: BlockedData, residual: FloatArray) -> tuple[float, float, float] | None:
    """See `strongest_frequency`; the residual is given on blocks, shape (m,)."""
    step_s = sample_time(blocked.data.time_s, blocked.data.run) * blocked.rows.shape[1]
    return strongest_frequency(blocked.reduce(blocked.data.time_s), blocked.run, residual, step_s)


def _oscillation(end: FitResult) -> ResidualFinding | None:
    """Report an oscillation of the residual that is not part of the noise.

    A hum that the sensor also picks up in free air, and that is no larger than the noise there, is noise.
    """
    line, unit = periodic_component(end), end.data.kind.effort_unit
    if line is None:
        return None
    size, remainder = np.sqrt(line[1]) * end.rmse, np.sqrt(1.0 - line[1]) * end.rmse
    in_air = (1.0 + SMALL) * (free_air_noise(end.data) or 0.0)
    if end.rmse <= min(in_air, _EXCESS * remainder):
        return None
    return ResidualFinding(
        f"the error oscillates at {line[0]:.3g} Hz with {size:.3g} {unit}, and no signal of the data does",
        "time",
    )


def _is_heterogeneous(
    heterogeneity: RunHeterogeneity, end: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> bool:
    """Test whether runs differ by more than simulated runs of one law."""

    def ratio(heterogeneity: RunHeterogeneity | None) -> float:
        return heterogeneity.predicted / heterogeneity.alone if heterogeneity else 0.0

    noise = end.problem.blocked.reduce(heterogeneity.own_residual)
    statistics = (
        ratio(run_heterogeneity(problem.blocked, solution))
        for problem, solution in bootstrap_samples(end, measurement, rng, noise)
    )
    return sequential_test(ratio(heterogeneity), statistics).is_significant


@dataclass(frozen=True)
class ExcessVariance:
    """Residual variance in contact, or while a joint moves, beyond the noise."""

    acting: float  # root mean square of the residual there, on blocks [effort]
    expected: float  # the same of bootstrap samples with noise of the reference [effort]
    frequency_hz: float | None  # of an oscillation; None if there is none
    where: str  # "in contact" or "in motion"
    reference: str  # where the noise was measured, such as "in free air"


def exceeds_noise(
    fit: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> ExcessVariance | None:
    """Compare the residual in contact with the noise in free air; None if it does not exceed the noise.

    For a joint, the residual in motion is compared with the noise at rest. Without free air or rest, white
    noise is estimated from differences of neighboring readings. Noise may be larger where the effort acts, so
    only the part of the residual that neighboring blocks share counts. Bootstrap samples show what errors of
    the measured motion, such as encoder steps, contribute.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
        rng: for bootstrap samples.
    """
    blocked = fit.problem.blocked
    residual = blocked.reduce(held_out_residual(blocked, fit.solution))
    usable = blocked.trusted & np.isfinite(residual)
    if blocked.data.kind is ChannelKind.CONTACT:
        pressed, where, reference = blocked.data.engaged[blocked.rows], "in contact", "in free air"
        acting, still = usable & pressed.all(axis=1), usable & ~pressed.any(axis=1)
    else:
        moving, where, reference = is_moving(blocked.data, blocked.rows), "in motion", "at rest"
        acting, still = usable & moving, usable & ~moving
    if acting.sum() < _LEAST_BLOCKS:
        return None
    slow = _shared_by_neighbors(residual, blocked.run, acting)
    if slow**2 < _LEAST_SHARED * rmse(residual[acting]) ** 2:
        return None
    if still.sum() >= _LEAST_BLOCKS:
        noise = _about_run_means(residual, blocked.run, still)
    elif white := _white_noise(fit, np.where(usable, residual, np.nan)):
        noise, reference = rng.normal(0.0, white, len(blocked)), "of neighboring readings"
    else:
        return None
    effort_noise = np.resize(noise, len(blocked))
    samples = islice(bootstrap_samples(fit, measurement, rng, effort_noise), _SAMPLES)
    simulated = [
        rmse(problem.blocked.reduce(held_out_residual(problem.blocked, solution))[acting])
        for problem, solution in samples
    ]
    if slow < _EXCESS * max(simulated):
        return None
    line = _strongest_line(blocked, np.where(acting, residual, np.nan))
    frequency_hz = line[0] if line and line[1] > _PEAK else None
    size = rmse(residual[acting])
    return ExcessVariance(size, float(np.median(simulated)), frequency_hz, where, reference)


def _white_noise(fit: FitResult, residual: FloatArray) -> float | None:
    """Standard deviation of the white part of a residual on blocks (m,); None if all of it may be noise.

    Differences of white noise do not depend on the distance, those of a random walk grow by sqrt(2) if it
    doubles. Faster growth means a smooth signal; over a small part of a run it may be noise of a filtered
    sensor. Distances exceed the window from which velocity was derived. P. Hall, J. W. Kay, D. M.
    Titterington, Biometrika 77 (1990).
    """
    blocked = fit.problem.blocked
    runs = rows_of_runs(blocked.run)
    longest = max(len(rows) for rows in runs)
    distance = 1 + max(max(halves, default=0) for halves in fit.filters) // blocked.rows.shape[1]
    if white := fast_noise(fit.data):
        return white / float(np.sqrt(blocked.rows.shape[1]))
    sizes = []
    while 6 * distance <= longest:
        size = size_of_differences([residual[rows] for rows in runs], distance)
        if size is None:
            break
        sizes.append((distance, size))
        distance *= 2
    grows = [after > _SMOOTH_GROWTH * before for (_, before), (_, after) in pairwise(sizes)]
    if not any(grows):
        return None
    most = max(size for _, size in sizes)
    reach = next(distance for distance, size in sizes if size >= 0.5 * most)
    return sizes[grows.index(True)][1] if 3 * reach >= _LEAST_REACH * longest else None


def _about_run_means(residual: FloatArray, run: IntArray, chosen: BoolArray) -> FloatArray:
    """Subtract each run's mean from the residual on chosen blocks, shape (k,), in order of runs."""
    parts = [residual[chosen & (run == number)] for number in np.unique(run[chosen])]
    return np.concatenate([part - part.mean() for part in parts])


def _shared_by_neighbors(residual: FloatArray, run: IntArray, chosen: BoolArray) -> float:
    """Root mean square of what neighboring blocks have in common [effort]; 0 for white noise."""
    pairs = chosen[1:] & chosen[:-1] & (run[1:] == run[:-1])
    if pairs.sum() < _LEAST_BLOCKS // 2:
        return 0.0
    return float(np.sqrt(max(np.mean(residual[1:][pairs] * residual[:-1][pairs]), 0.0)))
