"""What a smooth law of the signals cannot show: runs with laws of their own, and a rest unlike noise.

What would explain why one run differs (another specimen, another zero, a sensor that died) is no signal of
the data, so other runs teach nothing about it. Nor does a rest that swings or breathes follow any signal.
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

_CLEARLY = 0.5  # of what a smooth law would leave: what each run leaves by itself
_ABOVE_AIR = 3.0  # times what draws show, or what is left beside a swing
_LIKE_NEIGHBOUR = 0.5  # of the energy that is left, which neighbouring blocks must have in common
_FEW_DRAWS = 4  # whose largest is compared
_WALKS = 1.6  # times as large differences at twice the distance, above which no noise grows
_OF_RUN = 0.05  # of the longest run, over which differences must grow
_BLOCKS = 40  # in contact and in free air, in motion and at rest, with fewer of which nothing is said
_PROMINENT = 40.0  # times the median around it, that a line rises to in a spectrum; noise reaches 10
_MOST_RUNS = 30  # that may have waves of their own
_OWN_WAVES = 0.7  # of the error, below which such waves leave it
_PEAK = 0.2  # share of the variance in one frequency that makes it worth naming


@dataclass(frozen=True)
class ResidualFinding:
    """Why a model is not complete though no smooth law improves it."""

    reason: str  # in words
    depends_on: str  # what the error depends on


def check_residuals(
    end: FitResult, measurement: MeasurementModel, rng: np.random.Generator, *, complete: bool
) -> ResidualFinding | None:
    """What no signal of the data shows and speaks against a model; None if nothing does.

    Args:
        end: the model.
        measurement: how the motion was read.
        rng: for draws.
        complete: whether it leaves nothing to a smooth law; if not, runs must differ by clearly more.
    """
    unit = end.data.kind.effort_unit
    apart = run_heterogeneity(end.problem.blocked, end.solution)
    if not complete and not (apart and apart.alone < _CLEARLY * end.floor()):
        return None
    if complete and (left := _left_by_own_waves(end)) is not None:
        return ResidualFinding(
            "the error ripples over the position, with a different phase in each run: a wave fitted to each "
            f"run would leave {left:.3g} {unit}; begin each run at the same reference position",
            "run",
        )
    if apart and _is_no_chance(apart, end, measurement, rng):
        return ResidualFinding(
            f"the runs do not follow one law: run {apart.run} is off by {apart.run_predicted:.3g} {unit} "
            f"when predicted from the others, by {apart.run_alone:.3g} {unit} when fitted alone; was "
            "something else probed, or a sensor changed?",
            "run",
        )
    excess = exceeds_noise(end, measurement, rng)
    if not excess:
        return _swings(end)
    swings = f" and oscillates at {excess.frequency_hz:.3g} Hz" if excess.frequency_hz else ""
    return ResidualFinding(
        f"the residual {excess.where}, {excess.acting:.3g} {unit}, is {excess.acting / excess.expected:.0f} "
        f"times the noise {excess.reference} and does not look like noise{swings}; no signal of the data "
        "explains it",
        "time",
    )


def _left_by_own_waves(end: FitResult) -> float | None:
    """Error that waves over the position, with coefficients of each run, leave; None if they do not help."""
    blocked, used = end.problem.blocked, end.problem.used
    runs = len(np.unique(blocked.run[used]))
    if end.data.kind is ChannelKind.CONTACT or not 1 < runs <= _MOST_RUNS:
        return None
    run, position = blocked.run[used], blocked.reduce(end.data.position)[used]
    residual = end.solution.residual[used]
    waves = periodic_columns(position, residual, is_angle=end.data.kind.is_angle, run=run)
    columns = np.column_stack([np.ones(len(residual)), waves])
    left = fit_each_run(residual, columns, np.unique(run, return_inverse=True)[1])
    return end.rmse * rmse(left) / rmse(residual) if rmse(left) < _OWN_WAVES * rmse(residual) else None


def periodic_component(end: FitResult) -> tuple[float, float] | None:
    """At which frequency [Hz] the error swings, and its share of the variance; runs may differ in phase.

    Args:
        end: the model.
    """
    blocked = end.problem.blocked
    swing = _swing(blocked, blocked.reduce(held_out_residual(blocked, end.solution)))
    return None if swing is None or swing[1] < _PEAK or swing[2] < _PROMINENT else swing[:2]


def _swing(blocked: BlockedData, residual: FloatArray) -> tuple[float, float, float] | None:
    """See `strongest_frequency`; the residual on blocks, (m,)."""
    step_s = sample_time(blocked.data.time_s, blocked.data.run) * blocked.rows.shape[1]
    return strongest_frequency(blocked.reduce(blocked.data.time_s), blocked.run, residual, step_s)


def _swings(end: FitResult) -> ResidualFinding | None:
    """An error that swings: more than in free air, or so far that it is several times what is left beside it.

    A hum that a sensor picks up in free air too, and that is no larger than its noise, is noise.
    """
    swing, unit = periodic_component(end), end.data.kind.effort_unit
    if swing is None:
        return None
    size, floor = np.sqrt(swing[1]) * end.rmse, np.sqrt(1.0 - swing[1]) * end.rmse
    in_air = (1.0 + SMALL) * (free_air_noise(end.data) or 0.0)
    if end.rmse <= min(in_air, _ABOVE_AIR * floor):
        return None
    return ResidualFinding(
        f"the error oscillates at {swing[0]:.3g} Hz with {size:.3g} {unit}, and no signal of the data does",
        "time",
    )


def _is_no_chance(
    apart: RunHeterogeneity, end: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> bool:
    """Whether runs that follow one law, read as these were, disagree by less."""

    def ratio(heterogeneity: RunHeterogeneity | None) -> float:
        return heterogeneity.predicted / heterogeneity.alone if heterogeneity else 0.0

    drawn = bootstrap_samples(end, measurement, rng, end.problem.blocked.reduce(apart.own_residual))
    return sequential_test(
        ratio(apart), (ratio(run_heterogeneity(problem.blocked, solution)) for problem, solution in drawn)
    ).is_significant


@dataclass(frozen=True)
class ExcessVariance:
    """What is left in contact, or while a joint moves, and is no noise."""

    acting: float  # root mean square of the residual there, on blocks, in the unit of the effort
    expected: float  # the same of draws from the model, with the noise of the reference
    frequency_hz: float | None  # at which much of it swings; None if it does at none
    where: str  # "in contact" or "in motion"
    reference: str  # where the noise was taken, such as "in free air"


def exceeds_noise(
    fit: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> ExcessVariance | None:
    """What a model leaves in contact beyond noise as in free air and errors of the readings; None if nothing.

    Of a joint, what it leaves in motion beyond noise as at rest. Where there is no free air, or no rest, the
    noise is that of neighboring readings, if it is white. It may be larger where the effort acts, of which
    only what neighbouring blocks share is held against the model. Draws show what the readings' errors, such
    as the steps of encoders, make of that.

    Args:
        fit: the model.
        measurement: how motion and effort were read.
        rng: for draws.
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
    if acting.sum() < _BLOCKS:
        return None
    slow = _shared_by_neighbours(residual, blocked.run, acting)
    if slow**2 < _LIKE_NEIGHBOUR * rmse(residual[acting]) ** 2:
        return None
    if still.sum() >= _BLOCKS:
        noise = _about_run_means(residual, blocked.run, still)
    elif like_noise := _like_noise(fit, np.where(usable, residual, np.nan)):
        noise, reference = rng.normal(0.0, like_noise, len(blocked)), "of neighboring readings"
    else:
        return None
    drawn = islice(
        bootstrap_samples(fit, measurement, rng, effort_noise=np.resize(noise, len(blocked))), _FEW_DRAWS
    )
    left = [
        rmse(fit.blocked.reduce(held_out_residual(fit.blocked, solution))[acting]) for fit, solution in drawn
    ]
    if slow < _ABOVE_AIR * max(left):
        return None
    swing = _swing(blocked, np.where(acting, residual, np.nan))
    frequency_hz = swing[0] if swing and swing[1] > _PEAK else None
    acts = rmse(residual[acting])
    return ExcessVariance(acts, float(np.median(left)), frequency_hz, where, reference)


