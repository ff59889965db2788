"""Standard errors, confidence intervals and identifiability of parameters."""

from dataclasses import dataclass

import numpy as np
import scipy

from palpate.estimation.estimate import Determined, Estimate, Identifiability, ParameterEstimate
from palpate.estimation.statistics.least_squares import condition_of_gram
from palpate.estimation.statistics.noise import sum_covariance
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

CONFIDENCE = 0.95
_SINGULAR = 1e8  # condition number above which double precision leaves no correct digit
_UNDETERMINED_SHARE = 1.0  # uncertainty relative to the effort above which an inner parameter is undetermined
_ROUGH_ERROR = 0.25  # relative standard error above which a parameter counts as known only roughly
_MIN_ERROR = 1e-6  # least plausible standard error, scaled to effort, relative to the residuals
_ROUNDING_SHARE = 1e-9  # share of the effort below which residuals are rounding errors
_RELEVANT_SHARE = 0.01  # uncertainty relative to the effort above which it is reported


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
    if not lengths.all() or condition_of_gram(scaled.T @ scaled) > _SINGULAR:
        return unknown_covariance(parameter_count)
    curvature = scaled.T @ (scaled * slope[:, None])
    if np.linalg.cond(curvature) > _SINGULAR**2:  # too few samples have weight, or all are alike
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


@dataclass(frozen=True)
class Assessment:
    """Identifiability of the parameters, with advice if it is poor."""

    identifiability: Identifiability
    note: str  # assessment in words, without numbers
    determined: tuple[Determined, ...]  # whether the data determine each parameter


def assess_parameters(
    names: tuple[str, ...],
    values: FloatArray,
    jacobian: FloatArray,
    effort: FloatArray,
    covariance: Covariance,
    *,
    gain_count: int,
) -> Assessment:
    """Assess how well the data determine each parameter.

    A gain is assessed by its interval relative to its value. An inner parameter may be a position with an
    arbitrary zero. It is assessed by the effect of its uncertainty on the effort: std_err * rms(column) /
    rms(effort).

    Args:
        names: names of the m parameters.
        values: estimates, shape (m,).
        jacobian: derivatives of the prediction by the parameters, shape (n, m).
        effort: measured effort, shape (n,).
        covariance: covariance of the values.
        gain_count: number of gains, which are the first parameters.

    Returns:
        Identifiability, a sentence on it, and the state of each parameter.
    """
    column_rms = np.sqrt(np.mean(jacobian**2, axis=0))
    lengths = np.where(column_rms > 0, column_rms, 1.0) * np.sqrt(len(jacobian))
    correlation = (jacobian / lengths).T @ (jacobian / lengths)
    unknown = np.isnan(covariance.std_err)
    all_no = (Determined.NO,) * len(names)
    if not column_rms.all():
        unexcited = _join_names(names, column_rms == 0)
        return Assessment(Identifiability.NONE, f"{unexcited}: the motion does not excite it at all", all_no)
    at_bound = unknown.any() and not unknown.all()
    if unknown.all() or (not at_bound and condition_of_gram(correlation) > _SINGULAR):
        note = f"{', '.join(names)} cannot be told apart: the motion excites them in a fixed ratio"
        return Assessment(Identifiability.NONE, note, all_no)
    effort_share = np.nan_to_num(covariance.std_err * column_rms / _rms(effort))
    low, high = covariance.intervals(values).T
    relative_error = np.nan_to_num(covariance.std_err) / np.maximum(np.abs(values), np.finfo(float).tiny)
    is_relevant = effort_share > _RELEVANT_SHARE
    is_counted = np.where(np.arange(len(names)) < gain_count, effort_share > _ROUNDING_SHARE, is_relevant)
    undetermined = (relative_error > 1.0) & (effort_share > _UNDETERMINED_SHARE)
    spans_zero = undetermined | ((low < 0.0) & (high > 0.0) & is_counted)
    rough = (relative_error > _ROUGH_ERROR) & is_counted & ~spans_zero
    determined = tuple(
        Determined.NO if is_no else Determined.ROUGHLY if is_rough else Determined.YES
        for is_no, is_rough in zip(spans_zero | unknown, rough, strict=True)
    )
    if undetermined.any() and not at_bound:
        advice = _advice(names, correlation, int(np.argmax(effort_share * undetermined)))
        note = f"{_join_names(names, undetermined)} cannot be determined: {advice}"
        return Assessment(Identifiability.NONE, note, determined)
    notes = []
    if at_bound:
        notes.append(f"{_join_names(names, unknown)}: the search ended at a physical bound")
    if (important := (spans_zero | rough) & is_relevant).any():
        advice = _advice(names, correlation, int(np.argmax(effort_share * important)))
        notes.append(f"{_join_names(names, important)}: known only roughly; {advice}")
    if (minor := spans_zero & ~is_relevant).any():
        notes.append(
            f"{_join_names(names, minor)}: not significantly different from zero, with little influence on "
            "this effort"
        )
    if (minor := rough & ~is_relevant).any():
        notes.append(f"{_join_names(names, minor)}: known only roughly, with little influence on this effort")
    if notes:
        return Assessment(Identifiability.WEAK, "; ".join(notes), determined)
    return Assessment(Identifiability.GOOD, "the data determine every parameter", determined)


