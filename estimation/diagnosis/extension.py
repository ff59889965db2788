"""Extend a fitted model by one effect, and pack fits for transfer between processes."""

from dataclasses import dataclass, replace

from palpate.estimation.channel import ChannelData
from palpate.estimation.data_quality import usable
from palpate.estimation.design.discrimination import SMALL
from palpate.estimation.diagnosis.candidates import screen_effects
from palpate.estimation.effect import Effect
from palpate.estimation.fit.blocks import LOAD, LUMPED
from palpate.estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from palpate.estimation.fit.fit_result import FitResult, fit_model
from palpate.estimation.workers import single_threaded
from palpate.robot_io.types import BoolArray, FloatArray

_FEW_INNER = 2  # largest number of inner parameters for which a single minimum is likely
_MAX_STARTS = 3  # additional start values from which a fit is repeated


def fit_extended(data: ChannelData, parent: FitResult, effect: Effect) -> FitResult:
    """Fit a model with one more effect, from the start values at which the effect fits best.

    The fit is repeated from several start values if several minima are likely: for pairs such as the position
    of a surface and the curvature of its spring, for effects with many inner parameters, and if the error
    exceeds that of the model without the effect. It is also repeated from other start values of each earlier
    effect, since that effect may have imitated the added one. The fit with the lowest held-out error is
    returned, after the other forms of its effects were tried; a fit with an unphysical gain must have a
    clearly lower error than a fit without one.

    Args:
        data: the channel, with the runs to fit to.
        parent: the model without the effect, fitted to the same data.
        effect: the added effect, in the form that suits the channel.
    """
    with single_threaded():
        search = screen_effects(parent.training_fit, [effect])[0].search
        good, cache = usable(data), parent.problem.blocked.cache
        # Start at the best fit of the effect, at that fit with the parent's inner parameters, and at
        # plausible values.
        best_start, before = search.best.parameters, parent.solution
        starts = [best_start, {**best_start, **{n: before.parameters[n] for n in before.model.inner}}]
        start_solutions = sorted(search.starts, key=lambda solution: solution.sse)
        if not search.best.is_physical:
            start_solutions = [solution for solution in start_solutions if solution.is_physical]
        other_starts = [solution.parameters for solution in start_solutions[:_MAX_STARTS]]
        has_several_minima = not search.best.is_physical or len(effect.inner) > _FEW_INNER
        starts += other_starts if has_several_minima else []
        starts = [start for number, start in enumerate(starts) if start not in starts[:number]]
        fits = [fit_model(data, search.best.model, start, good, cache) for start in starts]
        if not has_several_minima and min(fit.rmse for fit in fits) > parent.rmse:
            fits += [fit_model(data, search.best.model, start, good, cache) for start in other_starts]
        fits += [
            _with_restarted(min(fits, key=lambda fit: fit.solution.held_out), name, good)
            for name in (earlier.name for earlier in parent.model.effects if earlier.inner)
        ]
        best = min(fits, key=_error)
        parameters = best.solution.parameters
        # Each form is first chosen while the other effects are held at their parameters without it.
        others = [
            fit_model(data, best.model.without(other.name).with_effect(form), parameters, good, cache)
            for other in best.model.effects
            for form in other.forms()
            if form.form != other.form
        ]
        return replace(min([best, *others], key=_error), validation=parent.validation)


def _error(fit: FitResult) -> float:
    """Return the held-out squared error of a fit, enlarged for an unphysical gain."""
    return fit.solution.held_out * (1.0 + SMALL * (not fit.solution.is_physical)) ** 2


def _with_restarted(fit: FitResult, name: str, good: BoolArray) -> FitResult:
    """Fit a model again from the start values at which one of its effects fits best with the others."""
    problem, model = fit.problem, fit.solution.model
    without = solve_gains(problem, model.without(name), fit.solution.parameters)
    reduced = FitResult(fit.data, problem, without)
    best = screen_effects(reduced, [model.effect(name)])[0].search.best
    return fit_model(fit.data, best.model, best.parameters, good, problem.blocked.cache)


@dataclass(frozen=True, eq=False)
class PackedFit:
    """A fit without the arrays shared by all fits of a channel, small enough to send between processes."""

    solution: Solution
    trusted: BoolArray  # blocks used in the fit, shape (m,)
    derived: dict[str, FloatArray]  # signals that were derived for this model, by name, each (n,)

    @classmethod
    def of(cls, fit: FitResult) -> "PackedFit":
        """Copy a fit without the shared arrays.

        Args:
            fit: the fit to pack.
        """
        context = fit.training.context
        derived = {name: context[name] for name in (LOAD, LUMPED) if name in context}
        return cls(fit.solution, fit.problem.blocked.trusted, derived)

    def unpack(self, data: ChannelData, fit: FitResult) -> FitResult:
        """Restore the fit with the shared arrays.

        Args:
            data: the channel to which it was fitted.
            fit: another fit of the same channel, whose shared arrays are reused.
        """
        data = replace(data, context={**data.context, **self.derived})
        blocked = replace(fit.problem.blocked, data=data, trusted=self.trusted)
        problem = FitProblem(blocked, fit.problem.noise_model)
        return FitResult(data, problem, self.solution, fit.validation)
