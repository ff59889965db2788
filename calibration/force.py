"""Calibration of the force sensor from known weights or a reference: plateaus, fit, and weighing.

The fit finds scale, zero, curvature and hysteresis from plateaus.

    force = scale (r - zero) + curvature (r - zero)^2,   r = reading + hysteresis / 2 * direction

An effect that is not significant (t test at 1 %) is removed from the equation; its estimate is reported.
Without curvature, scale is the mean slope over the range; with curvature it is the slope at the zero. The fit
minimizes squared errors of the force.

Each plateau is one observation, so the uncertainty includes differences between plateaus (creep, friction, a
weight's error). No sensor is exactly linear or parabolic, and the remaining shape may not be visible in the
scatter. Therefore the change of zero and scale by one more power of the reading is added as a standard
uncertainty. VIM 2.39, 4.16, 4.21; VDI/VDE 2638; JCGM 100:2008, 4.3 and F.2.

A drift of the reading, linear in time, is fitted if it is significant. The zero is then that of the middle of
the record, and its uncertainty covers the zeros of start and end. Saturated plateaus are left out.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit
from scipy.stats import linregress

from palpate.calibration.standstill import MAX_REL_STD, UncertainValue, few_sample_factor
from palpate.estimation.data.table import Table, read_table
from palpate.estimation.signals.blocks import blocks
from palpate.estimation.statistics.noise import MAD_TO_SIGMA
from palpate.robot_io.errors import InputError
from palpate.robot_io.session import Session
from palpate.robot_io.types import BoolArray, FloatArray, IntArray, Status

_SETTLING_SHARE = 0.25  # share of a plateau that is left out if there is no information about settling
_MIN_SAMPLES = 3  # fewest samples of a plateau
_OUTLIER = 8.0  # robust standard deviations from which a sample is a converter's glitch
STANDARD_GRAVITY_M_S2 = 9.80665
_ROLES = ("reading", "reference", "settled")
_READING_UNITS = {"counts": "count", "count": "count", "n": "N", "v": "V", "mv": "mV", "mv/v": "mV/V"}
_TO_N = {"n": 1.0, "kn": 1e3, "mn": 1e-3, "lbf": 4.4482216152605}


@dataclass(frozen=True)
class Plateaus:
    """Mean readings under known forces, in the order of time; arrays of shape (m,)."""

    reference_n: FloatArray  # known force [N]
    reading: FloatArray  # mean reading of the sensor, in its unit
    std_err: FloatArray  # standard error of each mean for white noise, in the sensor's unit
    direction: FloatArray  # 1 if the force was reached from below, -1 from above, 0 at the start
    when: FloatArray  # mean time, as a share of the record's duration, from -0.5 to 0.5
    change: FloatArray  # mean reading of the second half minus that of the first half, in the sensor's unit
    distinct: IntArray  # number of different readings
    glitches: int = 0  # number of samples left out as outliers

    def __len__(self) -> int:
        return len(self.reading)

    def select(self, chosen: BoolArray) -> "Plateaus":
        """Return the chosen plateaus; the mask has the shape (m,)."""
        arrays = {name: array[chosen] for name, array in vars(self).items() if name != "glitches"}
        return Plateaus(**arrays, glitches=self.glitches)


def find_plateaus(
    reading: FloatArray,
    reference_n: FloatArray,
    settled: BoolArray | None = None,
    time_s: FloatArray | None = None,
) -> Plateaus:
    """Split a record at changes of the reference, and average the reading of each piece.

    Args:
        reading: reading of the sensor, shape (n,).
        reference_n: known force, shape (n,) [N].
        settled: mask of samples to use, shape (n,); None to leave out the first quarter of each plateau.
        time_s: time of each sample, shape (n,) [s]; None for samples at equal intervals.

    Raises:
        InputError: fewer than three samples remain of every plateau.
    """
    steps = np.concatenate([[0], np.cumsum(np.diff(reference_n) != 0.0)])
    samples = [np.arange(len(reading))[rows] for rows in blocks(steps)]
    references_n = [float(reference_n[rows[0]]) for rows in samples]
    if settled is None:
        samples = [rows[int(_SETTLING_SHARE * len(rows)) :] for rows in samples]
    else:
        samples = [rows[settled[rows]] for rows in samples]
    time_s = np.arange(len(reading), dtype=np.float64) if time_s is None else time_s
    pieces, times_s = [reading[rows] for rows in samples], [time_s[rows] for rows in samples]
    plateaus = plateaus_of(references_n, pieces, times_s, (float(time_s[0]), float(time_s[-1])))
    if not len(plateaus):
        raise InputError(
            f"no plateau has {_MIN_SAMPLES} settled samples; keep the reference constant for longer"
        )
    return plateaus


def plateaus_of(
    references_n: Sequence[float],
    pieces: Sequence[FloatArray],
    times_s: Sequence[FloatArray] | None = None,
    record_s: tuple[float, float] | None = None,
) -> Plateaus:
    """Average the settled readings under each force, without outliers; leave out too short pieces.

    Args:
        references_n: known forces, in the order of time [N].
        pieces: readings under each of them.
        times_s: time of each reading [s]; None for readings at equal intervals.
        record_s: start and end of the record [s]; None for the first and the last reading.
    """
    if times_s is None:
        ends = np.cumsum([len(piece) for piece in pieces])
        times_s = [np.arange(end - len(piece), end) for end, piece in zip(ends, pieces, strict=True)]
    long_enough = [len(piece) >= _MIN_SAMPLES for piece in pieces]
    pieces, times_s = list(compress(pieces, long_enough)), list(compress(times_s, long_enough))
    kept = [piece[~_is_glitch(piece)] for piece in pieces]
    reference = np.array(list(compress(references_n, long_enough)), dtype=np.float64)
    times = np.array([piece.mean() for piece in times_s])
    start_s, end_s = record_s or ((float(times_s[0][0]), float(times_s[-1][-1])) if times_s else (0.0, 0.0))
    duration_s = end_s - start_s
    return Plateaus(
        reference,
        np.array([piece.mean() for piece in kept]),
        np.array([piece.std(ddof=1) / np.sqrt(len(piece)) for piece in kept]),
        np.concatenate([[0.0], np.sign(np.diff(reference))]),
        (times - start_s) / duration_s - 0.5 if duration_s > 0.0 else np.zeros(len(times)),
        np.array([np.subtract(*(half.mean() for half in np.array_split(piece, 2)[::-1])) for piece in kept]),
        np.array([len(np.unique(piece)) for piece in kept], dtype=np.intp),
        sum(map(len, pieces)) - sum(map(len, kept)),
    )


def _is_glitch(piece: FloatArray) -> BoolArray:
    """Return samples far from the median, if most agree; the resolution counts as noise."""
    distance = np.abs(piece - np.median(piece))
    steps = np.diff(np.unique(piece))
    noise = max(MAD_TO_SIGMA * float(np.median(distance)), float(steps.min()) if len(steps) else 0.0)
    return np.asarray(distance > _OUTLIER * noise if noise else np.zeros(len(piece), dtype=np.bool_))


def read_reference_file(
    path: str | os.PathLike[str],
    columns: Mapping[str, str],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2,
    reading_unit: str | None = None,
) -> tuple[Plateaus, str]:
    """Read plateaus from a data file: CSV (also .gz), Parquet or NPZ, one row per sample in time order.

    The end of a column's name is its unit, such as `load_counts`, `weight_kg`, `force_N`. If there is a
    column `settled`, only rows in which it is nonzero are used.

    Args:
        path: path of the file.
        columns: names of the columns `reading`, `reference` and `settled`; a missing entry stands for the
            column whose name begins so, and a missing reference else for the only other column in a unit of
            force or mass.
        gravity_m_s2: gravitational acceleration, which converts masses to forces [m/s^2].
        reading_unit: unit of the readings; None for the end of the column's name.

    Returns:
        The plateaus, and the unit of the readings.

    Raises:
        InputError: the file cannot be read, a column is missing or has no known unit, or no plateau is
            steady.
    """
    unknown = [role for role in columns if role not in _ROLES]
    if unknown:
        raise InputError(f"--column {unknown[0]}: no such role. Valid: {', '.join(_ROLES)}")
    table = read_table(path)
    reading = _column(table, "reading", columns)
    factors = _TO_N | {"kg": gravity_m_s2, "g": 1e-3 * gravity_m_s2, "lb": 0.45359237 * gravity_m_s2}
    others = (name for name in _unnamed(table) if name != reading)
    by_unit = [name for name in others if "_" in name and name.rpartition("_")[2].lower() in factors]
    reference = _column(table, "reference", columns, by_unit)
    settled = columns.get("settled") or next((name for name in table.names if name == "settled"), None)
    reference_unit = reference.rpartition("_")[2].lower()
    if reference_unit not in factors:
        raise InputError(
            f"{table.path}: column '{reference}' must end in the reference's unit, "
            f"one of {', '.join(factors)}"
        )
    plateaus = find_plateaus(
        table.numbers(reading),
        table.numbers(reference) * factors[reference_unit],
        None if settled is None else np.asarray(table.numbers(settled) != 0.0),
        _times(table),
    )
    unit = reading_unit or _READING_UNITS.get(reading.rpartition("_")[2].lower())
    if unit is None:
        raise InputError(
            f"{table.path}: column '{reading}' does not end in the unit of the reading; give the unit with "
            "--reading-unit"
        )
    return plateaus, unit


def _column(table: Table, role: str, columns: Mapping[str, str], by_unit: Sequence[str] = ()) -> str:
    """Return the column of a role: the given one, or the only one named after it, or else with its unit."""
    if role in columns:
        return columns[role]
    named = [name for name in table.names if name == role or name.startswith(f"{role}_")]
    candidates = named or by_unit
    if len(candidates) != 1:
        example = (*candidates, *_unnamed(table), *table.names)[0]
        raise InputError(
            f"{table.path}: which column is the {role}? Use --column {role}={example}. "
            f"Available: {table.listed_names}"
        )
    return candidates[0]


def _times(table: Table) -> FloatArray | None:
    """Return the only column of times, if it holds increasing numbers."""
    names = [name for name in table.names if name.startswith("time")]
    try:
        times = table.numbers(names[0]) if len(names) == 1 else None
    except InputError:
        return None  # times of day or dates; samples at equal intervals are assumed
    return times if times is not None and np.all(np.diff(times) >= 0.0) else None


def _unnamed(table: Table) -> list[str]:
    """Return the columns that are named neither after a role nor after the time."""
    return [name for name in table.names if not name.startswith((*_ROLES, "time"))]


EVENT = "reference_force"


def read_weighing(session: Session) -> Plateaus:
    """Read the plateaus of a weighing's session, in the order in which the forces were applied.

    Args:
        session: a session of `palpate calibrate force`; only readings with status OK are used.

    Raises:
        InputError: the session has no reference forces.
    """
    forces_n = {e.data["run"]: float(e.data["force_n"]) for e in session.events if e.kind == EVENT and e.data}
    if not forces_n:
        raise InputError(
            f"{session.path}: holds no reference forces; give a session of palpate calibrate force"
        )
    ticks = session.samples("tick")
    fresh = ticks.select(ticks["force_status"] == Status.OK)
    pieces, times_s = (
        [fresh[name][fresh["run"] == run] for run in forces_n] for name in ("force_n", "time_s")
    )
    return plateaus_of(list(forces_n.values()), pieces, times_s)


_SIGNIFICANT = 0.01
_MIN_SPARE = 2  # plateaus beyond the number of parameters
_MIN_LEVELS = 3
_MIN_CURVE_LEVELS = 4  # three points lie on a parabola for any shape of the characteristic
_CURVATURE, _CUBIC, _HYSTERESIS, _DRIFT = 2, 3, 4, 5  # places among the parameters
_UNIFORM = np.sqrt(12.0)  # ratio of a range to the standard deviation of a uniform distribution over it
_NEGLIGIBLE = 1e-6  # drift that is rounding, as a share of the range of readings
_SATURATED_SLOPE = 0.1  # largest slope of a saturated reading over the force, as a share of the median slope
_NOISY = 3  # least number of different readings of a plateau whose noise exceeds the resolution
_MAX_REL_RESIDUAL = 0.05  # largest residual (rms) of a plausible fit, as a share of the range
_SUSPECT = 5.0  # least ratio of an outlying plateau's residual to the scatter of the others


@dataclass(frozen=True)
class ForceFit:
    """Characteristic of a force sensor; u is the unit of its readings."""

    zero: UncertainValue[float]  # reading without force [u]
    scale: UncertainValue[float]  # [N/u]
    curvature: UncertainValue[float] | None  # [N/u^2]; None if it is not significant
    # excess of the reading on the way down over that on the way up, at the same force [N].
    hysteresis_n: UncertainValue[float]
    # largest distance of the characteristic from its chord over the range, as a share of it.
    nonlinearity: UncertainValue[float]
    plateaus: Plateaus  # fitted plateaus
    residual_n: FloatArray  # reference minus calibrated reading, shape (m,) [N]
    range_n: tuple[float, float]  # lowest and highest reference [N]
    suspect: int | None  # index from 0 of an outlying plateau, or None
    is_used: BoolArray  # mask of the given plateaus: those that are not saturated
    drift_n: UncertainValue[float] | None  # change during the record [N]; None if it is not significant
    # change within the plateaus, as an excess of the way down over the way up [N]; 0 if it is not significant
    unsettled_n: float

    @property
    def rms_n(self) -> float:
        """Root mean square of the residuals [N]."""
        return float(np.sqrt(np.mean(self.residual_n**2)))


def fit_force(plateaus: Plateaus, reference_rel_std: float = 0.0) -> ForceFit:
    """Fit a force sensor's characteristic to plateaus, which go up and down, so that hysteresis shows.

    Args:
        plateaus: mean readings under known forces.
        reference_rel_std: standard uncertainty of all references together, as a share of them [-].

    Raises:
        InputError: too few plateaus or forces, or the sensor answers with the wrong sign or not at all.
    """
    check_references(plateaus.reference_n)
    if np.ptp(plateaus.reading) == 0.0:
        raise InputError("the reading is the same under every force, so the sensor does not respond")
    is_used = ~_is_saturated(plateaus)
    given, plateaus = plateaus, plateaus.select(is_used)
    if not is_used.all():
        try:
            check_references(plateaus.reference_n)
        except InputError as error:
            raise InputError(f"{describe_saturation(given, is_used)}. Too few remain: {error}") from error
    has_branches = bool(np.any(plateaus.direction < 0) and np.any(plateaus.direction > 0))
    used = np.array([True, True, True, False, has_branches, False])
    full_values, full_errors, dof = _solve(plateaus, used)
    drifting = used | (np.arange(len(used)) == _DRIFT)
    if len(plateaus) > drifting.sum():
        values, errors, fewer = _solve(plateaus, drifting)
        is_drifting = _is_significant(values, errors, fewer)[_DRIFT]
        if is_drifting and abs(values[_DRIFT]) > _NEGLIGIBLE * np.ptp(plateaus.reading):
            used, full_values, full_errors, dof = drifting, values, errors, fewer
    is_significant = _is_significant(full_values, full_errors, dof)
    is_significant[_CURVATURE] &= _levels(plateaus.reference_n) >= _MIN_CURVE_LEVELS
    used[[_CURVATURE, _HYSTERESIS]] &= is_significant[[_CURVATURE, _HYSTERESIS]]
    values, errors, _ = _solve(plateaus, used)
    if not values[1] > 0.0:
        raise InputError(
            f"the reading falls by {abs(1 / values[1]):.4g} per newton of reference; reverse the sign "
            "of the sensor, for example with `reversed` in the section `force` of the robot file"
        )
    zero, scale, curvature, _, half, drift = np.where(used, values, full_values).tolist()
    errors = np.hypot(errors, _shape_errors(plateaus, used, values))
    errors[0] = np.hypot(errors[0], drift / _UNIFORM)
    errors[1] = np.hypot(errors[1], scale * reference_rel_std)
    zero_err, scale_err, curvature_err, _, half_err, drift_err = np.where(used, errors, full_errors).tolist()
    span_n = float(np.ptp(plateaus.reference_n))
    bow = span_n / (4.0 * scale**2)  # of a parabola over its chord, as a share of the range
    hysteresis_err_n, unsettled_n = 2 * scale * half_err, 2 * scale * _change_towards_step(plateaus)
    unsettled_n = unsettled_n if unsettled_n > hysteresis_err_n else 0.0
    residual = _residuals(values, plateaus, applied_only=True)
    # A plateau whose residual is much larger than the others' scatter, as from a wrong weight.
    hysteresis_residual = _residuals(values, plateaus)
    worst = int(np.argmax(np.abs(hysteresis_residual)))
    scatter = float(np.sqrt(np.mean(np.delete(hysteresis_residual, worst) ** 2)))
    return ForceFit(
        zero=UncertainValue(zero, zero_err),
        scale=UncertainValue(scale, scale_err),
        curvature=UncertainValue(curvature, curvature_err) if used[_CURVATURE] else None,
        hysteresis_n=UncertainValue(-2 * scale * half, float(np.hypot(hysteresis_err_n, unsettled_n))),
        nonlinearity=UncertainValue(abs(curvature) * bow, curvature_err * bow),
        plateaus=plateaus,
        residual_n=residual,
        range_n=(float(plateaus.reference_n.min()), float(plateaus.reference_n.max())),
        suspect=worst if abs(hysteresis_residual[worst]) > _SUSPECT * scatter > 0.0 else None,
        is_used=is_used,
        drift_n=UncertainValue(scale * drift, scale * drift_err) if used[_DRIFT] else None,
        unsettled_n=unsettled_n,
    )


def implausible_force(fit: ForceFit) -> list[str]:
    """Describe, with value and remedy, why a fit should not be applied; empty if it is plausible.

    Args:
        fit: fit of the force sensor.
    """
    scale, span_n, reasons = fit.scale, float(np.ptp(fit.range_n)), []
    if fit.rms_n > _MAX_REL_RESIDUAL * span_n:
        reasons.append(
            f"the residual is {fit.rms_n:.2g} N (rms), {100 * fit.rms_n / span_n:.2g} % of the range of "
            f"{span_n:.3g} N (at most {100 * _MAX_REL_RESIDUAL:g} % is plausible); check that each reading "
            "belongs to its reference and had settled"
        )
    if scale.std_err > MAX_REL_STD * scale.value:
        reasons.append(
            f"the scale {scale.value:.3g} is known only to ± {200 * scale.std_err / scale.value:.2g} % "
            f"(95 % interval; at most {200 * MAX_REL_STD:g} % is plausible); check the references, and "
            "use more"
        )
    return reasons


def describe_saturation(plateaus: Plateaus, is_used: BoolArray) -> str:
    """Describe the saturated plateaus.

    Args:
        plateaus: all plateaus.
        is_used: mask of the others, shape (m,).
    """
    forces_n = ", ".join(f"{force_n:.4g}" for force_n in np.unique(plateaus.reference_n[~is_used]))
    readings = ", ".join(dict.fromkeys(f"{reading:.4g}" for reading in plateaus.reading[~is_used]))
    return (
        f"{np.count_nonzero(~is_used)} of {len(plateaus)} plateaus, at {forces_n} N, were left out: the "
        f"reading stays at {readings} there, so the sensor is saturated"
    )


def _is_saturated(plateaus: Plateaus) -> BoolArray:
    """Return the plateaus whose reading stays at an extreme value while the force changes.

    The reading is constant there while that of all other plateaus is noisy, or it hardly differs between the
    extreme forces.
    """
    forces_n, at = np.unique(plateaus.reference_n, return_inverse=True)
    means = np.array([plateaus.reading[at == level].mean() for level in range(len(forces_n))])
    apart_n = np.diff(forces_n)
    slopes = np.abs(np.diff(means) / apart_n)
    # Neighboring forces that are too close show no slope.
    is_steep = (slopes > _SATURATED_SLOPE * np.median(slopes)) | (apart_n < _SATURATED_SLOPE * apart_n.sum())
    first, last = np.argmax(is_steep), len(is_steep) - np.argmax(is_steep[::-1])  # steep part of the levels
    saturated = np.zeros(len(plateaus), dtype=np.bool_)
    for is_flat in ((at <= first) & (first > 0), (at >= last) & (last < len(is_steep))):
        readings = plateaus.reading[is_flat]
        if len(readings) and np.ptp(readings) < _SATURATED_SLOPE * np.ptp(plateaus.reading):
            saturated |= is_flat
    for extreme in (plateaus.reading.min(), plateaus.reading.max()):
        is_held = (plateaus.reading == extreme) & (plateaus.distinct == 1)
        if is_held.any() and np.all(plateaus.distinct[~is_held & ~saturated] >= _NOISY):
            saturated |= is_held
    return saturated


def _change_towards_step(plateaus: Plateaus) -> float:
    """Return the mean change of the reading within the plateaus, in the direction of the last step.

    It is 0 if no change in proportion to the step is significant.
    """
    step = np.diff(plateaus.reading)
    change = plateaus.change[1:]
    if len(step) <= _MIN_SPARE or not np.ptp(change) or not np.ptp(step):
        return 0.0
    line = linregress(step, change)
    if not line.slope > 0.0 or line.pvalue > _SIGNIFICANT:
        return 0.0
    return float(line.slope * np.mean(np.abs(step)))


def _is_significant(values: FloatArray, errors: FloatArray, degrees_of_freedom: int) -> BoolArray:
    return np.asarray(np.abs(values) > stdtrit(degrees_of_freedom, 1 - _SIGNIFICANT / 2) * errors)


def check_references(reference_n: Sequence[float] | FloatArray) -> None:
    """Raise `InputError` if there are too few plateaus or different forces for a fit.

    Args:
        reference_n: force of each plateau [N].
    """
    levels = _levels(reference_n)
    if levels < _MIN_LEVELS or len(reference_n) < 4 + _MIN_SPARE:
        raise InputError(
            f"{len(reference_n)} plateaus at {levels} different forces; at least {4 + _MIN_SPARE} plateaus "
            f"at {_MIN_LEVELS} forces are needed, such as 0, 1, 2, 3, 2, 1, 0 kg"
        )


def _levels(reference_n: Sequence[float] | FloatArray) -> int:
    return len(np.unique(reference_n))


def _shape_errors(plateaus: Plateaus, used: BoolArray, values: FloatArray) -> FloatArray:
    """Return the change of the values in the file by the next power of the reading, shape (6,)."""
    # The mean slope does not depend on the shape; all other values refer to one point, the zero.
    extended, has_curvature = used.copy(), bool(used[_CURVATURE])
    extended[_CUBIC if has_curvature else _CURVATURE] = True
    if len(plateaus) <= extended.sum():
        return np.zeros(len(used))
    change = np.abs(_solve(plateaus, extended)[0] - values)
    return np.where([True, has_curvature, has_curvature, False, False, False], change, 0.0)


def _solve(plateaus: Plateaus, used: BoolArray) -> tuple[FloatArray, FloatArray, int]:
    """Return values and standard errors of zero, scale, curvature, cubic, half hysteresis, drift."""
    slope, intercept = (float(value) for value in np.polyfit(plateaus.reading, plateaus.reference_n, 1))
    zero = -intercept / slope if slope else 0.0
    width = np.ptp(plateaus.reading)
    typical = np.array([width, slope, slope / width, slope / width**2, width, width])
    values = np.zeros(len(used))

    def unscaled(free: FloatArray) -> FloatArray:
        values[used] = free * typical[used]
        return values

    start = (np.array([zero, slope, 0.0, 0.0, 0.0, 0.0]) / typical)[used]
    fit = least_squares(lambda free: _residuals(unscaled(free), plateaus), start, x_scale="jac", xtol=1e-14)
    dof = len(plateaus) - int(used.sum())
    reading_error_n = slope * plateaus.std_err
    variance = max(2.0 * fit.cost / dof, float(np.mean(reading_error_n**2)))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * variance
    errors = np.zeros(len(used))
    errors[used] = np.sqrt(np.diag(covariance)) * np.abs(typical[used]) * few_sample_factor(dof)
    return unscaled(fit.x).copy(), errors, dof


def _residuals(
    values: Sequence[float] | FloatArray, plateaus: Plateaus, *, applied_only: bool = False
) -> FloatArray:
    """Return the residuals in N, without correcting hysteresis and drift if `applied_only`."""
    zero, scale, curvature, cubic, half, drift = values
    excess = plateaus.reading - zero
    if not applied_only:
        excess = excess - half * plateaus.direction - drift * plateaus.when
    return np.asarray(plateaus.reference_n - excess * (scale + excess * (curvature + excess * cubic)))
