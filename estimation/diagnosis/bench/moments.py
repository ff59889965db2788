"""Everything that a linear fit and its held-out errors need, in one small matrix per fold."""

from dataclasses import dataclass

import numpy as np

from robot_io.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Moments:
    """Cross products of columns and target, fold by fold.

    Attributes:
        products: shape (folds, q + 1, q + 1); the last row and column belong to the target.
    """

    products: FloatArray

    @property
    def energy(self) -> FloatArray:
        """Sum of the squared target in each fold."""
        return self.products[:, -1, -1]

    def only(self, columns: BoolArray) -> "Moments":
        """With only these columns, a mask of shape (q,), and the target."""
        kept = np.append(np.flatnonzero(columns), len(columns))
        return Moments(self.products[:, kept[:, None], kept[None, :]])


def moments_of(columns: FloatArray, target: FloatArray, fold: IntArray, folds: int) -> Moments:
    """Cross products of columns (m, q) and target (m,), by fold."""
    both = np.column_stack([columns, target])
    return Moments(np.stack([part.T @ part for part in (both[fold == f] for f in range(folds))]))


@dataclass(frozen=True)
class Scores:
    """A linear fit.

    Attributes:
        gains: fitted to all folds, shape (q,).
        spread: their standard errors for white noise, shape (q,).
        fold_gains: fitted to all but each fold, shape (folds, q).
        sse: sum of squared residuals of that fit, by fold.
        train: sum of squared residuals over the other folds, of the fit to those, shape (folds,).
        held_out: sum of squared residuals in each fold, of the fit to the others, shape (folds,).
    """

    gains: FloatArray
    spread: FloatArray
    fold_gains: FloatArray
    sse: FloatArray
    train: FloatArray
    held_out: FloatArray


def score(moments: Moments, ridge: float | FloatArray = 1e-9, dof: int = 0) -> Scores:
    """Fit to all and to all but each fold.

    Args:
        moments: of columns and target.
        ridge: shrinkage on columns of unit mean square; the default only keeps collinear columns finite.
        dof: samples, for the standard errors; 0 if they are not wanted.
    """
    products = moments.products
    total = products.sum(axis=0)
    width = np.sqrt(np.diag(total)[:-1])
    scale = np.append(np.where(width > 0.0, 1.0 / np.where(width > 0.0, width, 1.0), 0.0), 1.0)
    scaled = products * scale[:, None] * scale[None, :]
    whole = scaled.sum(axis=0)
    others = whole[None] - scaled
    every = np.concatenate([whole[None], others])
    system = every[:, :-1, :-1] + np.diag(np.broadcast_to(ridge, width.shape))
    gains = np.linalg.solve(system, every[:, :-1, -1:])[..., 0]
    sse = _sse(scaled, gains[0])
    train = _sse(others, gains[1:])
    held_out = _sse(scaled, gains[1:])
    spread = np.full(len(width), np.nan)
    if dof > len(width):
        inverse = np.linalg.inv(system[0])
        spread = np.sqrt(np.diag(inverse) * max(sse.sum(), 0.0) / (dof - len(width))) * scale[:-1]
    return Scores(gains[0] * scale[:-1], spread, gains[1:] * scale[:-1], sse, train, held_out)


def _sse(products: FloatArray, gains: FloatArray) -> FloatArray:
    """Squared residuals of `gains` (q,) or (folds, q) on each fold's products."""
    signed = np.concatenate([-gains, np.ones((*gains.shape[:-1], 1))], axis=-1)
    if signed.ndim == 1:
        signed = np.broadcast_to(signed, (len(products), len(signed)))
    sse: FloatArray = np.maximum(np.einsum("fi,fij,fj->f", signed, products, signed), 0.0)
    return sse
