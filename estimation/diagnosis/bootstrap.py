"""Parametric bootstrap tests of a fitted model.

A test simulates measurements from the fitted model through the whole measurement chain. It compares the test
statistic of the data with those of the bootstrap samples (A. C. Davison, D. V. Hinkley, Bootstrap Methods and
their Application (1997), ch. 4; D. R. Cox, JRSS B 24 (1962) for two models). Sampling stops as soon as the
result is clear (J. Besag, P. Clifford, Sequential Monte Carlo p-values, Biometrika 78 (1991)).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.derivatives import grid_step
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.effect import Effect, forms_of
from palpate.estimation.effects.run_differences import RunVariation
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.fit.flexible_regression import fit_flexible
from palpate.estimation.fit.inner_search import optimize_inner, search_inner
from palpate.estimation.fit.measurement_model import MeasurementModel, shuffle_noise, with_derived_signals
from palpate.estimation.model import Model
from palpate.estimation.signals.cache_by_array import FitCache, IdentityKey
from palpate.estimation.signals.runwise import shifted_motion
from palpate.robot_io.types import FloatArray

DRAWS = 19  # largest number of bootstrap samples; the data exceed all 19 by chance once in twenty
_LEVEL_TO_STOP = 1e-3  # probability that one more sample exceeds the data, below which a test stops
_FAR = 3.0  # ratio to the largest sample above which optimized inner parameters cannot change the result
_STEP_GAIN = 1e-3  # least share of the error that an optimizer step must remove, far below `SMALL`
_STARTS = 6  # additional start values of an effect's inner parameters on each sample
SMOOTHING_TIMES = 1.25  # largest error that smoothing may cause, relative to its first-order estimate
_MOST = 0.5  # share of the squared error
_MIN_NOISE = 0.05  # least share of the residual variance that is noise of the effort itself


@dataclass(frozen=True)
class BootstrapTest:
    """A test statistic of the data and of bootstrap samples, shape (d,)."""

    observed: float
    simulated: FloatArray

    @property
    def is_significant(self) -> bool:
        """Whether the data exceed all bootstrap samples, and by more than a negligible share of the error."""
        return bool(self.observed > np.max(self.simulated, initial=0.0) + SMALL)

    @property
    def is_conclusive(self) -> bool:
        """Whether one more sample hardly exceeds the data, if samples have an exponential tail.

        Statistics are mostly skewed, and many samples of a selected model are 0, so a normal distribution has
        too short a tail. The mean of an exponential distribution that is known from n samples with sum s has
        the predictive probability (1 + x / s)^-n of values above x.
        """
        # Samples without any improvement say little about the tail, so a negligible value is added to them.
        total = SMALL + float(np.sum(np.maximum(self.simulated, 0.0)))
        exceeded = (1.0 + max(self.observed, 0.0) / total) ** -len(self.simulated)
        return self.is_significant and exceeded < _LEVEL_TO_STOP


def sequential_test(observed: float, statistics: Iterator[float]) -> BootstrapTest:
    """Compare a statistic with as many bootstrap samples as the decision needs, at most `DRAWS`.

    Args:
        observed: the statistic of the data.
        statistics: the same statistic of simulated data, computed on demand.
    """
    test = BootstrapTest(observed, np.empty(0))
    while test.is_significant and not test.is_conclusive and len(test.simulated) < DRAWS:
        test = BootstrapTest(observed, np.append(test.simulated, next(statistics)))
    return test


def lack_of_fit_test(
    fit: FitResult, measurement: MeasurementModel, rng: np.random.Generator
) -> BootstrapTest:
    """Test whether a flexible regression explains more of the held-out error than expected by chance.

    The statistic is the share of the model's error that the regression removes. On bootstrap samples it is
    relative to the error in the data if that error is larger.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
        rng: random generator for the bootstrap samples.
    """
    statistics = (
        fit_flexible(problem, solution, fit.filters).share_of(solution, fit.solution.held_out)
        for problem, solution in bootstrap_samples(fit, measurement, rng)
    )
    return sequential_test(fit.explainable_share(), statistics)


def encoder_step_error(fit: FitResult, measurement: MeasurementModel) -> float:
    """Compute the error caused by half an encoder step, root mean square on blocks [effort].

    An encoder that hardly turns has an error of up to half a step that repeats in each pass. Bootstrap
    samples do not contain this error, but a smooth function of the position describes it (B. Widrow, I.
    Kollar, Quantization Noise (2008)). The result is 0 if the positions show no steps.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
    """
    if not measurement.is_staircase:
        return 0.0
    data, zero = fit.data, np.zeros(len(fit.data))
    half_step = np.full(len(data), float(np.sqrt(3.0 * np.mean(measurement.error**2))))
    return _motion_error(fit, shifted_motion(data, half_step, zero, zero))


def smoothing_error(fit: FitResult, measurement: MeasurementModel) -> float:
    """Compute the error that the smoothing of derived motion causes, root mean square on blocks [effort].

    The result is 0 for a contact: its motion has corners, at which this estimate is far too large.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
    """
    if fit.data.kind is ChannelKind.CONTACT:
        return 0.0
    data, zero = fit.data, np.zeros(len(fit.data))
    removed = [exact - bent for exact, bent in zip(measurement.exact, measurement.bent, strict=True)]
    return _motion_error(fit, shifted_motion(data, zero, *removed))


def is_mostly_smoothing(fit: FitResult, measurement: MeasurementModel) -> bool:
    """Return whether the smoothing of derived motion may cause most of a model's squared error.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
    """
    return smoothing_error(fit, measurement) ** 2 > _MOST * fit.rmse**2


def _motion_error(fit: FitResult, motion: ChannelData) -> float:
    """Return the change of a prediction for another motion, root mean square on blocks [effort]."""
    efforts = [fit.solution.model.predict(data, fit.solution.parameters) for data in (motion, fit.data)]
    difference = fit.problem.blocked.reduce(np.subtract(*efforts))[fit.problem.used]
    return float(np.sqrt(np.mean(difference**2)))


def improvement_test(
    before: FitResult,
    after: FitResult,
    measurement: MeasurementModel,
    rng: np.random.Generator,
    effect: str = "",
) -> BootstrapTest:
    """Test whether a model fits better than another one by more than chance (D. R. Cox, JRSS B 24 (1962)).

    The statistic is the share of the held-out error by which `after` improves on `before`. The null model is
    either nested, to test whether an effect is needed, or a rival, to compare two forms.

    Args:
        before: the null model, from which bootstrap samples are simulated.
        after: the alternative model.
        measurement: how motion and effort were measured.
        rng: random generator for the bootstrap samples.
        effect: the only effect that `after` adds, whose inner parameters are searched on each sample; or "".
    """
    model, known = after.solution.model, after.solution.parameters
    observed = 1.0 - float(np.sqrt(after.solution.held_out / max(before.solution.held_out, 1e-300)))

    # The residual of a model without differences between runs contains them, but they are no noise.
    variations = [effect for effect in model.effects if isinstance(effect, RunVariation)]
    adds_variation = any(effect not in before.solution.model.effects for effect in variations)

    def fit_sample(problem: FitProblem, solution: Solution) -> tuple[Solution, float]:
        parameters = {**known, **{n: v for n, v in solution.parameters.items() if n in model.gains}}
        if not effect:
            fitted = solve_gains(problem, model, parameters)
            return fitted, fitted.held_out
        added = model.effect(effect)
        starts = added.starts(before.data)
        start = {parameter.name: known[f"{effect}.{parameter.name}"] for parameter in added.inner}
        start_values = [start, *starts[:: max(len(starts) // _STARTS, 1)]]
        searches = [
            search_inner(problem, with_form, effect, parameters, start_values)
            for with_form in _forms(model, added)
        ]
        best = min(searches, key=lambda search: search.best.sse)
        return best.best, float(best.held_out.sum())

    def improvement(problem: FitProblem, solution: Solution) -> float:
        return 1.0 - float(np.sqrt(fit_sample(problem, solution)[1] / max(solution.held_out, 1e-300)))

    def optimized_improvement(problem: FitProblem, solution: Solution) -> float:
        sse, sse_before = (
            optimize_inner(problem, start, _STEP_GAIN).held_out
            for start in (fit_sample(problem, solution)[0], solution)
        )
        return 1.0 - float(np.sqrt(sse / max(sse_before, 1e-300)))

    def run_test(statistic: Callable[[FitProblem, Solution], float]) -> BootstrapTest:
        samples = bootstrap_samples(before, measurement, rng, noise_of=after if adds_variation else before)
        return sequential_test(observed, (statistic(*sample) for sample in samples))

    quick = run_test(improvement)
    if not quick.is_significant or observed > _FAR * np.max(quick.simulated, initial=0.0):
        return quick
    return run_test(optimized_improvement)  # optimizes all inner parameters, as was done on the data


def bootstrap_samples(
    fit: FitResult,
    measurement: MeasurementModel,
    rng: np.random.Generator,
    effort_noise: FloatArray | None = None,
    noise_of: FitResult | None = None,
) -> Iterator[tuple[FitProblem, Solution]]:
    """Simulate an unlimited number of measurements from a fitted model, and refit the model to each.

    Args:
        fit: the model.
        measurement: how motion and effort were measured.
        rng: random generator for the samples.
        effort_noise: noise of the effort itself on blocks, shape (m,) [effort]. By default it is the residual
            of the flexible regression, reduced by the variance that errors of the measured motion cause.
        noise_of: fit whose flexible regression leaves the noise; by default `fit`.

    Yields:
        The simulated data as a fit problem, and the model fitted to them.
    """
    blocked, model, parameters = fit.problem.blocked, fit.solution.model, fit.solution.parameters
    expected = model.predict(with_derived_signals(measurement.smoothed_motion, fit.data), parameters)
    motion = with_derived_signals(measurement.simulate(rng), fit.data)
    motion_effect = blocked.reduce(model.predict(motion, parameters) - expected)
    variances = [float(np.var(signal[blocked.trusted])) for signal in (motion_effect, fit.solution.residual)]
    # Errors of the motion cannot cause more than the residual; larger ones contain real motion.
    share = min(1.0, float(np.sqrt(variances[1] / max(variances[0], 1e-300))))
    noise = effort_noise
    if noise is None:
        noise = _estimate_noise(noise_of or fit, share**2 * variances[0])
    # The error of untrusted blocks is more than noise.
    noise = noise.copy()
    noise[~blocked.trusted] = np.resize(noise[blocked.trusted], int(np.sum(~blocked.trusted)))
    # The residual already contains the effort's quantization error; given noise does not.
    step = 0.0 if effort_noise is None else grid_step(np.sort(fit.data.effort))
    while True:
        effort = expected.copy()
        effort[blocked.rows] += shuffle_noise(noise, blocked.run, rng)[:, None]
        effort = np.round(effort / step) * step if step > 0.0 else effort
        data = replace(with_derived_signals(measurement.simulate(rng, share), fit.data), effort=effort)
        problem = FitProblem(replace(blocked, data=data, cache=FitCache()), fit.problem.noise_model)
        yield problem, solve_gains(problem, model, parameters)


def _forms(model: Model, effect: Effect) -> list[Model]:
    """List the models with each form of an effect in place of the effect."""
    forms = forms_of(IdentityKey(effect))
    return [model.without(effect.name).with_effect(form) for form in forms] if len(forms) > 1 else [model]


def _estimate_noise(fit: FitResult, by_motion: float) -> FloatArray:
    """Scale the flexible regression's residual (m,) to its variance without errors of the motion."""
    residual = fit.flexible.residual
    variance = float(np.var(residual[fit.problem.blocked.trusted]))
    noise: FloatArray = np.sqrt(max(1.0 - by_motion / max(variance, 1e-300), _MIN_NOISE)) * residual
    return noise
