"""Holds a calibration against the limits of the arm: it stands between the sensors and the guard.

A wrong one must not hide from the guard what the guard is there for, nor tell a drive more than it may give.
"""

from robot_io.calibration.file import Calibration, ForceCalibration, TorqueCalibration
from robot_io.limits import Limits

_ZERO_SHARE = 0.5  # of the force limit, that a sensor may show with nothing on it
_SLOPE_SHARE = 0.5  # of the scale, that must be left wherever the guard has to see the force grow
_OFFSET_SHARE = 0.2  # of a torque limit


def implausible(calibration: Calibration, limits: Limits) -> str | None:
    """Why a calibration cannot be this arm's, in words, or None."""
    if isinstance(calibration, ForceCalibration):
        return _force(calibration, limits.force_n)
    if isinstance(calibration, TorqueCalibration):
        return _torque(calibration, limits)
    return None


def _force(calibration: ForceCalibration, limit_n: float) -> str | None:
    values = calibration.values
    scale = values.scale.value
    zero_n, most_n = abs(values.zero.value) * scale, _ZERO_SHARE * limit_n
    if zero_n > most_n:
        return f"has a zero of {zero_n:.3g} N; under a force limit of {limit_n:g} N at most {most_n:.3g} N"
    # At this reading even the flattest curve that is allowed is beyond the limit; if it bends back, then only
    # beyond three times as much.
    furthest = 2.0 * limit_n / (scale * (1.0 + _SLOPE_SHARE))
    curvature = values.curvature.value if values.curvature else 0.0
    most = (1.0 - _SLOPE_SHARE) * scale / (2.0 * furthest)
    if abs(curvature) > most:
        return (
            f"has a curvature of {curvature:.3g} N/N^2, which hides forces from the guard; "
            f"under a force limit of {limit_n:g} N at most {most:.3g} N/N^2"
        )
    return None


def _torque(calibration: TorqueCalibration, limits: Limits) -> str | None:
    for name in ("offset", "command_offset"):
        offsets_nm = getattr(calibration.values, name).value
        for joint, (offset_nm, limit_nm) in enumerate(zip(offsets_nm, limits.torque_nm, strict=True), 1):
            most_nm = _OFFSET_SHARE * limit_nm
            if abs(offset_nm) > most_nm:
                return (
                    f"has a {name} of {offset_nm:.3g} N m for joint {joint}; under a torque limit of "
                    f"{limit_nm:g} N m at most {most_nm:.3g} N m"
                )
    return None
