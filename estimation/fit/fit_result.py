"""Where a diagnosis stands: a model, its fit, the noise's colour, and what could still be explained."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.fit.ar_noise import WHITE, estimate_ar_noise
from estimation.fit.blocks import block_average, exclude_boundaries
from estimation.fit.fit_cache import FitCache
from estimation.fit.fit_problem import FitProblem, Solution, held_out_residual, rmse, solve_gains
from estimation.fit.flexible_regression import DifferentiationFilter, FlexibleRegression, fit_flexible
from estimation.fit.inner_optimization import optimize_inner
from estimation.fit.joint_load import with_load
from estimation.fit.measurement_model import identify_measurement_model
from estimation.model import Model
from robot_io.types import BoolArray, IntArray

_DIGITS = 1e-7  # of the effort: single precision keeps 6e-8, and the fit's own shrinkage leaves some 1e-9
_SHARE = 0.4  # of the most telling signal's share; signals with less are not named
_LEAST = 0.01
_OF_VELOCITY = frozenset({"velocity", "direction"})


@dataclass(frozen=True, eq=False)
class FitResult:
    """A model fitted to a channel, and what it leaves.

    Parameters come from plain least squares: as long as an effect is missing, prewhitening would treat its
    share of the residual as noise and give it little weight. The noise model serves to test the residual.
    """

    data: ChannelData  # the channel with its load
    problem: FitProblem  # blocks without prewhitening
    solution: Solution  # the model fitted there

    @property
    def mean_square(self) -> float:
        """Mean squared residual of the fit, on blocks that count."""
        return self.solution.sse / max(int(self.problem.blocked.trusted.sum()), 1)

    @property
    def held_out_mean_square(self) -> float:
        """Mean squared residual in held-out runs, on blocks that count."""
        return self.solution.held_out / max(int(self.problem.used.sum()), 1)

    @property
    def filters(self) -> DifferentiationFilter:
        """That velocity and acceleration went through, as far as the model depends on these."""
        measurement = identify_measurement_model(self.data)
        first, second = (() if one is None else (one,) for one in measurement.filters)
        felt = {signal for effect in self.solution.model.effects for signal in effect.signals}
        both = (*first, *second) if measurement.is_of_velocity else second
        return first if felt & _OF_VELOCITY else (), both if "acceleration" in felt else ()

    @cached_property
    def flexible(self) -> FlexibleRegression:
        """What any smooth law could explain beyond the model."""
        return fit_flexible(self.problem, self.solution, self.filters)

    @cached_property
    def whitened_problem(self) -> FitProblem:
        """The same blocks with the colour of what the flexible regression leaves."""
        blocked = self.problem.blocked
        return FitProblem(blocked, estimate_ar_noise(self.flexible.residual, blocked.run, blocked.trusted))

    @cached_property
    def rmse(self) -> float:
        """Error in held-out runs, sample by sample."""
        return rmse(held_out_residual(self.problem.blocked, self.solution))

    @property
    def is_exact(self) -> bool:
        """Whether no more than the last digits of the numbers is left: the data were made without noise.

        That is smaller than any reader's noise, and has a shape all the same: rounding and the fit's own
        shrinkage depend on the signals. It is no law of the object.
        """
        return self.rmse <= _DIGITS * float(np.sqrt(np.mean(self.data.effort**2)))

    @property
    def depends_on(self) -> list[str]:
        """Signals that the remaining error depends on in held-out runs, the most telling first."""
        shares = self.flexible.by_signal
        most = max(shares.values(), default=0.0)
        if most < _LEAST:
            return []
        told = [name for name, share in shares.items() if share >= max(_SHARE * most, _LEAST)]
        return sorted(told, key=lambda name: -shares[name])

    def floor(self) -> float:
        """The error that would be left, sample by sample, if all that can be explained were known."""
        count = max(int(self.problem.blocked.trusted.sum()), 1)
        return float(np.sqrt(max(self.rmse**2 - max(self.flexible.explained, 0.0) / count, 0.0)))

    def floor_in_runs(self, runs: IntArray) -> float:
        """The same in some of the runs alone, each still judged by the others."""
        blocked = self.problem.blocked
        chosen = blocked.trusted & np.isin(blocked.run, runs)
        left = held_out_residual(blocked, self.solution)[blocked.rows[chosen]]
        without, beside = self.flexible.residual_before, self.flexible.residual
        explainable = float(np.mean(without[chosen] ** 2 - beside[chosen] ** 2))
        return float(np.sqrt(max(float(np.mean(left**2)) - max(explainable, 0.0), 0.0)))

    def explainable_share(self) -> float:
        """Share of the error in held-out runs, on blocks, that can be explained; see `floor`."""
        return self.flexible.share_of(self.solution)


def fit_model(
    data: ChannelData,
    model: Model,
    parameters: Mapping[str, float],
    good: BoolArray | None = None,
    cache: FitCache | None = None,
) -> FitResult:
    """Fit a model to a channel, starting from given parameters.

    Args:
        data: the channel, without a `load` that was derived.
        model: what to fit.
        parameters: inner parameters, and gains where they are known.
        good: samples that are fit for use, shape (n,); None for all.
        cache: of other fits to this channel.
    """
    cache = cache or FitCache()
    known = dict.fromkeys(model.gains, 0.0) | {n: inner.beginning for n, inner in model.inner.items()}
    known |= {name: parameters[name] for name in known.keys() & parameters.keys()} | dict(model.held)
    first = solve_gains(fit_problem(data, model, known, good, cache), model, known, rounds=3)
    problem = fit_problem(data, model, first.parameters, good, cache)
    solution = optimize_inner(problem, first)
    again = fit_problem(data, model, solution.parameters, good, cache)
    if not np.array_equal(again.blocked.trusted, problem.blocked.trusted):  # the contact begins elsewhere
        problem, solution = again, optimize_inner(again, solution)
    return FitResult(problem.blocked.data, problem, solution)


def fit_problem(
    data: ChannelData,
    model: Model,
    parameters: Mapping[str, float],
    good: BoolArray | None,
    cache: FitCache,
) -> FitProblem:
    """The blocks of a channel on which a model with these parameters is judged; see `fit`."""
    blocked = block_average(with_load(data, model, parameters), good, cache)
    if data.kind is not ChannelKind.CONTACT:
        return FitProblem(blocked, WHITE)
    return FitProblem(exclude_boundaries(blocked, model.moved(blocked.data, parameters)), WHITE)
