"""Normal equations by cross-validation fold, their solution, and autoregressive noise."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from palpate.estimation.channel import Information
from palpate.estimation.signals.blocks import block_index, rows_of_runs
from palpate.estimation.statistics.least_squares import solve_definite
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

ORDER = 4
_MIN_SINGULAR_VALUE = 1e-4  # least ratio to the largest singular value of normalized columns
_RIDGE = 1e-9  # ridge penalty on columns of unit length, which only keeps collinear columns finite


@dataclass(frozen=True)
class NormalEquations:
    """Cross products of columns and target, by fold."""

    products: FloatArray  # shape (folds, q + 1, q + 1); the last row and column belong to the target
    # Prior information on the gains, matrix (1 + folds, q, q), see `SharedGains`.
    prior: Information | None = None

    def only(self, columns: BoolArray) -> "NormalEquations":
        """Return the equations with only some columns and the target.

        Args:
            columns: mask of the columns to keep, shape (q,).
        """
        kept = np.append(np.flatnonzero(columns), len(columns))
        prior = self.prior and Information(
            self.prior.matrix[:, kept[:-1, None], kept[None, :-1]], self.prior.vector[:, kept[:-1]]
        )
        return NormalEquations(self.products.take(kept, axis=1).take(kept, axis=2), prior)

    def with_fixed(self, columns: BoolArray, gains: FloatArray) -> "NormalEquations":
        """Return the equations without columns of fixed gains, whose effort is subtracted from the target.

        Args:
            columns: mask of the columns to remove, shape (q,).
            gains: gains of all columns, shape (q,); only those of removed columns are used.
        """
        if not gains[columns].any():  # a gain of zero has no effort
            return self.only(~columns)
        shift = np.eye(len(gains) + 1)
        shift[:-1, -1] = np.where(columns, -gains, 0.0)
        prior = self.prior and Information(
            self.prior.matrix, self.prior.vector + self.prior.matrix @ shift[:-1, -1]
        )
        return NormalEquations(shift.T @ self.products @ shift, prior).only(~columns)

    def systems(self, scale: FloatArray, *, by_fold: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return the matrix (q, q) and right-hand side (q,) of the linear system with scaled columns.

        Args:
            scale: factor of each column, shape (q,).
            by_fold: whether to leave out each fold in turn; the results then have a first axis (folds,).
        """
        sums, prior = (self._sums - self.products, slice(1, None)) if by_fold else (self._sums, 0)
        system, target = sums[..., :-1, :-1], sums[..., :-1, -1]
        if self.prior is not None:
            system, target = system + self.prior.matrix[prior], target + self.prior.vector[prior]
        return system * scale[:, None] * scale, target * scale

    @cached_property
    def held_out_systems(self) -> tuple[FloatArray, FloatArray]:
        """Linear systems without each fold for columns of unit length, see `systems`."""
        return self.systems(self.scale, by_fold=True)

    @cached_property
    def scale(self) -> FloatArray:
        """Factors that scale the columns to unit length over all folds, shape (q,).

        Prior information counts as additional rows, so that columns with little data are not scaled up.
        """
        squares = self._sums.diagonal()[:-1]
        if self.prior is not None:
            squares = squares + self.prior.matrix[0].diagonal()
        lengths = np.sqrt(squares)
        return np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)

    @cached_property
    def scaled(self) -> FloatArray:
        """Products with scaled columns, shape (folds, q + 1, q + 1); the target is not scaled."""
        scale = np.append(self.scale, 1.0)
        scaled: FloatArray = self.products * scale[:, None] * scale
        return scaled

    @cached_property
    def _sums(self) -> FloatArray:
        """Cross products over all folds, shape (q + 1, q + 1)."""
        return np.asarray(self.products.sum(axis=0))


def gram_matrices(parts: Iterable[FloatArray]) -> NormalEquations:
    """Compute the cross products of columns and target by fold.

    Args:
        parts: columns and target of each fold, shape (rows, q + 1) each.
    """
    return NormalEquations(np.stack([part.T @ part for part in parts]))


