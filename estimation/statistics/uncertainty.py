"""Standard errors and confidence intervals of parameters."""

from dataclasses import dataclass

import numpy as np
import scipy

from palpate.estimation.statistics.least_squares import condition_of_gram
from palpate.estimation.statistics.noise import sum_covariance
from palpate.robot_io.types import FloatArray, IntArray

CONFIDENCE = 0.95
SINGULAR = 1e8  # condition number above which double precision leaves no correct digit


@dataclass(frozen=True)
class Covariance:
    """Covariance of an estimate."""

    matrix: FloatArray  # shape (m, m); NaN if unknown
    degrees_of_freedom: float  # degrees of freedom of Student's t; fewer for correlated residuals

    @property
    def std_err(self) -> FloatArray:
        """Standard errors, shape (m,)."""
        return np.sqrt(np.diag(self.matrix))

    def intervals(self, values: FloatArray) -> FloatArray:
        """Return 95 % confidence intervals, shape (m, 2).

        Args:
            values: estimates, shape (m,).
        """
        reach = scipy.special.stdtrit(self.degrees_of_freedom, 0.5 + CONFIDENCE / 2) * self.std_err
        return np.column_stack([values - reach, values + reach])


def sandwich(
    jacobian: FloatArray, score: FloatArray, slope: FloatArray, run: IntArray | None = None
) -> Covariance:
    """Estimate the covariance of the solution of sum_i jacobian_i score_i = 0.

    The estimate is an Eicker-Huber-White sandwich with a HAC covariance of the scores, which is valid for
    correlated and heteroscedastic noise.

    Args:
        jacobian: derivatives of the prediction by the parameters, shape (n, m).
        score: weighted psi of each residual, shape (n,); the residual itself for least squares.
        slope: derivative of the score by the residual, shape (n,); 1 for least squares.
        run: run number of each sample, shape (n,), see `Regression`.
    """
    sample_count, parameter_count = jacobian.shape
    lengths = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(lengths > 0.0, lengths, 1.0)
    if not lengths.all() or condition_of_gram(scaled.T @ scaled) > SINGULAR:
        return unknown_covariance(parameter_count)
    curvature = scaled.T @ (scaled * slope[:, None])
    if np.linalg.cond(curvature) > SINGULAR**2:  # too few samples have weight, or all are alike
        return unknown_covariance(parameter_count)
    bread = np.linalg.inv(curvature)
    meat = sum_covariance(scaled * score[:, None], run)
    degrees_of_freedom = max(1.0, meat.effective_count - parameter_count)
    matrix = bread @ meat.matrix @ bread * (sample_count / max(1, sample_count - parameter_count))
    return Covariance(matrix / np.outer(lengths, lengths), degrees_of_freedom)


def common_error_covariance(jacobian: FloatArray, group: IntArray, std_err: FloatArray) -> FloatArray:
    """Compute the covariance that errors shared by many samples add to the solution, shape (m, m).

    The residuals do not show such errors, because the parameters absorb their least-squares fit. A. Pagan,
    Econometric Issues in the Analysis of Regressions with Generated Regressors, International Economic Review
    25 (1984).

    Args:
        jacobian: derivatives of the prediction by the parameters, shape (n, m).
        group: index into `std_err` of the error that each sample shares, shape (n,).
        std_err: standard errors of r independent errors, shape (r,) [effort].
    """
    lengths = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    lengths[lengths == 0.0] = 1.0
    inverse = np.linalg.pinv(jacobian / lengths) / lengths[:, None]
    by_group = [np.bincount(group, weights=row, minlength=len(std_err)) for row in inverse]
    shifts = np.reshape(by_group, (jacobian.shape[1], len(std_err))) * std_err
    return np.asarray(shifts @ shifts.T)


def unknown_covariance(parameter_count: int) -> Covariance:
    """Return the covariance of undetermined values: all NaN.

    Args:
        parameter_count: number of parameters.
    """
    return Covariance(np.full((parameter_count, parameter_count), np.nan), 1.0)


def cramer_rao(slopes: FloatArray, sigma: FloatArray) -> FloatArray:
    """Compute the Cramer-Rao bound (p,) of standard errors, diag((J' S^-1 J)^-1)^(1/2); C. R. Rao (1945).

    The bound of a parameter without influence is given as 0.

    Args:
        slopes: derivatives J of the signal by the parameters, shape (n, p).
        sigma: standard deviation of the noise of each sample, shape (n,).
    """
    weighted = slopes / sigma[:, None]
    sizes = np.linalg.norm(weighted, axis=0)
    sizes[sizes == 0.0] = 1.0
    scaled = weighted / sizes
    return np.asarray(np.sqrt(np.diag(np.linalg.pinv(scaled.T @ scaled))) / sizes)
