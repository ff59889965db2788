"""Fit a model to a channel by bounded variable projection, and compute results of the fit."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate import (
    DisplayTable,
    ParameterEstimate,
    TableDisplay,
    interval_text,
    with_unit,
)
from palpate.estimation.fit.blocks import BlockedData, block_average, decimate, exclude_boundaries, with_load
from palpate.estimation.fit.fit_problem import FitProblem, Solution, held_out_residual, rmse, solve_gains
from palpate.estimation.fit.flexible_regression import FlexibleRegression, fit_flexible
from palpate.estimation.fit.inner_search import optimize_inner
from palpate.estimation.fit.intervals import estimate_parameters
from palpate.estimation.fit.measurement_model import identify_measurement_model
from palpate.estimation.fit.normal_equations import WHITE, estimate_ar_noise
from palpate.estimation.fit.smoothing_bias import DifferentiationFilter, fit_smoothing_bias
from palpate.estimation.model import Model
from palpate.estimation.signals.cache_by_array import FitCache
from palpate.estimation.workers import single_threaded
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_ROUNDING = 1e-7  # share of the effort below which a residual is rounding: single precision resolves 6e-8
_NAMED_SHARE = 0.4  # least share explained by a named signal, relative to that of the strongest signal
_MIN_SHARE = 0.01  # least share of the squared error that a named signal must explain
_MIN_KEPT = 0.5  # least share of the samples that remain if a model moves the boundaries of the contact
_MIN_IMPROVEMENT = 0.9  # ratio of squared held-out errors below which a correction of smoothing bias is used
_MIN_PULL = 5.0  # standard errors by which the data must favor a gain beyond its bound to be reported
_MOST_UPDATES = 5  # most fits after the first, each with the contact boundaries of the fit before
NOISE_RATIO = 1.05  # ratio to the noise level up to which an error counts as noise
_RATE_SIGNALS = frozenset({"velocity", "direction"})


@dataclass(frozen=True, eq=False)
class Validation:
    """Runs excluded from fitting and used only for scoring."""

    data: ChannelData  # the channel with all runs, including those used for fitting
    good: BoolArray  # samples that a fit may use, shape (n,)


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(TableDisplay):
    """A model fitted to a channel, with its cross-validated residual, noise model and parameter intervals.

    Quantities are computed on first use. The solution comes from ordinary least squares: while an effect is
    missing, prewhitening would treat its part of the residual as noise and give it little weight.
    `parameters` are estimated with prewhitening if only noise is left.

    Attributes:
        training: the channel to which the model was fitted, with its load.
        problem: blocks of this channel without prewhitening.
        solution: the fitted model.
        validation: runs excluded from fitting and used only for scoring; None for cross-validation.
    """

    training: ChannelData
    problem: FitProblem
    solution: Solution
    validation: Validation | None = None

    @cached_property
    def data(self) -> ChannelData:
        """All runs of the channel, with the signals that were derived for the model."""
        if self.validation is None:
            return self.training
        return with_load(self.validation.data, self.model, self.solution.parameters)

    @cached_property
    def training_fit(self) -> "FitResult":
        """The same model, cross-validated on the runs used for fitting."""
        return self if self.validation is None else replace(self, validation=None)

    @property
    def model(self) -> Model:
        """The model."""
        return self.solution.model

    @property
    def values(self) -> Mapping[str, float]:
        """Parameters by "effect.parameter" without intervals; with prewhitening if already computed."""
        return self._final[1].parameters if "_final" in vars(self) else self.solution.parameters

    @cached_property
    def parameters(self) -> Mapping[str, ParameterEstimate]:
        """Parameters by "effect.parameter", with 95 % intervals."""
        with single_threaded():
            return estimate_parameters(*self._final)

    @cached_property
    def _final(self) -> tuple[FitProblem, Solution]:
        with single_threaded():
            return final_solution(self.training_fit)

    @cached_property
    def unphysical(self) -> tuple[str, ...]:
        """Descriptions of gains held at a physical bound although the data clearly favor one beyond it."""
        solution, used = self.solution, self.problem.used
        residual = solution.residual[used]
        noise = float(np.sqrt(np.mean(residual**2)))
        sentences = []
        for column, name in zip(solution.columns[used].T, solution.model.gains, strict=True):
            size = float(np.linalg.norm(column))
            if name in solution.fixed - solution.model.held.keys() and size > 0.0:
                pull = float(column @ residual) / size  # standard errors of white noise, times the noise
                if abs(pull) > _MIN_PULL * noise:
                    unit, side = self.parameters[name].unit, "below" if pull < 0.0 else "above"
                    value = solution.parameters[name]
                    sentences.append(
                        f"{name} would be {side} the physical bound, {with_unit(value, unit, 4)}"
                    )
        return tuple(sentences)

    @cached_property
    def predicted(self) -> FloatArray:
        """Effort that the model predicts, shape (n,)."""
        return self.predict(self._final[1].parameters)

    def predict(self, parameters: Mapping[str, float]) -> FloatArray:
        """Predict the effort with other parameters, shape (n,), in the channel's unit.

        Args:
            parameters: values of all parameters by "effect.parameter".
        """
        return self.model.predict(self.data, parameters)

    @cached_property
    def residual(self) -> FloatArray:
        """Effort minus prediction from gains fitted to the other runs, shape (n,); NaN if not scored."""
        if self.validation is None:
            return held_out_residual(self.problem.blocked, self.solution)
        all_runs, good = self.validation.data, self.validation.good
        blocks = block_average(all_runs, good)
        blocked = fit_problem(blocks, self.model, self.solution.parameters).blocked
        rows = blocked.rows[blocked.trusted].ravel()
        rows = rows[~np.isin(all_runs.run[rows], self.training.runs)]
        residual = np.full(len(all_runs), np.nan)
        residual[rows] = (self.data.effort - self.predict(self.solution.parameters))[rows]
        return residual

    @property
    def scored(self) -> BoolArray:
        """Samples that are scored, shape (n,)."""
        return np.isfinite(self.residual)

    @property
    def residual_on_blocks(self) -> FloatArray:
        """Residual of the fit on blocks without cross-validation, shape (m,); zero if not scored."""
        return np.where(self.problem.blocked.trusted, self.solution.residual, 0.0)

    @cached_property
    def rmse(self) -> float:
        """Held-out error: root mean square of `residual`."""
        return rmse(self.residual)

    @property
    def held_out_mean_square(self) -> float:
        """Mean squared held-out residual on the blocks in use."""
        return self.solution.held_out / max(int(self.problem.used.sum()), 1)

    @property
    def filters(self) -> DifferentiationFilter:
        """Windows that derived velocity and acceleration, if the model depends on these signals."""
        measurement = identify_measurement_model(self.training)
        orders = 1, 1 if measurement.is_of_velocity else 2
        of_velocity, of_acceleration = (
            () if half is None else ((half, order),)
            for half, order in zip(measurement.filters, orders, strict=True)
        )
        signals = {signal for effect in self.model.effects for signal in effect.signals}
        both = (*of_velocity, *of_acceleration) if measurement.is_of_velocity else of_acceleration
        return of_velocity if signals & _RATE_SIGNALS else (), both if "acceleration" in signals else ()

    @cached_property
    def flexible(self) -> FlexibleRegression:
        """Flexible regression on the residual: the part that a smooth function of the signals explains."""
        return fit_flexible(self.problem, self.solution, self.filters)

    @cached_property
    def whitened_problem(self) -> FitProblem:
        """The same blocks, prewhitened by the noise model of the flexible regression's residual."""
        blocked = self.problem.blocked
        return FitProblem(blocked, estimate_ar_noise(self.flexible.residual, blocked.run, blocked.trusted))

    @cached_property
    def coarse_problem(self) -> FitProblem:
        """The same problem with one sample per block, for faster fits.

        It also exists for models that are fitted on blocks, since an additional effect may need samples.
        """
        blocked = self.problem.blocked
        data, rows = decimate(blocked), np.arange(len(blocked))[:, None]
        return FitProblem(BlockedData(data, rows, blocked.run, blocked.fold, blocked.trusted), WHITE)

    @property
    def is_exact(self) -> bool:
        """Whether the error is only numerical rounding, as in simulated data without noise.

        Such an error depends on the signals through rounding and ridge penalties, but has no physical cause.
        """
        return self.rmse <= _ROUNDING * float(np.sqrt(np.mean(self.training.effort**2)))

    @property
    def depends_on(self) -> list[str]:
        """Signals on which the remaining held-out error depends, the strongest first."""
        shares = self.flexible.by_signal
        largest = max(shares.values(), default=0.0)
        if largest < _MIN_SHARE:
            return []
        min_share = max(_NAMED_SHARE * largest, _MIN_SHARE)
        named = (name for name, share in shares.items() if share >= min_share)
        return sorted(named, key=lambda name: -shares[name])

    @cached_property
    def smooth_law_error(self) -> float:
        """Error in the scored runs of the model with a flexible regression [effort]."""
        with single_threaded():
            if self.validation is None:
                return self.floor()
            all_runs, good = self.validation.data, self.validation.good
            full_fit = fit_model(all_runs, self.model, self.solution.parameters, good)
            return full_fit._floor_in_runs(np.setdiff1d(all_runs.runs, self.training.runs))

    def floor(self) -> float:
        """Return the cross-validated error that the flexible regression does not explain [effort]."""
        count = max(int(self.problem.blocked.trusted.sum()), 1)
        return float(np.sqrt(max(self.rmse**2 - max(self.flexible.explained, 0.0) / count, 0.0)))

    def _floor_in_runs(self, runs: IntArray) -> float:
        """Return the noise level in some runs, cross-validated with all runs [effort]."""
        blocked = self.problem.blocked
        chosen = blocked.trusted & np.isin(blocked.run, runs)
        residual = held_out_residual(blocked, self.solution)[blocked.rows[chosen]]
        before, after = self.flexible.residual_before, self.flexible.residual
        explainable = float(np.mean(before[chosen] ** 2 - after[chosen] ** 2))
        return float(np.sqrt(max(float(np.mean(residual**2)) - max(explainable, 0.0), 0.0)))

    def explainable_share(self) -> float:
        """Return the share of the held-out error on blocks that the flexible regression explains."""
        return self.flexible.share_of(self.solution)

    def _table(self) -> DisplayTable:
        held = self.model.held
        rows = [
            (name, f"{p.value:.5g} {p.unit}", "held" if name in held else interval_text(p))
            for name, p in self.parameters.items()
        ]
        names = " + ".join(effect.name for effect in self.model.effects)
        unit = self.data.effort_unit
        caption = f"{names} of {self.data.name}: {with_unit(self.rmse, unit, 4)} in held-out runs"
        return DisplayTable(caption, ("parameter", "value", "95 % interval"), rows)


