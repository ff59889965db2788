"""Flexible laws that are left out of a comparison: the nuisance part of a partially linear model.

    effort = form(motion; theta) + nuisance(motion) + noise

Both sides are projected on what the nuisance columns cannot explain, and the form is fitted there (P. M.
Robinson, Econometrica 56 (1988); R. Frisch, F. V. Waugh, Econometrica 1 (1933)). So a form need not wait
until all other effects have a name.
"""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.signals.blocks import rows_of_runs
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_INDEPENDENT = 1e-4  # of the largest singular value of columns of unit size


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Orthonormal columns on blocks; rows that are not used are zero."""

    by_run: FloatArray  # orthonormal within each run, shape (m, j); j = 0 without differences between runs
    run: IntArray  # run of each block, shape (m,)
    basis: FloatArray  # orthonormal over all blocks, shape (m, q)

    def remove(self, blocks: FloatArray) -> FloatArray:
        """Return what the nuisance columns leave of blocks (m,) or (m, k)."""
        left = _without_runs(blocks, self.by_run, self.run)
        return np.asarray(left - self.basis @ (self.basis.T @ left))


def nuisance_of(columns: FloatArray, by_run: FloatArray, run: IntArray, used: BoolArray) -> Nuisance:
    """Prepare the projection.

    Args:
        columns: flexible laws of all runs together, shape (m, q).
        by_run: columns with a coefficient of its own in each run, shape (m, j).
        run: run of each block, shape (m,).
        used: blocks that count, shape (m,).
    """
    own = np.zeros(by_run.shape)
    for rows in rows_of_runs(run):
        some = rows[used[rows]]
        own[some, : min(by_run.shape[1], len(some))] = _orthonormal(by_run[some])[:, : by_run.shape[1]]
    masked = _without_runs(columns * used[:, None], own, run)
    return Nuisance(own, run, _orthonormal(masked, drop=True))


def _without_runs(blocks: FloatArray, by_run: FloatArray, run: IntArray) -> FloatArray:
    if by_run.shape[1] == 0:
        return blocks
    left = blocks.astype(np.float64, copy=True)
    for rows in rows_of_runs(run):
        own = by_run[rows]
        left[rows] -= own @ (own.T @ left[rows])
    return left


def _orthonormal(columns: FloatArray, *, drop: bool = False) -> FloatArray:
    """Return an orthonormal basis of columns (m, q); directions that hardly exist are zero, or dropped."""
    size = np.sqrt(np.sum(columns**2, axis=0))
    unit = columns / np.where(size > 0.0, size, 1.0)
    left, values, _ = np.linalg.svd(unit, full_matrices=False)
    exist = values > _INDEPENDENT * max(values.max(initial=0.0), 1e-300)
    return np.asarray(left[:, exist] if drop else left * exist)
