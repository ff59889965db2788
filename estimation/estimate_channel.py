"""From a channel to its parameters: the steps that every estimator shares."""

from dataclasses import replace

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data.contact import contact_rows
from palpate.estimation.data.units import SMALLEST
from palpate.estimation.effects.contact_geometry import ContactOffset
from palpate.estimation.estimate import Determined, Estimate, Identifiability
from palpate.estimation.estimator import Estimator
from palpate.estimation.fit.fit_problem import Solution
from palpate.estimation.fit.samples import SampleFit, fit_samples
from palpate.estimation.model import Model
from palpate.estimation.physical import UNPHYSICAL, unphysical
from palpate.estimation.regression import Regression
from palpate.estimation.rounding import mark_coarse, rounding_errors, steps_spanned
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.uncertainty import Covariance, assemble, common_error_covariance
from palpate.estimation.surface import FEWEST_STEPS
from palpate.robot_io.errors import InputError
from palpate.robot_io.types import BoolArray, FloatArray

_OFFSET = f"{ContactOffset.name}.offset"
_NOWHERE_M = 1e-9  # a difference that is none


def fitting_rows(data: ChannelData) -> BoolArray:
    """Samples that tell about the model, shape (n,).

    Of a contact: those surely in contact where the surface was found from the data, else those below the
    surface; of a joint: all.
    """
    if data.kind is not ChannelKind.CONTACT:
        return np.ones(len(data), dtype=np.bool_)
    if data.surface is not None and (data.phase >= 0).all():
        return contact_rows(data.effort, data.run, data.phase)
    return data.engaged


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

    `fit_samples` finds inner parameters (where the surface lies, an exponent) with the estimator's own loss;
    then the estimator finds the gains, and their errors take in what the inner parameters leave open.

    Args:
        data: whole runs of a channel.
        model: what to estimate.
        estimator: how.
        rng: see `Estimator.fit`.
        rows: samples to use, shape (n,); None for `fitting_rows`.
        searched: of other estimators of the same samples, see `fit_samples`.

    Returns:
        Gains, then inner parameters, called "effect.parameter"; its arrays hold the samples used.

    Raises:
        InputError: too few samples or none with an effort, or the estimator cannot work on them.
    """
    used = fitting_rows(data) if rows is None else rows
    _check_samples(data, model, used)
    if data.surface is not None:
        data = replace(data, touching=used)
    if model.inner or data.tare is not None or data.position_step > 0.0:
        narrowed = replace(model, within=_where_touched(data, used))
        begun = fit_samples(narrowed, data, used, estimator.loss, searched)
        regression = model.regression(data, begun.parameters).select(used)
        estimate = _combine(begun, data, used, estimator.fit(regression, rng=rng))
    else:
        regression = model.regression(data, {}).select(used)
        estimate = estimator.fit(regression, rng=rng)
    parameters = tuple(
        replace(p, at_bound=True, determined=Determined.NO) if model.at_bound(p.name, p.value) else p
        for p in estimate.parameters
    )
    estimate = replace(estimate, parameters=parameters)
    return mark_coarse(_mark_unphysical(estimate, model, regression), data, used)


def _check_samples(data: ChannelData, model: Model, used: BoolArray) -> None:
    """Refuse too few samples, such without an effort, and such as small as no measurement is."""
    samples, parameters = np.count_nonzero(used), len(model.gains) + len(model.inner)
    if samples <= parameters:
        raise InputError(
            f"channel '{data.name}': {samples} samples in use cannot determine {parameters} "
            f"parameters of '{model.name}'; was the object touched?"
        )
    if not data.effort[used].any():
        raise InputError(
            f"channel '{data.name}': the effort is 0 {data.kind.effort_unit} in all {samples} "
            "samples in use; was the object touched, and the sensor connected?"
        )
    for what in ("position", "velocity", "acceleration", "effort"):
        if 0.0 < (largest := float(np.abs(getattr(data, what)[used]).max())) < SMALLEST:
            raise InputError(
                f"channel '{data.name}': its {what} is nowhere larger than {largest:.3g}, in SI units; "
                "is the unit right?"
            )


def _where_touched(data: ChannelData, used: BoolArray) -> dict[str, tuple[float, float]]:
    """Bounds of a surface that was found: what the touch allows; where it is, if the press tells no slope.

    Where forces begin may be deeper than the touch, if something pulls that the model does not know.
    """
    if data.surface is None:
        return {}
    if steps_spanned(data, used) < FEWEST_STEPS:
        return {_OFFSET: (-_NOWHERE_M, _NOWHERE_M)}
    return {_OFFSET: (data.surface.highest_m - data.surface.position_m, float("inf"))}


def _combine(searched: SampleFit, data: ChannelData, rows: BoolArray, given: Estimate) -> Estimate:
    """Gains as the estimator has them, inner parameters as the search has them, errors of both together.

    Given the inner parameters p, the gains g have the estimator's covariance; p is uncertain by C, also where
    it ended at a bound, which is no measurement. The gains follow it by G = dg/dp = -(X'X)^-1 X' df/dp.
    Together: cov(g) + G C G' for g, G C between g and p. What the encoder's steps do to all of them on
    average is taken off; as much again may be left, since the motion is known through these steps alone.
    """
    gain_count = len(given.parameters)
    values = np.array(list(searched.parameters.values()))
    values[:gain_count] = [parameter.value for parameter in given.parameters]
    columns, slopes = searched.jacobian[:, :gain_count], searched.jacobian[:, gain_count:]
    follow = -np.array([solve(columns, slope).gains for slope in slopes.T]).reshape(-1, gain_count).T
    matrix = searched.covariance.matrix.copy()
    spread = np.nan_to_num(searched.unbounded.matrix[gain_count:, gain_count:])
    matrix[:gain_count, :gain_count] = given.covariance + follow @ spread @ follow.T
    matrix[:gain_count, gain_count:] = follow @ spread
    matrix[gain_count:, :gain_count] = (follow @ spread).T
    matrix += _of_tare(searched, data, rows, given.inliers)
    rounding = _of_rounding(searched, data, rows, given)
    values -= rounding.mean(axis=1)
    matrix += rounding @ rounding.T / rounding.shape[1]
    return assemble(
        given.estimator,
        tuple(searched.parameters),
        searched.model.units(data),
        values,
        jacobian=searched.jacobian,
        effort=data.effort[rows],
        residuals=given.residuals,
        covariance=Covariance(matrix, searched.covariance.degrees_of_freedom),
        gain_count=gain_count,
        inliers=given.inliers,
        history=given.history,
        details=given.details,
    )


def _of_tare(searched: SampleFit, data: ChannelData, rows: BoolArray, inliers: BoolArray) -> FloatArray:
    """Covariance of all parameters from errors of the tare, (m, m), as least squares would follow them."""
    matrix = np.zeros_like(searched.covariance.matrix)
    free = np.isfinite(searched.covariance.std_err)
    if data.tare is not None and free.any():
        errors = data.tare.errors(data.run[rows])[inliers]
        columns = searched.jacobian[inliers][:, free]
        matrix[np.ix_(free, free)] = common_error_covariance(columns, errors)
    return matrix


def _of_rounding(searched: SampleFit, data: ChannelData, rows: BoolArray, given: Estimate) -> FloatArray:
    """Errors of all parameters at other places of the encoder's grid, (m, r); one of zeros where none is."""
    used = rows.copy()
    used[used] = given.inliers
    gains = {parameter.name: parameter.value for parameter in given.parameters}
    errors = rounding_errors(searched.model, data, used, searched.parameters | gains)
    if not errors.size or steps_spanned(data, rows) < FEWEST_STEPS:
        return np.zeros((len(errors), 1))
    errors[~np.isfinite(searched.covariance.std_err)] = 0.0
    return errors


def _mark_unphysical(estimate: Estimate, model: Model, regression: Regression) -> Estimate:
    """Say so where a gain lies outside what is physical, and is no rounding error."""
    beyond = unphysical(model.gains, estimate.parameters, regression.columns, regression.effort)
    if not beyond:
        return estimate
    note = f"{', '.join(beyond)}: outside what is physical; {UNPHYSICAL}"
    if estimate.identifiability is not Identifiability.GOOD:
        note = f"{estimate.note}; {note}"
    return replace(estimate, note=note, unphysical=tuple(beyond))
