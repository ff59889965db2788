"""The last word on inner parameters: all of them moved together."""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from estimation.effect import Parameter
from estimation.fit.fit_problem import FitProblem, Solution, residual_slopes, solve_gains
from robot_io.types import FloatArray

_TIMES = 4
_FAR = 0.9  # of the energy before
_EVALUATIONS = 40
_SETTLED = 1e-5
_MOVED = 1e-4  # share of the way gone, that a step must still go
_ARRIVED = 1.0001  # the quotient needs efforts that are settled
_STEP = 2e-3


@dataclass(frozen=True)
class Scale:
    """Turns an inner parameter into a number of order one, and back."""

    parameter: Parameter
    start: float

    @property
    def by_ratio(self) -> bool:
        """Whether the search goes by ratio."""
        return self.parameter.log and self.start > 0.0

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the number."""
        return self.number(self.parameter.lower), self.number(self.parameter.upper)

    def number(self, value: float) -> float:
        """The number for a value."""
        if self.by_ratio:
            return float(np.log(max(value, 1e-300) / self.start))
        return (value - self.start) / self._unit

    def value(self, number: float) -> float:
        """The value for a number."""
        return float(self.start * np.exp(number)) if self.by_ratio else self.start + number * self._unit

    @property
    def _unit(self) -> float:
        low, high = self.parameter.typical
        return abs(self.start) or high - low


def optimize_inner(
    problem: FitProblem, solution: Solution, settled: float = _SETTLED, step: float = _STEP
) -> Solution:
    """Fit all inner parameters of a trial together, the gains by variable projection.

    Where that leads far, the gains may not have followed yet: then it is done again from there.

    Args:
        problem: where to fit.
        solution: where to begin.
        settled: share of the energy that a step must take away for another to be worth it.
        step: of the difference quotient, relative to a parameter's scale.
    """
    for _ in range(_TIMES):
        before, solution = solution, _polished(problem, solution, settled, step)
        if solution.sse > _FAR * before.sse:
            break
    return replace(solution, parameters=solution.model.in_order(solution.parameters))


def _polished(problem: FitProblem, solution: Solution, settled: float, step: float) -> Solution:
    """One search; what is at an end of its range stays there: it would cut short every step of the others."""
    scales = {
        name: Scale(parameter, solution.parameters[name])
        for name, parameter in solution.model.inner.items()
        if name not in solution.model.held and parameter.lower < solution.parameters[name] < parameter.upper
    }
    if not scales:
        return solve_gains(problem, solution.model, solution.parameters, rounds=3)

    last: list[tuple[bytes, Solution]] = []

    def at(numbers: FloatArray) -> Solution:
        if not last or last[0][0] != numbers.tobytes():
            moved = {name: scale.value(x) for (name, scale), x in zip(scales.items(), numbers, strict=True)}
            solved = solve_gains(problem, solution.model, {**solution.parameters, **moved}, arrived=_ARRIVED)
            last[:] = [(numbers.tobytes(), solved)]
        return last[0][1]

    unit = float(np.sqrt(np.mean(problem.whiten(solution.target) ** 2))) or 1.0  # its tolerance is absolute
    low, high = (np.array(side) for side in zip(*(s.bounds for s in scales.values()), strict=True))

    def residual(numbers: FloatArray) -> FloatArray:
        return problem.whiten(at(numbers).residual) / unit

    def jacobian(numbers: FloatArray) -> FloatArray:
        steps = np.where(numbers + step <= high, step, -step)
        ahead = {
            name: scale.value(x) for (name, scale), x in zip(scales.items(), numbers + steps, strict=True)
        }
        return residual_slopes(problem, at(numbers), ahead) / (unit * steps)

    found = scipy.optimize.least_squares(
        residual,
        np.zeros(len(scales)),
        jac=jacobian,
        bounds=(low, high),
        ftol=settled,
        xtol=_MOVED,
        max_nfev=_EVALUATIONS,
        x_scale=0.1,
    )
    polished = at(found.x)
    return polished if polished.sse < solution.sse else solution
