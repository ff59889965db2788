"""Fit, preview and diagnose models of a channel on behalf of a study.

All random draws have a fixed seed, so that the same data give the same numbers in any process.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing import current_process

import numpy as np

from estimation import diagnosis
from estimation.channel import ChannelData
from estimation.data_quality import reject_reason, usable
from estimation.diagnosis import Diagnosis
from estimation.diagnosis.bootstrap import SMALL
from estimation.diagnosis.candidates import (
    extended_models,
    screen_effects,
)
from estimation.effect import Effect
from estimation.fit.fit_cache import FitCache
from estimation.fit.fit_problem import FitProblem, Solution, solve_gains
from estimation.fit.fit_result import FitResult, Validation, fit_model
from estimation.fit.inner_optimization import optimize_inner
from estimation.fit.inner_search import GridSearch, search_inner
from estimation.fit.joint_load import LOAD, LUMPED
from estimation.fit.threads import single_threaded
from estimation.model import Model
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

SEED = 1  # of all random draws of a diagnosis
_MOST_STARTS = 3  # physically plausible starts from which a fit is repeated
_PREVIEW_STARTS = 6  # starts of a preview, or somewhat more
_PREVIEW_TOLERANCE = 0.01  # share of the squared error that a step of a preview must gain
Progress = Callable[[str, float], None]  # called with the current step and the share of it that is done
Judge = Callable[[Sequence[ChannelData], Sequence[Model], Sequence[Effect], Progress, str], Diagnosis]


def fit_base(data: ChannelData, model: Model, whole: ChannelData | None = None) -> FitResult:
    """Fit a base model to a channel.

    Args:
        data: the channel, with the runs to fit to.
        model: the base model.
        whole: the channel with all runs, if some are held out by choice; None to score by cross-validation.

    Raises:
        InputError: the channel cannot be judged; the message says why.
    """
    if reason := reject_reason(data, model):
        raise InputError(f"channel '{data.name}': {reason}")
    with single_threaded():
        fit = fit_model(data, model, {}, usable(data))
        return fit if whole is None else replace(fit, validation=Validation(whole, usable(whole)))


def fit_extended(data: ChannelData, parent: FitResult, effect: Effect) -> FitResult:
    """Fit a model with one more effect, from the starts at which the effect fits best.

    A start at zero of a speed or time that the effort is divided by could not be fitted. Some pairs of
    effects have several minima, such as the position of a surface and the curvature of its spring: the fit is
    repeated from each start that may lead to another one. A fit with an unphysical gain must leave far less
    than one without.

    Args:
        data: the channel, with the runs to fit to.
        parent: the model without the effect, fitted to the same data.
        effect: what is added, in the form that suits the channel.
    """
    with single_threaded():
        search = screen_effects(parent.training_fit, [effect])[0].search
        good, cache = usable(data), parent.problem.blocked.cache
        fits = [fit_model(data, search.best.model, start, good, cache) for start in _starts(parent, search)]
        best = min(
            fits, key=lambda fit: fit.mean_square * (1.0 + SMALL * (not fit.solution.is_physical)) ** 2
        )
        return replace(best, validation=parent.validation)


def _starts(parent: FitResult, search: GridSearch) -> list[Mapping[str, float]]:
    """Parameters where the effect fitted best, the same with the parent's inner ones, and plausible ones."""
    best, before = search.best, parent.solution
    starts = [best.parameters, {**best.parameters, **{n: before.parameters[n] for n in before.model.inner}}]
    if not best.is_physical:
        physical = sorted((s for s in search.starts if s.is_physical), key=lambda solution: solution.sse)
        starts += [solution.parameters for solution in physical[:_MOST_STARTS]]
    return [start for number, start in enumerate(starts) if start not in starts[:number]]


def preview_extended(parent: FitResult, effect: Effect) -> FitResult:
    """Approximate `fit_extended` within a few hundredths of a second, on block averages and from few starts.

    Args:
        parent: the model without the effect.
        effect: what is added, in the form that suits the channel.
    """
    with single_threaded():
        known, starts = parent.solution.parameters, effect.starts(parent.training)
        starts = starts[:: max(len(starts) // _PREVIEW_STARTS, 1)]
        searches = (
            search_inner(parent.coarse_problem, model, effect, known, starts)
            for model in extended_models(parent.model, effect)
        )
        best = min((search.best for search in searches), key=lambda solution: solution.sse)
        coarse = optimize_inner(parent.coarse_problem, best, _PREVIEW_TOLERANCE)
        solution = solve_gains(parent.problem, best.model, coarse.parameters)
        return FitResult(parent.training, parent.problem, solution, parent.validation)


def fit_held(data: ChannelData, fit: FitResult, held: Mapping[str, float]) -> FitResult:
    """Fit a model again from its present parameters, with some of them held.

    Args:
        data: the channel, with the runs to fit to.
        fit: the model.
        held: values by "effect.parameter".
    """
    with single_threaded():
        again = fit_model(data, replace(fit.model, held=held), fit.values, usable(data))
        return replace(again, validation=fit.validation)


@dataclass(frozen=True, eq=False)
class PackedFit:
    """A fit without the arrays that all fits of a channel share, small enough to send between processes."""

    solution: Solution
    trusted: BoolArray  # blocks that count, shape (m,)
    derived: dict[str, FloatArray]  # signals that were derived for this model, by name, each (n,)

    @classmethod
    def of(cls, fit: FitResult) -> "PackedFit":
        """Pack a fit."""
        context = fit.training.context
        derived = {name: context[name] for name in (LOAD, LUMPED) if name in context}
        return cls(fit.solution, fit.problem.blocked.trusted, derived)

    def unpack(self, data: ChannelData, other: FitResult) -> FitResult:
        """Restore the fit.

        Args:
            data: the channel that it was fitted to.
            other: another fit to the same channel, whose shared arrays it takes over.
        """
        data = replace(data, context={**data.context, **self.derived})
        blocked = replace(other.problem.blocked, data=data, trusted=self.trusted, load_cache=FitCache())
        problem = FitProblem(blocked, other.problem.noise_model)
        return FitResult(data, problem, self.solution, other.validation)


def diagnose(
    channels: Sequence[ChannelData],
    models: Sequence[Model],
    effects: Sequence[Effect],
    progress: Progress,
    file: str,
) -> Diagnosis:
    """Diagnose channels of one robot, in several processes where that is possible.

    Args:
        channels: efforts with their motion.
        models: the base model of each.
        effects: the library of effects to try.
        progress: called with the current step and the share of it that is done.
        file: name of the data, for the result.
    """
    # A sweep's worker may start no processes; effects of a user's file are unknown in other processes.
    own = all(type(effect).__module__.startswith("estimation.") for effect in effects)
    processes = os.cpu_count() or 1 if own and not current_process().daemon else 1
    with single_threaded():
        return diagnosis.diagnose(
            channels,
            models,
            effects,
            rng=np.random.default_rng(SEED),
            progress=progress,
            file=file,
            processes=processes,
        )