def fit_model(
    data: ChannelData,
    model: Model,
    parameters: Mapping[str, float],
    good: BoolArray | None = None,
    cache: FitCache | None = None,
) -> FitResult:
    """Fit a model to a channel, starting from given parameters.

    Args:
        data: the channel, without a derived `load`.
        model: model to fit.
        parameters: start values of inner parameters and known gains, by "effect.parameter".
        good: samples that a fit may use, shape (n,); None for all.
        cache: columns computed by other fits of this channel.
    """
    blocks = block_average(data, good, cache)
    values = dict.fromkeys(model.gains, 0.0) | {n: inner.beginning for n, inner in model.inner.items()}
    values |= {name: parameters[name] for name in values.keys() & parameters.keys()} | dict(model.held)
    first = solve_gains(fit_problem(blocks, model, values), model, values, rounds=3)
    problem = fit_problem(blocks, model, first.parameters)
    solution = optimize_inner(problem, first)
    tried = [problem.blocked.trusted]
    # A fit excludes the contact boundaries of its own parameters, unless two sets of boundaries alternate.
    while len(tried) <= _MOST_UPDATES:
        updated = fit_problem(blocks, model, solution.parameters)
        if any(np.array_equal(updated.blocked.trusted, trusted) for trusted in tried):
            break
        moved = solve_gains(updated, model, solution.parameters)
        problem, solution = updated, optimize_inner(updated, moved)
        tried.append(updated.blocked.trusted)
    return FitResult(problem.blocked.data, problem, solution)