@dataclass(frozen=True)
class LinearFit:
    """Linear least-squares fit, with its errors and cross-validation on first use."""

    gains: FloatArray  # gains fitted to all folds, shape (q,)
    system: FloatArray  # Gram matrix for columns of unit length, shape (q, q)
    scale: FloatArray  # factors that scale the columns to unit length, zero for fixed gains, shape (q,)
    dof: int  # number of samples in the fit; 0 if unknown
    equations: NormalEquations  # of the free gains
    free: IntArray  # indices of the free gains

    @cached_property
    def sse(self) -> FloatArray:
        """Sum of squared residuals of the fit to all folds, by fold, shape (folds,)."""
        scale = self.equations.scale
        return _sse(self.equations.scaled, self.gains[self.free] / np.where(scale > 0.0, scale, 1.0))

    @cached_property
    def fold_gains(self) -> FloatArray:
        """Gains fitted without each fold, shape (folds, q)."""
        gains = np.repeat(self.gains[None], len(self.equations.products), axis=0)
        gains[:, self.free] = self._unit_gains * self.scale[self.free]
        return gains

    @cached_property
    def train(self) -> FloatArray:
        """For each fold, sum of squared residuals of the fit without it, in the other folds."""
        scaled = self.equations.scaled
        return _sse(scaled.sum(axis=0) - scaled, self._unit_gains)

    @cached_property
    def held_out(self) -> FloatArray:
        """For each fold, sum of squared residuals of the fit without it, in this fold."""
        return _sse(self.equations.scaled, self._unit_gains)

    @cached_property
    def _unit_gains(self) -> FloatArray:
        """Free gains of columns of unit length, fitted without each fold, shape (folds, free)."""
        system, target = self.equations.systems(self.scale[self.free], by_fold=True)
        system += _RIDGE * np.eye(len(self.free))
        return np.asarray(np.linalg.solve(system, target[..., None])[..., 0])

    @property
    def standard_errors(self) -> FloatArray:
        """Standard errors of the gains for white noise, shape (q,); NaN if there are too few samples."""
        dof = self.dof - len(self.gains)
        if dof <= 0:
            return np.full(len(self.gains), np.nan)
        variance = np.diag(np.linalg.inv(self.system)) * self.sse.sum() / dof
        return np.asarray(np.sqrt(variance) * self.scale)

    def with_fixed_gains(self, gains: FloatArray, free: IntArray) -> "LinearFit":
        """Return the fit with fixed gains inserted.

        Args:
            gains: values of all gains, shape (q,); those of free gains are replaced.
            free: indices of the fitted gains.
        """
        whole, system, scale = gains.copy(), np.eye(len(gains)), np.zeros(len(gains))
        whole[free], system[np.ix_(free, free)], scale[free] = self.gains, self.system, self.scale
        return replace(self, gains=whole, system=system, scale=scale, free=free)


def solve_normal_equations(equations: NormalEquations, dof: int = 0) -> LinearFit:
    """Fit the gains to all folds.

    Args:
        equations: normal equations by fold.
        dof: number of samples, for standard errors; 0 if they are not needed.
    """
    scale = equations.scale
    system, target = equations.systems(scale)
    system.flat[:: len(scale) + 1] += _RIDGE
    gains = np.asarray(np.linalg.solve(system, target))
    return LinearFit(gains * scale, system, scale, dof, equations, np.arange(len(scale)))


def held_out_sse(
    equations: NormalEquations, ridges: FloatArray, columns: IntArray | None = None
) -> FloatArray:
    """Return the held-out sum of squared residuals for several ridge penalties, shape (r, folds).

    Args:
        equations: normal equations by fold.
        ridges: ridge penalties to try, on columns of unit length, shape (r, k).
        columns: indices of the columns to fit, shape (k,); None for all.
    """
    columns = np.arange(ridges.shape[1]) if columns is None else columns
    indices = np.append(columns, len(equations.scale))  # with the target
    gains = np.array([_held_out_unit_gains(equations, ridge, columns) for ridge in ridges])
    return _sse(equations.scaled.take(indices, axis=1).take(indices, axis=2), gains)


def held_out_gains(equations: NormalEquations, ridge: FloatArray, columns: IntArray) -> FloatArray:
    """Return the gains fitted without each fold, with a ridge penalty, shape (folds, k).

    Args:
        equations: normal equations by fold.
        ridge: ridge penalty of each gain, on columns of unit length, shape (k,).
        columns: indices of the columns to fit, shape (k,).
    """
    return _held_out_unit_gains(equations, ridge, columns) * equations.scale[columns]


def _held_out_unit_gains(equations: NormalEquations, ridge: FloatArray, columns: IntArray) -> FloatArray:
    """Return gains of columns of unit length, fitted without each fold, shape (folds, k)."""
    systems, targets = equations.held_out_systems
    systems, diagonal = systems.take(columns, axis=1).take(columns, axis=2), np.arange(len(columns))
    systems[:, diagonal, diagonal] += ridge
    return np.array(list(map(solve_definite, systems, targets[:, columns])))


def _sse(products: FloatArray, gains: FloatArray) -> FloatArray:
    """Return squared residuals of `gains` (q,) or (..., folds, q) on each fold's products."""
    signed = np.concatenate([-gains, np.ones((*gains.shape[:-1], 1))], axis=-1)
    sse: FloatArray = np.sum((products @ signed[..., None])[..., 0] * signed, axis=-1)
    return np.maximum(sse, 0.0)


