"""A first answer for one more effect, on means over blocks: the best of a few places, where that leads."""

import numpy as np

from estimation.diagnosis.candidates import extended_models
from estimation.effect import Effect
from estimation.fit.ar_noise import WHITE
from estimation.fit.blocks import BlockedData, decimate
from estimation.fit.fit_problem import FitProblem, solve_gains
from estimation.fit.fit_result import FitResult
from estimation.fit.inner_optimization import optimize_inner
from estimation.fit.inner_search import search_inner

_FEW = 6  # places, or somewhat more
_SETTLED = 0.01  # of the energy


def rough_bench(result: FitResult) -> FitProblem:
    """The bench of a fit with one sample for each block: a trial there costs a fraction.

    Also where the model itself is fitted on blocks: what is added may need samples.
    """
    blocked = result.problem.blocked
    rows = np.arange(len(blocked))[:, None]
    return FitProblem(BlockedData(decimate(blocked), rows, blocked.run, blocked.fold, blocked.trusted), WHITE)


def glance(result: FitResult, effect: Effect, rough: FitProblem) -> FitResult:
    """The model of `standing` with one more effect, near the place where a fit would end.

    Args:
        result: the model without the effect.
        effect: what is added.
        rough: from `rough_bench`.
    """
    known, places = result.solution.parameters, effect.starts(result.data)
    places = places[:: max(len(places) // _FEW, 1)]
    tried = [
        search_inner(rough, model, effect, known, places).best
        for model in extended_models(result.solution.model, effect)
    ]
    best = min(tried, key=lambda solution: solution.sse)
    followed = optimize_inner(rough, best, _SETTLED)
    solution = solve_gains(result.problem, best.model, followed.parameters)
    return FitResult(result.data, result.problem, solution)
