"""Holds a calibration against the limits of the arm: it stands between the sensors and the guard.

A wrong one must not hide from the guard what the guard is there for, nor tell a drive more than it may give.
"""

from robot_io.calibration.file import Calibration, EncoderCalibration, ForceCalibration, TorqueCalibration
from robot_io.guard import Limits

_ZERO_SHARE = 0.5  # of the force limit, that a sensor may show with nothing on it
_SLOPE_SHARE = 0.5  # of the scale, that must be left wherever the guard has to see the force grow
_OFFSET_SHARE = 0.2  # of a torque limit
_LARGE_ZERO_RAD = 0.2


def implausible(calibration: Calibration, limits: Limits) -> str | None:
    """Why a calibration cannot be this arm's, in words, or None."""
    if isinstance(calibration, ForceCalibration):
        return _force(calibration, limits.force_n)
    if isinstance(calibration, TorqueCalibration):
        return _torque(calibration, limits)
    return None


def doubtful(calibration: Calibration) -> str | None:
    """What a person must look at before this calibration is used, in words, or None; it is not refused.

    Zeros can be anywhere. But a wrong one sends the arm where nobody expects it, and when a zero is far off,
    then more often the pose or the stop was another than was said.
    """
    if not isinstance(calibration, EncoderCalibration):
        return None
    offsets = enumerate(calibration.values.offset.value, 1)
    far = [
        f"joint {joint} by {offset:+.3g} rad" for joint, offset in offsets if abs(offset) > _LARGE_ZERO_RAD
    ]
    if not far:
        return None
    return (
        f"the zero of {', '.join(far)}: that is far. Was the arm really where it was said to be? "
        "With a wrong zero it moves to other places than its limits say"
    )


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
