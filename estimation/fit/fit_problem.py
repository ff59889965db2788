"""Linear gains of a model at given inner parameters: the fit problem and its solution."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind, Information
from palpate.estimation.effect import Effect, Inner
from palpate.estimation.fit.blocks import BlockedData
from palpate.estimation.fit.normal_equations import (
    WHITE,
    ArNoise,
    LinearFit,
    NormalEquations,
    Nuisance,
    gram_matrices,
    solve_normal_equations,
)
from palpate.estimation.model import Model, Parts, own_parameters
from palpate.estimation.statistics.least_squares import solve_within_bounds
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

NOT_HELD: Mapping[str, float] = MappingProxyType({})
NO_BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType({})
_MAX_STEPS = 7
_DIVERGED = 1e6  # predictions above this multiple of the largest effort have diverged
_NO_BOUND = (-np.inf, np.inf)
_NO_SCALE = 1e-300  # norm below which a column counts as zero


@dataclass(frozen=True)
class FitProblem:
    """Data on blocks, noise model and residual weights (m,), to which models are fitted."""

    blocked: BlockedData
    noise_model: ArNoise
    weights: FloatArray | None = None
    nuisance: Nuisance | None = None  # flexible laws for which models are adjusted

    @cached_property
    def used(self) -> BoolArray:
        """Mask of the blocks in use, shape (m,)."""
        return self.noise_model.used(self.blocked.run, self.blocked.trusted)

    @cached_property
    def _by_fold(self) -> tuple[IntArray, list[slice]]:
        """Indices of the blocks in use, sorted by fold, and the slice of each fold."""
        fold = np.where(self.used, self.blocked.fold, -1)
        order = np.argsort(fold, kind="stable")[np.sum(~self.used) :]
        borders = np.searchsorted(fold[order], np.arange(self.blocked.folds + 1)).tolist()
        return order, [slice(*ends) for ends in pairwise(borders)]

    def whiten(self, blocks: FloatArray) -> FloatArray:
        """Return the prewhitened, weighted and adjusted values of the blocks in use, shape (w,) or (w, k).

        Args:
            blocks: values on blocks, shape (m,) or (m, k).
        """
        return self._white(blocks)[self.used]

    def _white(self, blocks: FloatArray) -> FloatArray:
        white = self.noise_model.whiten(blocks)
        white = white if self.weights is None else (white.T * self.weights).T
        return white if self.nuisance is None else self.nuisance.remove(white)

    def solve(
        self,
        columns: FloatArray,
        target: FloatArray,
        names: Sequence[str] = (),
        held: Mapping[str, float] = NOT_HELD,
        bounds: Mapping[str, tuple[float, float]] = NO_BOUNDS,
    ) -> LinearFit:
        """Fit columns to a target by bounded least squares.

        The fit to all folds determines which gains are at a bound. These gains stay fixed in the fits that
        leave out a fold.

        Args:
            columns: effort per unit of each gain, shape (m, q).
            target: effort to explain, shape (m,).
            names: names of the first gains.
            held: fixed gains, by name.
            bounds: bounds of gains, by name.
        """
        fixed, extra = [name in held for name in names], columns.shape[1] - len(names)
        gains = np.array([held.get(name, 0.0) for name in names] + [0.0] * extra)
        free = ~np.array(fixed + [False] * extra, dtype=np.bool_)
        if any(fixed):
            target, columns = target - columns @ gains, columns[:, free]
        free_names = [name for name in names if name not in held]
        equations = self.normal_equations([columns], target, free_names)
        fit = solve_normal_equations(equations, dof=len(self._by_fold[0]))
        limits = [bounds.get(name, _NO_BOUND) for name in free_names] + [_NO_BOUND] * extra
        if not all(low <= gain <= high for gain, (low, high) in zip(fit.gains.tolist(), limits, strict=True)):
            lower, upper = np.array(limits).T
            scale = np.maximum(fit.scale, _NO_SCALE)
            unit = fit.gains / scale
            with np.errstate(over="ignore"):  # the scaled bound of a tiny column may overflow to infinity
                low, high = lower / scale, upper / scale
            bounded = solve_within_bounds(fit.system, fit.system @ unit, low, high, guess=unit)
            is_low, is_high = bounded == low, bounded == high
            at_bound, at_value = is_low | is_high, np.where(is_low, lower, np.where(is_high, upper, 0.0))
            fit = solve_normal_equations(equations.with_fixed(at_bound, at_value), dof=fit.dof)
            indices = np.flatnonzero(free)[at_bound]
            gains[indices], free[indices] = at_value[at_bound], False
        return fit if free.all() else fit.with_fixed_gains(gains, np.flatnonzero(free))

    def _rows(self, parts: Sequence[FloatArray], target: FloatArray, indices: IntArray) -> FloatArray:
        """Return some weighted rows of all parts and of the target, shape (rows, q + 1), stored by column."""
        rows, start = np.empty((sum(part.shape[1] for part in parts) + 1, len(indices))), 0
        for part in parts:
            by_column, end = part.flags.f_contiguous, start + part.shape[1]
            rows[start:end] = part.T.take(indices, axis=1) if by_column else part.take(indices, axis=0).T
            start = end
        rows[-1] = target[indices]
        if self.weights is not None:
            rows *= self.weights[indices]
        return rows.T

    def normal_equations(
        self, parts: Sequence[FloatArray], target: FloatArray, names: Sequence[str] = ()
    ) -> NormalEquations:
        """Return the cross products of prewhitened columns and target, by fold.

        Args:
            parts: effort per unit of each gain, shape (m, k) each, with q gains together. They are not joined
                because the copy could take hundreds of megabytes.
            target: effort to explain, shape (m,).
            names: names of the gains of the first columns, which an arm's channels may share.
        """
        order, folds = self._by_fold
        if self.noise_model is WHITE and self.nuisance is None:
            equations = gram_matrices(self._rows(parts, target, order[fold]) for fold in folds)
        else:
            white = self._white(np.concatenate([*(part.T for part in parts), target[None]]).T).T.take(
                order, axis=1
            )
            equations = gram_matrices(white[:, fold].T for fold in folds)
        shared = self.blocked.data.shared  # prior information on gains from other channels
        if shared is None or self.noise_model is not WHITE or not set(shared.names) <= set(names):
            return equations
        indices = [list(names).index(name) for name in shared.names]
        size, count = len(shared.information.matrix), equations.products.shape[-1] - 1
        matrix, vector = np.zeros((size, count, count)), np.zeros((size, count))
        matrix[:, np.array(indices)[:, None], indices] = shared.information.matrix
        vector[:, indices] = shared.information.vector
        return NormalEquations(equations.products, Information(matrix, vector))


@dataclass(frozen=True)
class Solution:
    """A model with parameters and the residual at these parameters."""

    model: Model  # the fitted model
    parameters: dict[str, float]  # gains and inner parameters by "effect.parameter"
    columns: FloatArray  # derivatives by each gain on blocks, not whitened, shape (m, q)
    target: FloatArray  # effort on blocks to be explained by the columns, not whitened, shape (m,)
    linear_fit: LinearFit  # linear fit at these inner parameters

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the gains for white noise, by "effect.parameter"."""
        return dict(zip(self.model.gains, self.linear_fit.standard_errors.tolist(), strict=True))

    @property
    def fixed(self) -> frozenset[str]:
        """Parameters without a standard error: held by the model, or gains at a physical bound."""
        at_bound = {name for name, ends in self.model.gain_bounds.items() if self.parameters[name] in ends}
        return frozenset(self.model.held) | at_bound

    @property
    def sse(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.linear_fit.sse.sum())

    @property
    def residual(self) -> FloatArray:
        """Effort minus prediction on blocks, shape (m,)."""
        gains = np.array([self.parameters[name] for name in self.model.gains])
        residual: FloatArray = self.target - self.columns @ gains
        return residual

    @property
    def held_out(self) -> float:
        """Sum of squared whitened residuals in held-out runs."""
        return float(self.linear_fit.held_out.sum())

    @property
    def is_physical(self) -> bool:
        """Whether no gain is held at a physical bound."""
        return not self.fixed - self.model.held.keys()

    def without_blocks(self) -> "Solution":
        """Return the solution without columns and target, which comparisons do not need, to save memory."""
        return replace(self, columns=self.columns[:0].copy(), target=self.target[:0].copy())


