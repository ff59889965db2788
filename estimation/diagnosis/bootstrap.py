"""One way to doubt: would the data look like this if the model were right?

Draw measurements from the fitted model through the whole reading chain, put each through the routine that
judged the data, and see where the data stand among the draws (A. C. Davison, D. V. Hinkley, Bootstrap Methods
and their Application (1997), ch. 4; D. R. Cox, JRSS B 24 (1962) for two models). Drawing stops as soon as the
answer is clear (J. Besag, P. Clifford, Sequential Monte Carlo p-values, Biometrika 78 (1991)).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from palpate.estimation.channel import ChannelData
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.flexible_regression import fit_flexible
from palpate.estimation.fit.inner_search import optimize_inner, search_inner
from palpate.estimation.fit.measurement_model import MeasurementModel, shuffle_noise
from palpate.estimation.model import Model
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.estimation.signals.runwise import shifted_motion
from palpate.robot_io.types import BoolArray, FloatArray

SMALL = 0.05  # of an error: a smaller change is told, and changes no verdict
DRAWS = 19  # at most: of 20 data sets, one is the largest by chance once in twenty
_FEW = 4  # draws, at least
_CHANCE = 1e-3  # that one more draw would be as large as the data, if draws are normal: then they are enough
_FAR = 3.0  # times the largest of draws, beyond which no polish takes them
_SETTLED = 1e-3  # share of a draw's energy that a step of its fit must take away; `SMALL` decides
_STARTS = 6  # of an effect's inner parameters, that are tried on a draw beside those found
_LEAST_NOISE = 0.05  # share of the noise that is the effort's own, however much the readings may make


@dataclass(frozen=True)
class BootstrapTest:
    """Where a figure of the data stands among those of draws, shape (d,)."""

    observed: float
    simulated: FloatArray

    @property
    def is_significant(self) -> bool:
        """Whether the data are beyond all draws, and by more than a small share of the error."""
        return bool(self.observed > np.max(self.simulated, initial=0.0) + SMALL)

    @property
    def is_conclusive(self) -> bool:
        """Whether the data are so far beyond some draws that more of them would say the same.

        Beyond the range, that is, in which one more normal draw would be expected (Student's).
        """
        count = len(self.simulated)
        if count < _FEW:
            return False
        spread = float(np.std(self.simulated, ddof=1)) * np.sqrt(1.0 + 1.0 / count)
        far = scipy.special.stdtrit(count - 1, 1.0 - _CHANCE) * spread
        return self.is_significant and bool(self.observed > np.mean(self.simulated) + far)


def sequential_test(observed: float, draws: Iterator[float]) -> BootstrapTest:
    """Compare a figure with draws of it, as many as are needed: none once it is nothing unusual.

    Args:
        observed: the figure of the data.
        draws: the same figure of simulated data, one after the other.
    """
    placed = BootstrapTest(observed, np.empty(0))
    while placed.is_significant and not placed.is_conclusive and len(placed.simulated) < DRAWS:
        placed = BootstrapTest(observed, np.append(placed.simulated, next(draws)))
    return placed


def lack_of_fit_test(
    fit: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> BootstrapTest:
    """Share of the held-out error that a smooth law explains beside a model, in data and in draws from it.

    What it explains in draws that leave less than the data counts beside what the data leave.

    Args:
        fit: the model.
        measurement: how motion and effort were read.
        rng: for draws.
    """
    drawn = (
        fit_flexible(problem, solution, fit.filters).share_of(solution, fit.solution.held_out)
        for problem, solution in bootstrap_samples(fit, measurement, rng)
    )
    return sequential_test(fit.explainable_share(), drawn)


def encoder_step_error(fit: FitResult, measurement: MeasurementModel) -> float:
    """Error of a model, root mean square on blocks, if an arm's tip were read half a step off; 0 if no steps.

    The tip moves by steps of several encoders. One that hardly turns is off by up to half a step, and in the
    same way in each pass: no draw knows that error, and a smooth law of the position describes it (B. Widrow,
    I. Kollar, Quantization Noise (2008)). The size of a step is that of the errors that show.

    Args:
        fit: the model.
        measurement: how the motion was read.
    """
    if not measurement.is_staircase:
        return 0.0
    data, kept, still = fit.data, fit.problem.used, np.zeros(len(fit.data))
    half = np.full(len(data), float(np.sqrt(3.0 * np.mean(measurement.error**2))))
    expected = (
        fit.solution.model.predict(channel, fit.solution.parameters)
        for channel in (shifted_motion(data, half, still, still), data)
    )
    off = fit.problem.blocked.reduce(np.subtract(*expected))[kept]
    return float(np.sqrt(np.mean(off**2)))


def improvement_test(
    before: FitResult,
    after: FitResult,
    measurement: MeasurementModel,
    rng: np.random.Generator,
    effect: str = "",
) -> BootstrapTest:
    """Share of the held-out error by which a model beats another, in data and in draws from the other.

    It says whether an effect is needed, the model without it being `before`, and whether one model is better
    than a rival, the rival being `before` (D. R. Cox, JRSS B 24 (1962)).

    Args:
        before: the model that draws are made from.
        after: the other.
        measurement: how the motion was read.
        rng: for the draws.
        effect: name of the one effect that `after` has beyond `before`, whose inner parameters are then
            looked for in each draw.
    """
    model, known = after.solution.model, after.solution.parameters
    observed = 1.0 - float(np.sqrt(after.solution.held_out / max(before.solution.held_out, 1e-300)))

    def fitted(problem: FitProblem, solution: Solution) -> tuple[Solution, float]:
        parameters = {**known, **{n: v for n, v in solution.parameters.items() if n in model.gains}}
        if not effect:
            made = solve_gains(problem, model, parameters, rounds=2)
            return made, made.held_out
        added = model.effect(effect)
        starts = added.starts(before.data)
        start = {parameter.name: known[f"{effect}.{parameter.name}"] for parameter in added.inner}
        tried = [start, *starts[:: max(len(starts) // _STARTS, 1)]]
        looked = min(
            (
                search_inner(problem, with_form, form, parameters, tried)
                for with_form, form in _forms(model, added)
            ),
            key=lambda search: search.best.sse,
        )
        return looked.best, float(looked.held_out.sum())

    def gain(problem: FitProblem, solution: Solution) -> float:
        left = fitted(problem, solution)[1]
        return 1.0 - float(np.sqrt(left / max(solution.held_out, 1e-300)))

    def polished_gain(problem: FitProblem, solution: Solution) -> float:
        left, had = (
            optimize_inner(problem, drawn_from, _SETTLED).held_out
            for drawn_from in (fitted(problem, solution)[0], solution)
        )
        return 1.0 - float(np.sqrt(left / max(had, 1e-300)))

    def placed(of_one: Callable[[FitProblem, Solution], float]) -> BootstrapTest:
        drawn = bootstrap_samples(before, measurement, rng)
        return sequential_test(observed, (of_one(*sample) for sample in drawn))

    roughly = placed(gain)
    if not roughly.is_significant or observed > _FAR * np.max(roughly.simulated, initial=0.0):
        return roughly
    return placed(polished_gain)  # all inner parameters were fitted to the data, too


def bootstrap_samples(
    fit: FitResult,
    measurement: MeasurementModel,
    rng: np.random.Generator,
    own: FloatArray | None = None,
) -> Iterator[tuple[FitProblem, Solution]]:
    """A model fitted to measurements drawn from itself, without end.

    Args:
        fit: the model.
        measurement: how the motion was read.
        rng: for the draws.
        own: the effort's own noise on blocks, shape (m,), where it is known; else what a smooth law leaves of
            the model's error, less what reading the motion makes of it.
    """
    blocked, model, known = fit.problem.blocked, fit.solution.model, fit.solution.parameters
    expected = model.predict(_with_derived(measurement.smoothed_motion, fit.data), known)
    noise = _own_noise(fit, measurement, expected, rng) if own is None else own
    noise = _of_trusted(noise, blocked.trusted)
    step = 0.0 if own is None else grid_step(np.sort(fit.data.effort))  # else the noise has steps
    while True:
        effort = expected.copy()
        effort[blocked.rows] += shuffle_noise(noise, blocked.run, rng)[:, None]
        effort = np.round(effort / step) * step if step > 0.0 else effort
        data = replace(_with_derived(measurement.simulate(rng), fit.data), effort=effort)
        problem = FitProblem(
            replace(blocked, data=data, cache=FitCache(), load_cache=FitCache()), fit.problem.noise_model
        )
        yield problem, solve_gains(problem, model, known, rounds=2)


def _forms(model: Model, effect: Effect) -> list[tuple[Model, Effect]]:
    """A model with one of its effects in each of its forms, and that."""
    forms = effect.forms()
    if len(forms) == 1:
        return [(model, effect)]
    without = model.without(effect.name)
    return [(without.with_effect(form), form) for form in forms]


def _own_noise(
    fit: FitResult, measurement: MeasurementModel, expected: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """The effort's noise on blocks, (m,): what is left, less what reading the motion again makes of it."""
    blocked, left = fit.problem.blocked, fit.flexible.residual
    read = _with_derived(measurement.simulate(rng), fit.data)
    apart = blocked.reduce(fit.solution.model.predict(read, fit.solution.parameters) - expected)
    share = 1.0 - float(np.var(apart[blocked.trusted])) / max(float(np.var(left[blocked.trusted])), 1e-300)
    scaled: FloatArray = np.sqrt(max(share, _LEAST_NOISE)) * left
    return scaled


def _of_trusted(noise: FloatArray, trusted: BoolArray) -> FloatArray:
    """Noise on blocks (m,), that of others in the place of those in which the error is more than noise."""
    filled = noise.copy()
    filled[~trusted] = np.resize(noise[trusted], int(np.sum(~trusted)))
    return filled


def _with_derived(moved: ChannelData, fitted: ChannelData) -> ChannelData:
    """A channel with the signals that the fit derived (the load) beside its motion."""
    return replace(moved, context={**fitted.context, **moved.context})