def _join_names(names: tuple[str, ...], is_listed: BoolArray) -> str:
    return ", ".join(name for name, listed in zip(names, is_listed, strict=True) if listed)


def _rms(effort: FloatArray) -> float:
    return max(float(np.sqrt(np.mean(effort**2))), np.finfo(float).tiny)


def _advice(names: tuple[str, ...], correlation: FloatArray, index: int) -> str:
    """Return advice on how to determine a parameter."""
    strength = np.abs(correlation[index])
    strength[index] = 0.0
    if len(names) > 1 and strength.max() > 0.9:
        partner = names[int(np.argmax(strength))]
        return f"{names[index]} changes together with {partner}; vary speed and depth more independently"
    return "excite it more (faster, deeper, longer) or measure with less noise"


_NOISE_FREE_NOTE = "most samples are exactly alike, and the others do not fit: leave out samples at rest"


def assemble(
    estimator: str,
    names: tuple[str, ...],
    units: tuple[str, ...],
    values: FloatArray,
    *,
    jacobian: FloatArray,
    effort: FloatArray,
    residuals: FloatArray,
    covariance: Covariance,
    gain_count: int | None = None,
    inliers: BoolArray | None = None,
    history: FloatArray | None = None,
    details: dict[str, float] | None = None,
) -> Estimate:
    """Assemble an `Estimate` and assess its parameters.

    Args:
        estimator: registered name of the estimator.
        names: names of the m parameters.
        units: units of the parameters.
        values: estimates, shape (m,).
        jacobian: derivatives of the prediction by the parameters, shape (n, m).
        effort: measured effort, shape (n,).
        residuals: effort minus prediction, shape (n,).
        covariance: covariance of the values.
        gain_count: number of gains, which are the first parameters; None if all are gains.
        inliers: mask of the samples used, shape (n,); None for all.
        history: see `Estimate`.
        details: see `Estimate`.
    """
    used = np.ones(len(effort), dtype=np.bool_) if inliers is None else inliers
    gains = len(names) if gain_count is None else gain_count
    assessment = assess_parameters(names, values, jacobian[used], effort[used], covariance, gain_count=gains)
    # Check whether standard errors are implausibly small because most samples are free of noise.
    residual_rms = _rms(residuals)
    scaled_error = covariance.std_err * np.linalg.norm(jacobian, axis=0)
    if residual_rms > _ROUNDING_SHARE * _rms(effort) and (scaled_error < _MIN_ERROR * residual_rms).any():
        covariance = unknown_covariance(len(values))
        note = assessment.note if assessment.identifiability is Identifiability.NONE else _NOISE_FREE_NOTE
        assessment = Assessment(Identifiability.NONE, note, (Determined.NO,) * len(names))
    lengths = np.linalg.norm(jacobian[used], axis=0)
    scaled = jacobian[used] / np.where(lengths > 0, lengths, 1.0)
    parameters = tuple(
        ParameterEstimate(
            name, unit, float(value), float(error), (float(low), float(high)), determined=determined
        )
        for name, unit, value, error, (low, high), determined in zip(
            names,
            units,
            values,
            covariance.std_err,
            covariance.intervals(values),
            assessment.determined,
            strict=True,
        )
    )
    return Estimate(
        estimator,
        parameters,
        used,
        residuals,
        condition_of_gram(scaled.T @ scaled),
        assessment.identifiability,
        assessment.note,
        covariance.matrix,
        history,
        details or {},
    )


def cramer_rao(slopes: FloatArray, sigma: FloatArray) -> FloatArray:
    """Compute the Cramer-Rao bound diag((J' S^-1 J)^-1)^(1/2) of standard errors; C. R. Rao (1945).

    Args:
        slopes: derivatives J of the signal by the parameters, shape (n, p).
        sigma: standard deviation of the noise of each sample, shape (n,).

    Returns:
        Smallest possible standard errors, shape (p,); 0 for a parameter without influence.
    """
    weighted = slopes / sigma[:, None]
    sizes = np.linalg.norm(weighted, axis=0)
    sizes[sizes == 0.0] = 1.0
    scaled = weighted / sizes
    return np.asarray(np.sqrt(np.diag(np.linalg.pinv(scaled.T @ scaled))) / sizes)