def held_out_residual(blocked: BlockedData, solution: Solution) -> FloatArray:
    """Return effort minus prediction of gains fitted to the other folds, (n,); NaN outside trusted blocks.

    Args:
        blocked: the channel on blocks.
        solution: the fitted model.
    """
    slopes, effort = solution.model.linearize(blocked.data, solution.parameters)
    gains = np.array([solution.parameters[name] for name in solution.model.gains])
    residual = np.full(len(blocked.data), np.nan)
    for fold, fitted in enumerate(solution.linear_fit.fold_gains):
        rows = blocked.rows[(blocked.fold == fold) & blocked.trusted].ravel()
        residual[rows] = blocked.data.effort[rows] - effort[rows] - slopes[rows] @ (fitted - gains)
    return residual


def rmse(residual: FloatArray) -> float:
    """Return the root mean square of all values that are not NaN.

    Args:
        residual: residuals of any shape.
    """
    return float(np.sqrt(np.nanmean(residual**2)))


def solve_gains(
    problem: FitProblem,
    model: Model,
    parameters: Mapping[str, float],
    rounds: int = 2,
    max_ratio: float = 1.02,
    *,
    parts: Parts | None = None,
) -> Solution:
    """Fit the gains at given inner parameters by Gauss-Newton steps.

    Args:
        problem: data, noise weights and folds of the fit.
        model: the model.
        parameters: inner parameters and start values of gains; missing gains start at zero.
        rounds: least number of steps if the model is not linear on blocks. With a nonlinear sensor, steps are
            repeated until the error agrees with its prediction.
        max_ratio: largest ratio of a squared error to its prediction at which a step has converged.
        parts: result of `Model.parts` at these inner parameters, if known.
    """
    data = problem.blocked.data
    if is_linear_on_blocks(data, model):
        # The column of each gain is averaged over blocks separately and cached between fits.
        inner = {name: parameters.get(name, 0.0) for name in model.inner}
        columns, target = _on_blocks(problem, model, inner)
        fit = problem.solve(columns, target, list(model.gains), model.held, model.gain_bounds)
        fitted = dict(zip(model.gains, fit.gains.tolist(), strict=True))
        return Solution(model, {**fitted, **inner}, columns, target, fit)
    values = {name: parameters.get(name, 0.0) for name in (*model.gains, *model.inner)}
    names = list(model.gains)
    max_steps = rounds if model.is_linear_in_gains else max(_MAX_STEPS, rounds)
    linear_fit: LinearFit | None = None
    previous_lifted = np.empty(0, dtype=np.int64)
    parts = parts or model.parts(data, values, problem.blocked.at_full_rate)
    for i in range(max_steps):
        lift_off_rows = model.lift_off_rows(data, values, parts)
        if i and model.is_linear_in_gains and np.array_equal(lift_off_rows, previous_lifted):
            break  # the same samples lose contact, so the fit would be repeated
        previous_lifted = lift_off_rows
        slopes, effort = model.linearize(data, values, parts, lift_off_rows)
        block_slopes, gains = problem.blocked.reduce(slopes), np.array([values[name] for name in names])
        remaining = problem.blocked.reduce(data.effort - effort) + block_slopes @ gains
        if i and not np.abs(remaining).max() < _DIVERGED * np.abs(data.effort).max():
            break  # the last step diverged, and the next would overflow
        target, columns = remaining, block_slopes
        if linear_fit is not None and i >= rounds:
            expected = float(linear_fit.sse.sum())
            if np.sum(problem.whiten(target - columns @ gains) ** 2) <= max_ratio * expected:
                break
        linear_fit = problem.solve(columns, target, names, model.held, model.gain_bounds)
        values.update(zip(names, linear_fit.gains.tolist(), strict=True))
    assert linear_fit is not None  # noqa: S101, the first step always fits
    return Solution(model, values, columns, target, linear_fit)


