"""Scale, zero, curvature and hysteresis of a force sensor from plateaus.

    force = scale (r - zero) + curvature (r - zero)^2,   r = reading + hysteresis / 2 * direction

An effect that the data do not show (a t test at 1 %) is removed from the equation; its estimate is reported.
Without curvature, scale is the mean slope over the range, with it the slope at the zero. Least squares in the
force.

Each plateau is one observation, so that differences between plateaus (creep, friction, a weight's error) are
in the uncertainty. No sensor is exactly linear or parabolic, and the remaining shape need not show in the
scatter: the change of zero and scale by one more power of the reading counts as one more standard
uncertainty. VIM 2.39, 4.16, 4.21; VDI/VDE 2638; JCGM 100:2008, 4.3 and F.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t

from calibration.force.plateaus import Plateaus
from calibration.statistics import UncertainValue, few_sample_factor
from robot_io.errors import InputError
from robot_io.types import BoolArray, FloatArray

_SIGNIFICANT = 0.01
_SPARE = 2  # plateaus beyond the number of parameters
_FEWEST_LEVELS = 3
_FEWEST_LEVELS_OF_A_CURVE = 4  # three points lie on a parabola, whatever the sensor's shape is
_CURVATURE, _CUBIC, _HYSTERESIS = 2, 3, 4  # places among the parameters
_SUSPECT = 5.0  # times the other plateaus' scatter


@dataclass(frozen=True)
class ForceFit:
    """Characteristic of a force sensor; u is the unit of its readings."""

    zero: UncertainValue[float]  # reading without force [u]
    scale: UncertainValue[float]  # [N/u]
    curvature: UncertainValue[float] | None  # [N/u^2]; None where none is shown
    # what the sensor shows more on the way down than on the way up, at the same force [N].
    hysteresis_n: UncertainValue[float]
    # largest distance of the characteristic from its chord over the range, as a share of it.
    nonlinearity: UncertainValue[float]
    plateaus: Plateaus  # what was fitted
    residual_n: FloatArray  # reference less what the calibrated sensor says, shape (m,) [N]
    range_n: tuple[float, float]  # lowest and highest reference [N]
    suspect: int | None  # index from 0 of an outlying plateau, or None

    @property
    def rms_n(self) -> float:
        """Root mean square of the residuals [N]."""
        return float(np.sqrt(np.mean(self.residual_n**2)))


def fit_force(plateaus: Plateaus, reference_rel_std: float = 0.0) -> ForceFit:
    """Fit a force sensor's characteristic to plateaus, which go up and down, so that hysteresis shows.

    Args:
        plateaus: mean readings under known forces.
        reference_rel_std: standard uncertainty of all references together, as a share of them [-].

    Returns:
        The characteristic with its uncertainties.

    Raises:
        InputError: too few plateaus or forces, or the sensor answers with the wrong sign or not at all.
    """
    check_references(plateaus.reference_n)
    if np.ptp(plateaus.reading) == 0.0:
        raise InputError("the reading is the same under every force: the sensor does not answer")
    has_branches = bool(np.any(plateaus.direction < 0) and np.any(plateaus.direction > 0))
    used = np.array([True, True, True, False, has_branches])
    full_values, full_errors, freedom = _solve(plateaus, used)
    shown = np.abs(full_values) > t.ppf(1 - _SIGNIFICANT / 2, freedom) * full_errors
    shown[_CURVATURE] &= _levels(plateaus.reference_n) >= _FEWEST_LEVELS_OF_A_CURVE
    used &= np.array([True, True, shown[_CURVATURE], False, shown[_HYSTERESIS]])
    values, errors, _ = _solve(plateaus, used)
    if not values[1] > 0.0:
        raise InputError(
            f"the reading falls by {abs(1 / values[1]):.4g} per N that the reference rises: turn the sign"
        )
    zero, scale, curvature, _, half = np.where(used, values, full_values).tolist()
    errors = np.hypot(errors, _shape_errors(plateaus, used, values))
    errors[1] = np.hypot(errors[1], scale * reference_rel_std)
    zero_err, scale_err, curvature_err, _, half_err = np.where(used, errors, full_errors).tolist()
    span_n = float(np.ptp(plateaus.reference_n))
    bow = span_n / (4.0 * scale**2)  # of a parabola over its chord, as a share of the range
    residual = _residuals(values, plateaus, hysteresis=False)
    return ForceFit(
        zero=UncertainValue(zero, zero_err),
        scale=UncertainValue(scale, scale_err),
        curvature=UncertainValue(curvature, curvature_err) if used[_CURVATURE] else None,
        hysteresis_n=UncertainValue(-2 * scale * half, 2 * scale * half_err),
        nonlinearity=UncertainValue(abs(curvature) * bow, curvature_err * bow),
        plateaus=plateaus,
        residual_n=residual,
        range_n=(float(plateaus.reference_n.min()), float(plateaus.reference_n.max())),
        suspect=_suspect(_residuals(values, plateaus)),
    )


def check_references(reference_n: Sequence[float] | FloatArray) -> None:
    """Check that the planned forces suffice for a fit.

    Args:
        reference_n: force of each plateau [N].

    Raises:
        InputError: there are too few plateaus or different forces.
    """
    levels = _levels(reference_n)
    if levels < _FEWEST_LEVELS or len(reference_n) < 4 + _SPARE:
        raise InputError(
            f"{len(reference_n)} plateaus at {levels} different forces: at least {4 + _SPARE} at "
            f"{_FEWEST_LEVELS} are needed, such as 0, 1, 2, 3, 2, 1, 0 kg"
        )


def _levels(reference_n: Sequence[float] | FloatArray) -> int:
    return len(np.unique(reference_n))


def _shape_errors(plateaus: Plateaus, used: BoolArray, values: FloatArray) -> FloatArray:
    """What the next power of the reading would change of the values in the file, shape (5,).

    The mean slope is the mean slope whatever the shape is; everything else is said of one point, the zero.
    """
    richer, curved = used.copy(), bool(used[_CURVATURE])
    richer[_CUBIC if curved else _CURVATURE] = True
    if len(plateaus) <= richer.sum():
        return np.zeros(len(used))
    change = np.abs(_solve(plateaus, richer)[0] - values)
    return np.where([True, curved, curved, False, False], change, 0.0)


def _solve(plateaus: Plateaus, used: BoolArray) -> tuple[FloatArray, FloatArray, int]:
    """Values and standard errors of zero, scale, curvature, cubic, half hysteresis; 0 where not used."""
    slope, intercept = (float(value) for value in np.polyfit(plateaus.reading, plateaus.reference_n, 1))
    zero = -intercept / slope if slope else 0.0
    width = np.ptp(plateaus.reading)
    typical = np.array([width, slope, slope / width, slope / width**2, width])
    values = np.zeros(len(used))

    def unpacked(free: FloatArray) -> FloatArray:
        values[used] = free * typical[used]
        return values

    start = (np.array([zero, slope, 0.0, 0.0, 0.0]) / typical)[used]
    fit = least_squares(lambda free: _residuals(unpacked(free), plateaus), start, x_scale="jac", xtol=1e-14)
    freedom = len(plateaus) - int(used.sum())
    own_n = slope * plateaus.std_err
    variance = max(2.0 * fit.cost / freedom, float(np.mean(own_n**2)))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * variance
    errors = np.zeros(len(used))
    errors[used] = np.sqrt(np.diag(covariance)) * np.abs(typical[used]) * few_sample_factor(freedom)
    return unpacked(fit.x).copy(), errors, freedom


def _residuals(
    values: Sequence[float] | FloatArray, plateaus: Plateaus, *, hysteresis: bool = True
) -> FloatArray:
    zero, scale, curvature, cubic, half = values
    above = plateaus.reading - zero - (half * plateaus.direction if hysteresis else 0.0)
    return np.asarray(plateaus.reference_n - above * (scale + above * (curvature + above * cubic)))


def _suspect(residual: FloatArray) -> int | None:
    """Find a plateau whose residual is much larger than the others' scatter, as from a wrong weight."""
    worst = int(np.argmax(np.abs(residual)))
    rest = np.delete(residual, worst)
    scatter = float(np.sqrt(np.mean(rest**2)))
    return worst if abs(residual[worst]) > _SUSPECT * scatter > 0.0 else None
