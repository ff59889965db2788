"""Identifiability of parameters, and an estimate with its assessment."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.estimate import Determined, Estimate, Identifiability, ParameterEstimate
from palpate.estimation.model import Regression
from palpate.estimation.statistics.least_squares import condition_of_gram
from palpate.estimation.statistics.uncertainty import SINGULAR, Covariance, unknown_covariance
from palpate.robot_io.types import BoolArray, FloatArray

_UNDETERMINED_SHARE = 1.0  # uncertainty relative to the effort above which an inner parameter is undetermined
_ROUGH_ERROR = 0.25  # relative standard error above which a parameter counts as known only roughly
_MIN_ERROR = 1e-6  # least plausible standard error, scaled to effort, relative to the residuals
_ROUNDING_SHARE = 1e-9  # share of the effort below which residuals are rounding errors
_RELEVANT_SHARE = 0.01  # uncertainty relative to the effort above which it is reported
_NOISE_FREE_NOTE = (
    "most samples are identical, and the model does not fit the rest; leave out samples at rest"
)


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
    """
    column_rms = np.sqrt(np.mean(jacobian**2, axis=0))
    lengths = np.where(column_rms > 0, column_rms, 1.0) * np.sqrt(len(jacobian))
    correlation = (jacobian / lengths).T @ (jacobian / lengths)
    unknown = np.isnan(covariance.std_err)
    all_no = (Determined.NO,) * len(names)
    if not column_rms.all():
        unexcited = _join_names(names, column_rms == 0)
        return Assessment(Identifiability.NONE, f"the motion does not excite {unexcited} at all", all_no)
    at_bound = unknown.any() and not unknown.all()
    if unknown.all() or (not at_bound and condition_of_gram(correlation) > SINGULAR):
        note = f"{', '.join(names)} cannot be told apart, because the motion excites them in a fixed ratio"
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
        return f"{names[index]} is correlated with {partner}; vary speed and position more independently"
    return "excite it more (faster, farther, longer) or measure with less noise"


def assemble(
    estimator: str,
    regression: Regression,
    values: FloatArray,
    covariance: Covariance,
    *,
    residuals: FloatArray | None = None,
    gain_count: int | None = None,
    inliers: BoolArray | None = None,
    details: dict[str, float] | None = None,
) -> Estimate:
    """Assemble an `Estimate` and assess its parameters.

    Args:
        estimator: registered name of the estimator.
        regression: the problem; its columns are the derivatives of the prediction by the m parameters.
        values: estimates, shape (m,).
        covariance: covariance of the values.
        residuals: effort minus prediction, shape (n,); None to compute them by the linear problem.
        gain_count: number of gains, which are the first parameters; None if all are gains.
        inliers: mask of the samples used, shape (n,); None for all.
        details: see `Estimate`.
    """
    names, jacobian, effort = regression.names, regression.columns, regression.effort
    residuals = effort - jacobian @ values if residuals is None else residuals
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
    numbers = values.tolist(), covariance.std_err.tolist(), covariance.intervals(values).tolist()
    parameters = tuple(
        ParameterEstimate(name, unit, value, error, (low, high), determined=determined)
        for name, unit, value, error, (low, high), determined in zip(
            names, regression.units, *numbers, assessment.determined, strict=True
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
        details or {},
    )