@dataclass(frozen=True)
class ArNoise:
    """Autoregressive noise model, restarted at each run."""

    coefficients: FloatArray  # coefficients of the previous samples, newest first; empty for white noise

    def used(self, run: IntArray, trusted: BoolArray) -> BoolArray:
        """Return the mask (m,) of trusted samples whose required past is trusted and in the same run.

        Args:
            run: run number of each sample, shape (m,).
            trusted: mask of samples that may be used, shape (m,).
        """
        order = len(self.coefficients)
        used = trusted.copy()
        used[:order] = False
        for lag in range(1, order + 1):
            used[order:] &= trusted[order - lag : len(run) - lag]
        used[order:] &= run[order:] == run[: len(run) - order]
        return used

    def whiten(self, signal: FloatArray) -> FloatArray:
        """Prewhiten a signal, keeping its shape; only rows in `used` are meaningful.

        Args:
            signal: signal, shape (m,) or (m, k).
        """
        order = len(self.coefficients)
        if order == 0:
            return signal
        whitened = np.array(signal, dtype=np.float64)
        for lag, weight in enumerate(self.coefficients, start=1):
            whitened[order:] -= weight * signal[order - lag : len(signal) - lag]
        return whitened


WHITE = ArNoise(np.empty(0))


def estimate_ar_noise(residual: FloatArray, run: IntArray, trusted: BoolArray) -> ArNoise:
    """Estimate the autoregressive noise model of residuals (Yule-Walker, pooled over runs).

    Args:
        residual: residuals, shape (m,).
        run: run number of each residual, shape (m,).
        trusted: mask of the residuals to use, shape (m,).
    """
    clean = np.where(trusted, residual, 0.0)
    products = np.empty(ORDER + 1)
    for lag in range(ORDER + 1):
        same = run[lag:] == run[: len(run) - lag]
        products[lag] = np.sum((clean[lag:] * clean[: len(clean) - lag])[same])
    if not products[0] > 0.0:
        return WHITE
    products[0] *= 1.0 + 1e-6
    return ArNoise(scipy.linalg.solve_toeplitz(products[:-1], products[1:]))


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Orthonormal nuisance columns on blocks; rows that are not used are zero."""

    by_run: FloatArray  # orthonormal within each run, shape (m, j); j = 0 without differences between runs
    run: IntArray  # run of each block, shape (m,)
    basis: FloatArray  # orthonormal over all blocks, shape (m, q)

    def remove(self, blocks: FloatArray) -> FloatArray:
        """Project block values on the orthogonal complement of the nuisance columns.

        Args:
            blocks: values on blocks, shape (m,) or (m, k).
        """
        residual = _without_runs(blocks, self.by_run, self.run)
        return np.asarray(residual - self.basis @ (self.basis.T @ residual))


def nuisance_of(columns: FloatArray, by_run: FloatArray, run: IntArray, used: BoolArray) -> Nuisance:
    """Orthonormalize nuisance columns.

    Args:
        columns: columns with one coefficient for all runs, shape (m, q).
        by_run: columns with a separate coefficient in each run, shape (m, j).
        run: run number of each block, shape (m,).
        used: mask of the blocks in use, shape (m,).
    """
    run_basis = np.zeros(by_run.shape)
    for rows in rows_of_runs(run):
        chosen = rows[used[rows]]
        run_basis[chosen, : min(by_run.shape[1], len(chosen))] = _orthonormal(by_run[chosen])
    masked = _without_runs(columns * used[:, None], run_basis, run)
    return Nuisance(run_basis, run, _orthonormal(masked, drop=True))


def _without_runs(blocks: FloatArray, by_run: FloatArray, run: IntArray) -> FloatArray:
    if by_run.shape[1] == 0:
        return blocks
    starts, number = block_index(run)
    residual = np.array(blocks.T, dtype=np.float64)
    for column in by_run.T:
        residual -= np.add.reduceat(blocks.T * column, starts, axis=-1)[..., number] * column
    return residual.T


def _orthonormal(columns: FloatArray, *, drop: bool = False) -> FloatArray:
    """Return an orthonormal basis of columns (m, q); negligible directions are zero, or dropped."""
    lengths = np.sqrt(np.sum(columns**2, axis=0))
    unit = columns / np.where(lengths > 0.0, lengths, 1.0)
    left, values, _ = np.linalg.svd(unit, full_matrices=False)
    is_independent = values > _MIN_SINGULAR_VALUE * max(values.max(initial=0.0), 1e-300)
    return np.asarray(left[:, is_independent] if drop else left * is_independent)
