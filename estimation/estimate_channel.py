"""Estimate the parameters of a channel: the steps shared by all estimators."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import scipy

from palpate.estimation.assessment import assemble
from palpate.estimation.channel import MIN_STEPS, ChannelData, ChannelKind
from palpate.estimation.data.contact import contact_rows
from palpate.estimation.data.derivatives import differentiate
from palpate.estimation.data.units import SMALLEST
from palpate.estimation.effect import Parameter, Parameters
from palpate.estimation.effects.contact_geometry import ContactOffset
from palpate.estimation.estimate import Determined, Estimate, Identifiability, ParameterEstimate, with_unit
from palpate.estimation.estimator import Estimator
from palpate.estimation.fit.fit_problem import Solution
from palpate.estimation.fit.samples import SampleFit, fit_samples, slopes_of
from palpate.estimation.model import Model, Regression
from palpate.estimation.signals.blocks import blocks, number_pieces
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.uncertainty import Covariance, common_error_covariance
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_OFFSET = f"{ContactOffset.name}.offset"
_ZERO_M = 1e-9  # distances below this are zero
_MAX_STEPS = 1000.0  # encoder steps from which rounding changes less than 0.1 %
_DRAW_COUNT = 16
_SEED = 1
UNPHYSICAL = "the model lacks an effect, or the sign of effort or motion is reversed"  # possible causes
_ROUNDING = 1e-9  # share of the effort below which a gain is a rounding error


def fitting_rows(data: ChannelData) -> BoolArray:
    """Return the mask of samples to which a model is fitted, shape (n,).

    For a contact with an estimated surface these are the samples that are certainly in contact. For any other
    contact they are the samples below the surface. For a joint they are all samples.

    Args:
        data: the channel.
    """
    if data.kind is not ChannelKind.CONTACT:
        return np.ones(len(data), dtype=np.bool_)
    if data.surface is not None and (data.phase >= 0).all():
        return contact_rows(data.effort, data.run, data.phase)
    return data.engaged


def lifted_rows(data: ChannelData, model: Model, rows: BoolArray) -> IntArray:
    """Return the samples (k,) in which a fit predicts that the object has lost contact below the surface.

    A fast retraction reduces the force of a damped object to zero before the tip reaches the surface. A
    regression that expects the force to become negative there underestimates the damping. The prediction
    selects these samples, since a selection by the measured force would depend on its noise.

    Args:
        data: whole runs of a channel.
        model: model to estimate.
        rows: samples to which the model is fitted, a mask of shape (n,).
    """
    if data.kind is not ChannelKind.CONTACT or data.surface is not None or np.count_nonzero(rows) <= 1:
        return np.empty(0, dtype=np.int64)
    fitted = fit_samples(model, data, rows).parameters
    return model.lift_off_rows(data, fitted, model.parts(data, fitted))


def estimate_channel(
    data: ChannelData,
    model: Model,
    estimator: Estimator,
    *,
    rng: np.random.Generator,
    rows: BoolArray | None = None,
    searched: dict[bool, Solution] | None = None,
) -> Estimate:
    """Estimate all parameters of a model that is linear in its gains.

    `fit_samples` estimates the inner parameters (the position of the surface, an exponent) with the
    estimator's loss. The estimator then estimates the gains. The result lists the gains, then the inner
    parameters, named "effect.parameter". The errors of the gains include the uncertainty
    of the inner parameters.

    Args:
        data: whole runs of a channel.
        model: model to estimate.
        estimator: method that estimates the gains.
        rng: see `Estimator.fit`.
        rows: samples to use, shape (n,), to which the result's arrays refer; None for `fitting_rows`.
        searched: fits of other estimators to the same samples, see `fit_samples`.

    Raises:
        InputError: there are too few samples, all efforts are zero, or the estimator cannot use the samples.
    """
    used = fitting_rows(data) if rows is None else rows
    _check_samples(data, model, used)
    if data.surface is not None:
        data = replace(data, touching=used)
    if model.inner or data.tare is not None or data.position_step > 0.0:
        within = {}
        if data.surface is not None:
            # The contact gives only a lower bound of the surface's coordinate: with an unmodeled pull the
            # surface may be deeper. If the press spans too few encoder steps for a slope, it is held fixed.
            within[_OFFSET] = (data.surface.highest_m - data.surface.position_m, float("inf"))
            if steps_spanned(data, used) < MIN_STEPS:
                within[_OFFSET] = (-_ZERO_M, _ZERO_M)
        narrowed = replace(model, within=within)
        narrowed_fit = fit_samples(narrowed, data, used, estimator.loss, searched)
        regression = model.regression(data, narrowed_fit.parameters).select(used)
        estimate = _combine(narrowed_fit, data, used, estimator.fit(regression, rng=rng))
    else:
        regression = model.regression(data, {}).select(used)
        estimate = estimator.fit(regression, rng=rng)
    parameters = tuple(
        replace(p, at_bound=True, determined=Determined.NO) if model.at_bound(p.name, p.value) else p
        for p in estimate.parameters
    )
    estimate = replace(estimate, parameters=parameters)
    # Report gains that are outside their physical bounds by more than rounding errors.
    unphysical_gains = unphysical(model.gains, estimate.parameters, regression.columns, regression.effort)
    if unphysical_gains:
        note = f"{', '.join(unphysical_gains)}: outside the physical bounds; {UNPHYSICAL}"
        if estimate.identifiability is not Identifiability.GOOD:
            note = f"{estimate.note}; {note}"
        estimate = replace(estimate, note=note, unphysical=tuple(unphysical_gains))
    return _mark_coarse(estimate, data, used)


def _check_samples(data: ChannelData, model: Model, used: BoolArray) -> None:
    """Raise InputError for too few samples, zero efforts or implausibly small signals."""
    samples, parameters = np.count_nonzero(used), len(model.gains) + len(model.inner)
    if samples <= parameters:
        raise InputError(
            f"channel '{data.name}': {samples} samples in use cannot determine {parameters} "
            f"parameters of '{model.name}'; was the object touched?"
        )
    if not data.effort[used].any():
        raise InputError(
            f"channel '{data.name}': the effort is 0 {data.effort_unit} in all {samples} "
            "samples in use; was the object touched, and the sensor connected?"
        )
    for what in ("position", "velocity", "acceleration", "effort"):
        if 0.0 < (largest := float(np.abs(getattr(data, what)[used]).max())) < SMALLEST:
            raise InputError(
                f"channel '{data.name}': its {what} never exceeds {largest:.3g}, in SI units; "
                "is the unit right?"
            )


def _combine(searched: SampleFit, data: ChannelData, rows: BoolArray, estimate: Estimate) -> Estimate:
    """Combine an estimator's gains and the inner parameters from the search into one estimate.

    At fixed inner parameters p, the gains g have the estimator's covariance. Gains depend on p through
    G = dg/dp = -(X'X)^-1 X' df/dp. With C = cov(p), the covariance of g becomes cov(g) + G C G', and that
    between g and p is G C. C is computed without bounds, since a parameter at its bound was not measured.
    The mean bias due to encoder steps is subtracted from all parameters. Its spread is added to the
    covariance, since the motion is known only through these steps.
    """
    gain_count = len(estimate.parameters)
    values = np.array(list(searched.parameters.values()))
    values[:gain_count] = [parameter.value for parameter in estimate.parameters]
    columns, slopes = searched.jacobian[:, :gain_count], searched.jacobian[:, gain_count:]
    gain_slopes = -np.array([solve(columns, slope) for slope in slopes.T]).reshape(-1, gain_count).T
    matrix = searched.covariance.matrix.copy()
    inner_covariance = np.nan_to_num(searched.unbounded.matrix[gain_count:, gain_count:])
    matrix[:gain_count, :gain_count] = estimate.covariance + gain_slopes @ inner_covariance @ gain_slopes.T
    matrix[:gain_count, gain_count:] = gain_slopes @ inner_covariance
    matrix[gain_count:, :gain_count] = (gain_slopes @ inner_covariance).T
    free = np.isfinite(searched.covariance.std_err)
    if data.tare is not None and free.any():  # errors of the tare, propagated through least squares
        matrix[np.ix_(free, free)] += common_error_covariance(
            searched.jacobian[estimate.inliers][:, free],
            data.tare.index(data.run[rows])[estimate.inliers],
            data.tare.std_err,
        )
    used = rows.copy()
    used[used] = estimate.inliers
    gains = {parameter.name: parameter.value for parameter in estimate.parameters}
    rounding = rounding_errors(searched.model, data, used, searched.parameters | gains)
    if rounding.size and steps_spanned(data, rows) >= MIN_STEPS:
        rounding[~free] = 0.0
        values -= rounding.mean(axis=1)
        matrix += rounding @ rounding.T / rounding.shape[1]
    names, units = tuple(searched.parameters), searched.model.units(data)
    return assemble(
        estimate.estimator,
        Regression(searched.jacobian, data.effort[rows], names, units),
        values,
        Covariance(matrix, searched.covariance.degrees_of_freedom),
        residuals=estimate.residuals,
        gain_count=gain_count,
        inliers=estimate.inliers,
        details=estimate.details,
    )


def _mark_coarse(estimate: Estimate, data: ChannelData, rows: BoolArray) -> Estimate:
    """Remove the intervals and state the reason if the motion spans too few encoder steps for a slope."""
    if steps_spanned(data, rows) >= MIN_STEPS:
        return estimate
    unknown = float("nan")
    remedy = "press harder, or use a softer object or a finer encoder"
    note = f"{describe_steps(data, rows)}, too few to fit a slope; {remedy}"
    parameters = tuple(
        replace(p, std_err=unknown, interval=(unknown, unknown), determined=Determined.NO)
        for p in estimate.parameters
    )
    return replace(
        estimate,
        parameters=parameters,
        covariance=np.full_like(estimate.covariance, unknown),
        identifiability=Identifiability.NONE,
        note=note,
        unphysical=(),
    )


def steps_spanned(data: ChannelData, rows: BoolArray) -> float:
    """Return the number of encoder steps that the position spans; infinite without an encoder step.

    Args:
        data: the channel.
        rows: samples, a mask of shape (n,).
    """
    if data.position_step == 0.0 or not rows.any():
        return float("inf")
    return float(np.ptp(data.position[rows])) / data.position_step


def describe_steps(data: ChannelData, rows: BoolArray) -> str:
    """Describe the number of encoder steps that the position spans.

    Args:
        data: the channel.
        rows: samples, a mask of shape (n,).
    """
    steps, length = steps_spanned(data, rows), float(np.ptp(data.position[rows]))
    span = f"{length:.2g} rad" if data.kind.is_angle else f"{1e3 * length:.2g} mm"
    return f"the press spans {steps:.1f} steps of the encoder ({span})"


def rounding_errors(model: Model, data: ChannelData, rows: BoolArray, parameters: Parameters) -> FloatArray:
    """Simulate r errors (m, r) of the m parameters due to the encoder's steps; r = 0 if these are fine.

    The residuals do not show these errors. During a hold the position error is constant, and quantization
    makes a derived velocity noisy. Least squares then underestimates the stiffness (R. J. Carroll et al.,
    Measurement Error in Nonlinear Models (2006), ch. 3). The simulation quantizes the smoothed motion with
    random offsets of the grid and refits the predicted effort by one Gauss-Newton step.

    Args:
        model: fitted model.
        data: the channel.
        rows: samples used in the fit, a mask of shape (n,).
        parameters: fitted parameters, by "effect.parameter".
    """
    if steps_spanned(data, rows) > _MAX_STEPS:
        return np.zeros((len(parameters), 0))
    rng = np.random.default_rng(_SEED)
    pieces = number_pieces(data.time_s, data.run)
    smooth_position = np.empty(len(data))  # the integral of the velocity, piece by piece
    for piece in blocks(pieces):
        path = scipy.integrate.cumulative_trapezoid(data.velocity[piece], data.time_s[piece], initial=0.0)
        smooth_position[piece] = path + np.mean(data.position[piece] - path)
    smooth = replace(data, position=smooth_position)
    effort = model.predict(smooth, parameters)
    half, errors = None, []
    for shift in (rng.random(_DRAW_COUNT) + np.arange(_DRAW_COUNT)) / _DRAW_COUNT:
        shifted = smooth.position + shift * data.position_step
        position = np.round(shifted / data.position_step) * data.position_step - shift * data.position_step
        motion = differentiate(data.time_s, position, pieces, half, rounding=data.position_step**2 / 12)
        half = motion.half_windows[0]
        rounded = replace(data, position=position, velocity=motion.velocity, effort=effort)
        residual = effort - model.predict(rounded, parameters)
        errors.append(solve(slopes_of(model, rounded, parameters)[rows], residual[rows]))
    return np.column_stack(errors)


def unphysical(
    gains: Mapping[str, Parameter],
    estimates: Iterable[ParameterEstimate],
    columns: FloatArray,
    effort: FloatArray,
) -> dict[str, str]:
    """Describe each gain whose whole interval lies outside its physical bounds, by "effect.parameter".

    Args:
        gains: gains by "effect.parameter", in column order.
        estimates: estimates of the gains; other parameters among them are ignored.
        columns: effort per unit of each gain, shape (n, p).
        effort: fitted effort, shape (n,).
    """
    parts = np.sqrt(np.mean(columns**2, axis=0) / max(float(np.mean(effort**2)), 1e-300))
    shares, descriptions = dict(zip(gains, parts.tolist(), strict=True)), {}
    for estimate in estimates:
        limits = gains.get(estimate.name)
        if limits is None or abs(estimate.value) * shares[estimate.name] <= _ROUNDING:
            continue
        if (is_below := estimate.interval[1] < limits.lower) or estimate.interval[0] > limits.upper:
            side = "below" if is_below else "above"
            descriptions[estimate.name] = (
                f"{estimate.name} = {with_unit(estimate.value, estimate.unit, 4)} "
                f"is {side} the physical bound"
            )
    return descriptions
