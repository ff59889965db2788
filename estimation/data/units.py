"""Units of data files, and what turns them into SI."""

import math
from collections.abc import Mapping
from types import MappingProxyType

from robot_io.errors import InputError

_LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180}
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0}
_FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3}
_TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2, "kNm": 1e3}


def _rates(units: Mapping[str, float], order: int) -> dict[str, float]:
    """Units per second, or per second squared, as `mm_s` and `mm_s2`."""
    ending = "_s" if order == 1 else "_s2"
    return {unit + ending: factor for unit, factor in units.items()}


SI: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": _TIME,
        "length": _LENGTH,
        "length_rate": _rates(_LENGTH, 1),
        "length_rate_2": _rates(_LENGTH, 2),
        "angle": _ANGLE,
        "angle_rate": _rates(_ANGLE, 1),
        "angle_rate_2": _rates(_ANGLE, 2),
        "force": _FORCE,
        "torque": _TORQUE,
    }
)
"""Factor to SI of each unit, by dimension."""


def normalise(unit: str) -> str:
    """The spelling used here: "mm/s^2" and "mm/s2" are "mm_s2", "N m" and "N*m" are "Nm", "n" is "N"."""
    plain = (
        unit.strip().replace("²", "2").replace("^", "").replace("/", "_").replace(" ", "").replace("*", "")
    )
    return {"n": "N", "nm": "Nm"}.get(plain, plain)  # as in names that are all lower case


def dimension_of(unit: str) -> str | None:
    """The dimension that a unit measures, or None if it is not known."""
    return next((dimension for dimension, units in SI.items() if unit in units), None)


def factor_to_si(unit: str, dimension: str, where: str) -> float:
    """What to multiply by.

    Args:
        unit: in any spelling.
        dimension: key of `SI`.
        where: for the error, such as "--unit force_N".

    Raises:
        InputError: the unit does not measure this.
    """
    units = SI[dimension]
    try:
        return units[normalise(unit)]
    except KeyError:
        raise InputError(f"{where}: '{unit}' is no unit of it. Valid: {', '.join(units)}") from None
