"""Linear least squares that is fast for many samples and few gains, and invariant to the columns' units."""

import numpy as np
import scipy

from palpate.robot_io.errors import InputError
from palpate.robot_io.types import FloatArray, IntArray

# Condition number above which an orthogonal method is used, since normal equations lose half of the digits.
_SAFE_CONDITION = 1e6
_TOLERANCE = 1e-10  # gradient at a bound that may be a rounding error, relative to the largest moment
_PATIENCE = 3  # unsuccessful block exchanges before single exchanges
_MAX_EXCHANGES = 20  # largest number of exchanges per gain
_MIN_RATIO = 1e-12  # least ratio of the smallest to the largest eigenvalue of a subset's scaled X'X


def solve(columns: FloatArray, effort: FloatArray, weights: FloatArray | None = None) -> FloatArray:
    """Minimize |weights * (effort - columns @ gains)|; gains (p,) of minimum norm if undetermined.

    Args:
        columns: effort per unit of each gain, shape (n, p).
        effort: effort to explain, shape (n,).
        weights: factor of each residual (1 / sigma), shape (n,); None for equal weights.
    """
    if weights is not None:
        columns, effort = columns * weights[:, None], effort * weights
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    lengths[lengths == 0.0] = 1.0
    scaled = columns / lengths
    gram = scaled.T @ scaled
    if condition_of_gram(gram) < _SAFE_CONDITION:
        return np.asarray(np.linalg.solve(gram, scaled.T @ effort) / lengths)
    return np.asarray(np.linalg.lstsq(scaled, effort, rcond=None)[0] / lengths)


def condition_of_gram(gram: FloatArray) -> float:
    """Compute the condition number of a matrix X from X'X; infinite if X lacks full rank.

    Args:
        gram: X'X, shape (p, p).
    """
    if not len(gram):
        return 1.0
    eigenvalues = np.linalg.eigvalsh(gram)
    if eigenvalues[0] <= eigenvalues[-1] * np.finfo(float).eps * len(gram):
        return float("inf")
    return float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))


def solve_definite(system: FloatArray, target: FloatArray) -> FloatArray:
    """Solve a symmetric linear system by Cholesky factorization, or by LU if it is not positive definite.

    Args:
        system: symmetric matrix, shape (q, q).
        target: right-hand side, shape (q,).
    """
    if target.size:
        _, solution, failed = scipy.linalg.lapack.dposv(system, target)
        if not failed:
            return np.asarray(solution)
    return np.asarray(np.linalg.solve(system, target))


def solve_within_bounds(
    system: FloatArray,
    moment: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    guess: FloatArray | None = None,
) -> FloatArray:
    """Minimize x' system x / 2 - moment' x within bounds by block principal pivoting, shape (q,).

    J. J. Judice, F. M. Pires, Computers and Operations Research 21 (1994). With lower bounds of zero and no
    upper bounds, this is nonnegative least squares. Values at a bound are equal to it.

    Args:
        system: symmetric positive definite matrix for columns of about unit size, shape (q, q).
        moment: linear term, shape (q,).
        lower: lower bounds, -inf for none, shape (q,).
        upper: upper bounds, inf for none, shape (q,).
        guess: minimum of a similar problem, whose active bounds are tried first, shape (q,).
    """
    fewest_wrong, patience = len(moment) + 1, _PATIENCE
    is_high = np.zeros(len(moment), dtype=np.bool_) if guess is None else guess >= upper
    is_free = ~is_high if guess is None else ~(is_high | (guess <= lower))
    has_upper = bool((upper < np.inf).any())
    bound, solution = lower, np.zeros(len(moment))
    tolerance = _TOLERANCE * np.max(np.abs(moment), initial=0.0)
    for _ in range(_MAX_EXCHANGES * len(moment) + 1):
        if has_upper:
            bound = np.where(is_high, upper, lower)
        solution = np.where(is_free, 0.0, bound)
        if len(free_indices := is_free.nonzero()[0]):
            rows, right_side = system.take(free_indices, axis=0), moment[free_indices]
            if np.count_nonzero(solution):
                right_side = right_side - rows @ solution
            solution[free_indices] = solve_definite(rows.take(free_indices, axis=1), right_side)
        gradient = system @ solution - moment
        wrong = np.where(is_free, solution < lower, gradient < -tolerance)
        if has_upper:
            above = is_free & (solution > upper)
            wrong = np.where(is_high, gradient > tolerance, wrong | above)
        wrong_count = int(np.count_nonzero(wrong))
        if not wrong_count:
            break
        if wrong_count < fewest_wrong:
            fewest_wrong, patience = wrong_count, _PATIENCE
        elif patience:
            patience -= 1
        else:  # exchanging only the last wrong variable guarantees termination (K. G. Murty 1974)
            wrong &= np.arange(len(wrong)) == np.flatnonzero(wrong)[-1]
        if has_upper:
            is_high = (is_high & ~wrong) | (above & wrong)
        is_free = is_free ^ wrong
    return np.clip(solution, lower, upper)


def solve_subsets(
    columns: FloatArray, effort: FloatArray, size: int, trials: int, rng: np.random.Generator
) -> FloatArray:
    """Solve random subsets of samples by least squares; return gains of those not degenerate, (k, p).

    Args:
        columns: effort per unit of each gain, shape (n, p).
        effort: effort to explain, shape (n,).
        size: number of samples in a subset, at least p and at most n.
        trials: number of subsets.
        rng: random generator for the subsets.

    Raises:
        InputError: the size is out of range, or all subsets are degenerate.
    """
    sample_count, gain_count = columns.shape
    if not gain_count <= size <= sample_count:
        raise InputError(
            f"subsets of {size} samples: the size must be at least {gain_count} (number of parameters) and "
            f"at most {sample_count} (number of samples)"
        )
    lengths = np.sqrt(np.mean(columns**2, axis=0))
    lengths[lengths == 0.0] = 1.0
    drawn = _draw_subsets(sample_count, size, trials, rng)
    subset = columns[drawn] / lengths
    gram = np.einsum("tsi,tsj->tij", subset, subset)
    eigenvalues = np.linalg.eigvalsh(gram)
    is_regular = eigenvalues[:, 0] > _MIN_RATIO * np.maximum(eigenvalues[:, -1], np.finfo(float).tiny)
    if not is_regular.any():
        raise InputError(
            f"none of {trials} random subsets determines the parameters: the motion does not excite them "
            "enough"
        )
    moment = np.einsum("tsi,ts->ti", subset, effort[drawn])
    return np.asarray(np.linalg.solve(gram[is_regular], moment[is_regular][..., None])[..., 0] / lengths)


def _draw_subsets(sample_count: int, size: int, trials: int, rng: np.random.Generator) -> IntArray:
    """Draw random subsets without replacement, shape (trials, size), by redrawing subsets with repeats."""
    if size * size > sample_count:  # most subsets would have repeats: rank random numbers instead
        return np.argpartition(rng.random((trials, sample_count)), size - 1, axis=1)[:, :size]
    drawn = rng.integers(sample_count, size=(trials, size))
    while True:
        repeated = (np.diff(np.sort(drawn, axis=1), axis=1) == 0).any(axis=1)
        if not repeated.any():
            return drawn
        drawn[repeated] = rng.integers(sample_count, size=(np.count_nonzero(repeated), size))