def fit_problem(blocks: BlockedData, model: Model, parameters: Mapping[str, float]) -> FitProblem:
    """Return the problem in which a model with these parameters is fitted and scored; see `fit_model`.

    It differs from other models' problems by the load of a joint and by the boundaries of a contact. The
    boundaries are not moved if half of the samples or more would then be excluded, since a model could
    otherwise avoid any error by placing all samples at a boundary.

    Args:
        blocks: blocks of the channel without a derived `load`.
        model: the model.
        parameters: values by "effect.parameter"; gains that are missing count as zero.
    """
    data = with_load(blocks.data, model, parameters)
    if data is not blocks.data:
        blocks = replace(blocks, data=data)
    if data.kind is ChannelKind.CONTACT:
        moved, recovering = model.moved(data, parameters), None
        if data.surface_recovers:
            values = {**dict.fromkeys(model.gains, 0.0), **parameters}
            recovering = model.recovering(data, values, model.parts(data, values, blocks.at_full_rate))
        if moved is not data or recovering is not None:
            inside = exclude_boundaries(blocks, moved, recovering)
            if inside.trusted.sum() > _MIN_KEPT * blocks.trusted.sum():
                blocks = inside
    return FitProblem(blocks, WHITE)


def final_solution(fit: FitResult) -> tuple[FitProblem, Solution]:
    """Refit the parameters with prewhitening if that is safe; return the problem and its solution.

    Prewhitening gives the most accurate parameters, but would treat a missing effect as colored noise. The
    result is used only if it is close to the ordinary fit, since with a poor noise model a distant solution
    may have an equally small residual.

    Args:
        fit: the fitted model.
    """
    if fit.training.shared is not None or fit.rmse > NOISE_RATIO * fit.floor():
        return fit.problem, fit.solution
    problem, used = fit.whitened_problem, fit.problem.used
    solution = optimize_inner(problem, solve_gains(problem, fit.model, fit.solution.parameters))
    ordinary, whitened = (float(np.sum(solved.residual[used] ** 2)) for solved in (fit.solution, solution))
    if whitened > NOISE_RATIO**2 * ordinary:
        return fit.problem, fit.solution
    filters = fit.filters
    if problem.blocked.data.kind is ChannelKind.CONTACT or filters == ((), ()):
        return problem, solution
    # Correct a joint's gains for the smoothing bias of its motion: otherwise the flattened peaks of the
    # acceleration bias the mass, and the mass biases the weight.
    _, fitted = fit_smoothing_bias(problem, solution, filters)
    if fitted is None or fitted.held_out.sum() > _MIN_IMPROVEMENT * solution.held_out:
        return problem, solution
    gains = dict(zip(solution.model.gains, fitted.gains.tolist(), strict=False))
    return problem, replace(solution, parameters={**solution.parameters, **gains})
