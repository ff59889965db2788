"""Units of data files, and what turns them into SI."""

import math
import re
from collections.abc import Mapping
from types import MappingProxyType

from robot_io.errors import InputError

_LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "in": 0.0254}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180}
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0}
SLOWEST_S = 0.5  # time from sample to sample, beyond which another unit of time is likelier
_STANDARD_GRAVITY = 9.80665  # m/s^2: what a gram or a kilogram weighs where it stands for a force
_POUND = 0.45359237 * _STANDARD_GRAVITY
_FORCE = {
    "N": 1.0,
    "mN": 1e-3,
    "kN": 1e3,
    "gf": 1e-3 * _STANDARD_GRAVITY,
    "kgf": _STANDARD_GRAVITY,
    "lbf": _POUND,
}
_TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2, "kNm": 1e3, "lbfin": 0.0254 * _POUND}
_CURRENT = {"A": 1.0, "mA": 1e-3}
_VOLTAGE = {"V": 1.0, "mV": 1e-3}


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
        "current": _CURRENT,
        "voltage": _VOLTAGE,
    }
)
"""Factor to SI of each unit, by dimension."""


_SPELT: Mapping[str, str] = MappingProxyType(
    {
        spelling: unit
        for unit, spellings in {
            "s": "sec secs second seconds sek sekunden seg segundos secondes",
            "ms": "msec msecs millisecond milliseconds",
            "us": "usec usecs microsecond microseconds",
            "ns": "nsec nsecs nanosecond nanoseconds",
            "min": "minute minutes",
            "mm": "millimeter millimeters millimetre millimetres",
            "cm": "centimeter centimetre",
            "m": "meter meters metre metres",
            "in": 'inch inches "',
            "um": "micron microns",
            "rad": "radian radians",
            "deg": "degree degrees degs °",
            "N": "n newton newtons",
            "mN": "mn millinewton",
            "kN": "kn kilonewton",
            "gf": "g gram grams gramm",
            "kgf": "kg kp",
            "lbf": "lb lbs pound pounds",
            "Nm": "nm n.m n-m n·m newton-meter",
            "Nmm": "nmm n.mm n-mm n·mm",
            "mNm": "mnm",
            "lbfin": "lbf.in lbf-in lbf·in lb-in in-lbf in-lb",
            "A": "a amp amps ampere",
            "mA": "ma",
            "V": "v volt volts",
        }.items()
        for spelling in spellings.split()
    }
)
"""Other spellings, in lower case, as machines and people write them."""


_SCALED = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(.+)")


_CLOCK = re.compile(
    r"(h{1,2}:)?m{1,2}:s{1,2}([.,:][sf0mx]+)?", re.IGNORECASE
)  # the form of what is read as s


def normalise(unit: str) -> str:
    """The spelling used here: "mm/s^2" and "mm/s2" are "mm_s2", "N m" and "N*m" are "Nm", "sec" is "s"."""
    plain = unit.strip().replace("²", "2").replace("^", "").replace("/", "_").replace("μ", "µ")
    plain = plain.replace(" ", "").replace("*", "")
    if _CLOCK.fullmatch(plain):
        return "s"
    if dimension_of(plain):
        return plain
    upright, slash, per = plain.partition("_")
    spelt = _SPELT.get(upright.lower(), upright if dimension_of(upright) else upright.lower())
    return spelt + slash + per if dimension_of(spelt + slash + per) else plain


def dimension_of(unit: str) -> str | None:
    """The dimension that a unit measures, or None if it is not known."""
    return next((dimension for dimension, units in SI.items() if unit in units), None)


def likely_time_unit(step: float) -> str:
    """The largest unit of time in which samples that are this far apart are less than `SLOWEST_S` apart."""
    return next((unit for unit in ("s", "ms", "us") if step * _TIME[unit] <= SLOWEST_S), "ns")


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


def scaled_unit(unit: str, own: str) -> tuple[float, str]:
    """The number before a unit, times what turns a column's own unit into what it is per; and the unit.

    Such as "-1N" where a sensor counts the other way, or "0.5Nm/A" for a current in mA.

    Args:
        unit: as the user says it, normalised.
        own: of the column's name, normalised; empty for none.
    """
    match = _SCALED.fullmatch(unit)
    if not match:
        return 1.0, unit
    scale, of = float(match[1]), normalise(match[2])
    whole, per, below = of.rpartition("_")
    if per and below in ("A", "V") and dimension_of(own) == dimension_of(below):
        return scale * factor_to_si(own, str(dimension_of(own)), own), normalise(whole)
    return scale, of