def _on_blocks(
    problem: FitProblem, model: Model, inner: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the columns (m, q) of a linear model, and the effort (m,) to be explained by them."""
    blocked = problem.blocked
    blocks, known = [np.empty((0, len(blocked)))], np.zeros(len(blocked))
    for effect in model.additive:
        parts = blocked.parts(effect, model, inner)
        blocks.append(parts[:, :-1].T)
        known = known + parts[:, -1]
    columns = np.concatenate(blocks).T
    for sensor in [sensor for sensor in model.sensors if sensor.pointwise]:
        sensed = sensor.sense(np.column_stack([columns, known]), blocked.data, own_parameters(sensor, inner))
        columns, known = sensed[:, :-1], sensed[:, -1]
    return columns, blocked.effort - known - blocked.initial_response(model, inner)


def columns_at(
    problem: FitProblem, model: Model, parameters: Mapping[str, float], parts: Parts | None = None
) -> FloatArray:
    """Return the derivative of the effort on blocks by each gain at given parameters, shape (m, q).

    Args:
        problem: data, noise weights and folds of the fit.
        model: the model.
        parameters: values by "effect.parameter"; missing gains are zero.
        parts: result of `Model.parts` at these inner parameters, if known.
    """
    data = problem.blocked.data
    if is_linear_on_blocks(data, model):
        return _on_blocks(problem, model, parameters)[0]
    values = {**dict.fromkeys(model.gains, 0.0), **parameters}
    parts = parts or model.parts(data, values, problem.blocked.at_full_rate)
    return problem.blocked.reduce(model.linearize(data, values, parts)[0])


def residual_slopes(problem: FitProblem, solution: Solution, ahead: Mapping[str, float]) -> FloatArray:
    """Compute the change (w, k) of the whitened residual when inner parameters change and gains are refitted.

    It is the change at fixed gains minus the part that the columns explain, not divided by the step. Divided
    by it, it is the derivative of the variable projection except for a term that vanishes with the residual
    (L. Kaufman, BIT 15 (1975)).

    Args:
        problem: data, noise weights and folds of the fit.
        solution: solution at which the change is computed.
        ahead: a changed value of each inner parameter, close to that of the solution, by name.
    """
    data, model, parameters = problem.blocked.data, solution.model, solution.parameters
    gains = np.array([parameters[name] for name in model.gains])
    changes = []
    if is_linear_on_blocks(data, model):
        residual = solution.residual
        for name, value in ahead.items():
            columns, target = _on_blocks(problem, model, {**parameters, name: value})
            changes.append(target - columns @ gains - residual)
    else:
        parts = model.parts(data, parameters, problem.blocked.at_full_rate)
        effort = model.predict_from(parts, data, parameters)
        for name, value in ahead.items():
            effect, changed = model.effect(name.partition(".")[0]), {**parameters, name: value}
            after = model.parts_after(effect, data, changed, parts, problem.blocked.at_full_rate)
            changes.append(problem.blocked.reduce(effort - model.predict_from(after, data, changed)))
    change = problem.whiten(np.stack(changes, axis=1))
    fit = solution.linear_fit
    unit = problem.whiten(solution.columns) * fit.scale
    return np.asarray(change - unit @ np.linalg.solve(fit.system, unit.T @ change))


LinearizedParts = Callable[[Inner], Parts | None]


def is_linear_on_blocks(data: ChannelData, model: Model) -> bool:
    """Return whether a model can be fitted to block averages; contact forces are clipped at each sample.

    Args:
        data: the channel; a contact is never fitted to averages.
        model: the model, whose reading must be linear in all gains.
    """
    return model.is_linear_in_gains and data.kind is not ChannelKind.CONTACT


def linearize_inner(
    blocked: BlockedData, model: Model, effect: Effect, parameters: Mapping[str, float]
) -> LinearizedParts:
    """Return a fast evaluation of `Model.parts` as a function of one effect's inner parameters.

    The function returns the parts, or None if nothing is faster than `Model.parts`.

    Args:
        blocked: the channel on blocks.
        model: the model.
        effect: the effect whose inner parameters vary.
        parameters: inner parameters of the other effects; missing ones are zero.
    """
    data, known = blocked.data, list[Parts]()
    if is_linear_on_blocks(data, model):
        return lambda inner: None

    def parts(inner: Inner) -> Parts:
        values = {name: parameters.get(name, 0.0) for name in model.inner}
        values |= {f"{effect.name}.{name}": value for name, value in inner.items()}
        if not known:
            known.append(model.parts(data, values, blocked.at_full_rate))
        return model.parts_after(effect, data, values, known[0], blocked.at_full_rate)

    return parts
