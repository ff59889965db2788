"""Flexible regression: ridge regression on all signals and their past, as a nonparametric alternative.

It estimates how much of a model's error any function of the signals can explain, and which signals matter.
The smoothing bias of derived motion counts as noise, see `smoothing_bias`.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from palpate.estimation.fit.fit_problem import FitProblem, Solution
from palpate.estimation.fit.normal_equations import (
    NormalEquations,
    held_out_gains,
    held_out_sse,
)
from palpate.estimation.fit.smooth_features import smooth_features
from palpate.estimation.fit.smoothing_bias import DifferentiationFilter, fit_smoothing_bias
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1)
_MAX_SIGNALS = 4  # signals that are selected one by one
_MIN_GAIN = 0.005  # least share of the energy that an additional signal must explain


@dataclass(frozen=True)
class FlexibleRegression:
    """A flexible regression on the residual of a model."""

    # Squared whitened held-out residuals of the model by fold, corrected for smoothing bias, shape (folds,).
    before: FloatArray
    held_out: FloatArray  # the same with the flexible regression
    residual: FloatArray  # held-out residuals with the regression on blocks, not whitened, shape (m,)
    residual_before: FloatArray  # the same without the regression
    # Share of the squared error that each signal alone can explain in held-out runs.
    by_signal: dict[str, float]

    @property
    def explained(self) -> float:
        """Decrease of the squared whitened held-out residuals by the flexible regression."""
        return float(np.sum(self.before - self.held_out))

    def share_of(self, solution: Solution, least: float = 0.0) -> float:
        """Return the share of a model's error, or of `least` if larger, that the regression explains.

        Args:
            solution: the model.
            least: lower limit of the squared error to which the share refers.
        """
        error = max(solution.held_out, least)
        unexplained = max(1.0 - self.explained / error, 0.0) if error > 0.0 else 1.0
        return float(1.0 - np.sqrt(unexplained))


def model_features(problem: FitProblem, solution: Solution) -> dict[str, FloatArray]:
    """Return features (m, k) by signal, for the motion and effort of a fitted model.

    The effort before sensor effects is an additional signal, since saturated or delayed readings lose
    information that the regression needs.

    Args:
        problem: data on blocks.
        solution: the fitted model.
    """
    blocked, model = problem.blocked, solution.model
    efforts = [blocked.effort - solution.residual]
    sensors = [sensor for sensor in model.sensors if not sensor.pointwise]
    if sensors:
        unsensed = model.without(*(sensor.name for sensor in sensors))
        efforts.append(blocked.reduce(unsensed.predict(blocked.data, solution.parameters)))
    return smooth_features(blocked, efforts)


def fit_flexible(
    problem: FitProblem, solution: Solution, filters: DifferentiationFilter, without: Collection[str] = ()
) -> FlexibleRegression:
    """Fit the flexible regression jointly with the model's gains, with cross-validation.

    Args:
        problem: data on blocks, whose noise is assumed to be white.
        solution: the fitted model.
        filters: windows that derived velocity and acceleration.
        without: signals that the regression must not use.
    """
    blocked, all_names = problem.blocked, list(solution.model.gains)
    names = [name for name in all_names if name not in solution.fixed]
    free = np.array([name in names for name in all_names], dtype=np.bool_)
    fixed = np.array([solution.parameters[name] for name in all_names]) * ~free
    target = solution.target - solution.columns @ fixed
    blocks = {name: block for name, block in model_features(problem, solution).items() if name not in without}
    bias, _ = fit_smoothing_bias(problem, solution, filters)
    parts, signals = [solution.columns[:, free], bias, *blocks.values()], list(blocks)
    blocks.clear()
    widths = [part.shape[1] for part in parts]
    owner = np.repeat(np.arange(len(parts)) - 2, widths)
    columns = np.empty((len(target), len(owner)))
    for end, width in zip(np.cumsum(widths), widths, strict=True):
        columns[:, end - width : end] = parts.pop(0)  # frees the part; all need hundreds of megabytes
    equations = problem.normal_equations(columns, target, names)
    without_signals = _fit_ridge(equations, owner, ())
    alone = [_fit_ridge(equations, owner, (number,)) for number in range(len(signals))]
    best = _select_signals(equations, owner, alone, without_signals)
    by_signal = {
        name: 1.0 - fit.energy / without_signals.energy if without_signals.energy > 0.0 else 0.0
        for name, fit in zip(signals, alone, strict=True)
    }
    residuals = []
    for fit in (best, without_signals):
        residual = np.empty_like(target)
        for fold, gains in enumerate(held_out_gains(equations.only(fit.kept), fit.ridge)):
            test = blocked.fold == fold
            residual[test] = target[test] - columns[test][:, fit.kept] @ gains
        residuals.append(residual)
    after, before = residuals
    return FlexibleRegression(without_signals.held_out, best.held_out, after, before, by_signal)


@dataclass(frozen=True)
class _RidgeFit:
    """Ridge regression on some of the signals."""

    signals: tuple[int, ...]  # numbers of the signals
    kept: BoolArray  # mask of the columns in use, shape (q,)
    ridge: FloatArray  # ridge penalty of these columns
    held_out: FloatArray  # squared whitened residuals by fold, shape (folds,)

    @property
    def energy(self) -> float:
        return float(self.held_out.sum())


def _fit_ridge(equations: NormalEquations, owner: IntArray, signals: tuple[int, ...]) -> _RidgeFit:
    """Fit the given signals with the ridge penalty that predicts held-out folds best."""
    kept = (owner < 0) | np.isin(owner, signals)
    kept_equations, is_penalized = equations.only(kept), owner[kept] >= 0
    ridges = np.where(is_penalized, np.array(_RIDGES)[:, None], 1e-9)
    sse = held_out_sse(kept_equations, ridges)
    best = int(np.argmin(sse.sum(axis=1)))
    return _RidgeFit(signals, kept, ridges[best], sse[best])


def _select_signals(
    equations: NormalEquations, owner: IntArray, alone: list[_RidgeFit], none: _RidgeFit
) -> _RidgeFit:
    """Select all signals, or those of a forward selection, by the held-out error."""
    best = none
    while len(best.signals) < _MAX_SIGNALS:
        extended = [
            _fit_ridge(equations, owner, (*best.signals, n)) if best.signals else alone[n]
            for n in range(len(alone))
            if n not in best.signals
        ]
        best_extended = min(extended, key=lambda fit: fit.energy)
        if best_extended.energy > best.energy - _MIN_GAIN * none.energy:
            break
        best = best_extended
    all_signals = _fit_ridge(equations, owner, tuple(range(len(alone))))
    return min(best, all_signals, key=lambda fit: fit.energy)