def _like_noise(fit: FitResult, residual: FloatArray) -> float | None:
    """Standard deviation of the part of a residual on blocks (m,) that may be noise; None if it all may.

    Differences of white noise are alike at any distance, and those of a random walk, the slowest noise, grow
    by sqrt(2) where it doubles. What grows faster is smooth; only what stays so over a good part of a run is
    not taken for the noise of a sensor with a filter. Where velocity was derived, distances are beyond its
    window. P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77 (1990).
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
    grows = [after > _WALKS * before for (_, before), (_, after) in pairwise(sizes)]
    if not any(grows):
        return None
    most = max(size for _, size in sizes)
    reach = next(distance for distance, size in sizes if size >= 0.5 * most)
    return sizes[grows.index(True)][1] if 3 * reach >= _OF_RUN * longest else None


def _about_run_means(residual: FloatArray, run: IntArray, chosen: BoolArray) -> FloatArray:
    """The chosen blocks (k,) in order of time, each about the mean of its run."""
    parts = [residual[chosen & (run == number)] for number in np.unique(run[chosen])]
    return np.concatenate([part - part.mean() for part in parts])


def _shared_by_neighbours(residual: FloatArray, run: IntArray, chosen: BoolArray) -> float:
    """Root mean square of what neighbouring blocks have in common; 0 for white noise."""
    pairs = chosen[1:] & chosen[:-1] & (run[1:] == run[:-1])
    if pairs.sum() < _BLOCKS // 2:
        return 0.0
    return float(np.sqrt(max(np.mean(residual[1:][pairs] * residual[:-1][pairs]), 0.0)))
