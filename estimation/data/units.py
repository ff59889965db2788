"""Units of measured quantities, and limits of usable numbers."""

import math
import re
from collections.abc import Collection, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from palpate.robot_io.types import FloatArray

_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 0.1, "da": 10.0, "h": 100.0}
_PREFIXES |= {"k": 1e3, "M": 1e6}
_STANDARD_GRAVITY = 9.80665  # [m/s^2]; converts grams and kilograms that are used as units of force
_POUND = 0.45359237 * _STANDARD_GRAVITY
_INCH = 0.0254
MAX_STEP_S = 0.5  # step between samples above which another unit of time is more likely
MIN_STEP_S = 1e-5  # step between samples below which another unit of time is more likely
MIN_RECORDING_S = 1.0  # shortest plausible duration of a recording
_SLOW_STEP_S = 1.0  # longest step between samples of a slow recording, in a unit of time that is proposed


def _with_prefixes(unit: str, prefixes: str, factor: float = 1.0) -> dict[str, float]:
    """Return the factors of a unit, given its own, and of its multiples."""
    return {unit: factor} | {prefix + unit: _PREFIXES[prefix] * factor for prefix in prefixes.split()}


_LENGTH = _with_prefixes("m", "m c u n d") | {"in": _INCH, "ft": 12.0 * _INCH}
_ANGLE = _with_prefixes("rad", "m u") | _with_prefixes("deg", "m c d", math.pi / 180.0)
_ANGLE |= {"gon": math.pi / 200.0, "rev": 2.0 * math.pi}
_TIME = _with_prefixes("s", "m u n") | {"min": 60.0, "h": 3600.0, "day": 86400.0}
_FORCE = _with_prefixes("N", "m u n k M p c d da h") | {
    "gf": 1e-3 * _STANDARD_GRAVITY,
    "kgf": _STANDARD_GRAVITY,
    "tf": 1e3 * _STANDARD_GRAVITY,
    "ozf": _POUND / 16.0,
    "lbf": _POUND,
    "kip": 1e3 * _POUND,
}
_PRODUCTS = ("N.mm", "kN.mm", "N.cm", "gf.cm", "kgf.cm", "kgf.m", "ozf.in", "lbf.in", "lbf.ft")
_TORQUE = _with_prefixes("Nm", "m u k M c d da h") | {
    force + length: _FORCE[force] * _LENGTH[length]
    for force, length in (product.split(".") for product in _PRODUCTS)
}
_PRESSURE = _with_prefixes("Pa", "m k M h") | {"mbar": 1e2, "bar": 1e5, "psi": _POUND / _INCH**2}


def _rates(units: Mapping[str, float], ending: str, time: float = 1.0) -> dict[str, float]:
    """Append an ending for a rate to units, such as per minute (`mm_min`) or per second squared (`mm_s2`)."""
    return {unit + ending: factor / time for unit, factor in units.items()}


SI: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": _TIME,
        "length": _LENGTH,
        "length_rate": _rates(_LENGTH, "_s") | _rates(_LENGTH, "_min", 60.0),
        "length_rate_2": _rates(_LENGTH, "_s2"),
        "angle": _ANGLE,
        "angle_rate": _rates(_ANGLE, "_s") | {"rpm": 2.0 * math.pi / 60.0, "deg_min": math.pi / 10800.0},
        "angle_rate_2": _rates(_ANGLE, "_s2"),
        "force": _FORCE,
        "torque": _TORQUE,
        "current": _with_prefixes("A", "m"),
        "voltage": _with_prefixes("V", "m u"),
        "pressure": _PRESSURE,
        "strain": {"strain": 1.0, "%": 0.01},
    }
)
"""Factor to SI of each unit, by dimension."""

_FACTORS = {unit: (dimension, factor) for dimension, units in SI.items() for unit, factor in units.items()}

_PREFIX_NAMES = {"p": "pico", "n": "nano", "u": "micro", "m": "milli", "c": "centi", "d": "deci"}
_PREFIX_NAMES |= {"da": "deca", "h": "hecto", "k": "kilo", "M": "mega"}
_UNIT_NAMES = {  # names that may have a prefix and a plural
    "s": "second sec",
    "m": "meter metre",
    "rad": "radian",
    "N": "newton",
    "Nm": "newtonmeter newtonmetre",
    "A": "ampere amp",
    "V": "volt",
    "Pa": "pascal",
}
_SPELLINGS = {  # other spellings of units, in lower case
    "s": "sek sekunde sekunden seg segundos secondes с сек 秒 초",
    "min": "mins minute minutes minuten мин",
    "h": "hr hrs hour hours std stunde stunden heure heures ч",
    "day": "days tag tage jour jours",
    "ms": "msec msecs мс 毫秒",
    "us": "usec usecs мкс 微秒",
    "ns": "nsec nsecs",
    "m": "м 米",
    "cm": "см 厘米",
    "um": "micron microns мкм 微米",
    "mm": "мм 毫米",
    "nm": "нм",  # a torque in N m, see `read_as`
    "rad": "рад 弧度",
    "N": "н 牛 牛顿",
    "kN": "кн 千牛",
    "in": 'inch inches "',
    "ft": "foot feet",
    "deg": "degree degrees degs grad ° град 度 도",
    "rev": "revs revolution revolutions turn turns",
    "rpm": "rev_min u_min 1_min об_мин",
    "gf": "g gram grams gramm гс 克",
    "kgf": "kg kp кгс 公斤 千克",
    "tf": "tonf tonne tonnes тс 吨",
    "ozf": "oz ounce ounces",
    "lbf": "lb lbs pound pounds",
    "kip": "kips kipf klbf",
    "Nm": "n.m n-m 牛米",
    "gfcm": "gcm",
    "kgfcm": "kgcm kpcm",
    "kgfm": "kgm",
    "ozfin": "ozin inoz",
    "lbfin": "lbin inlbf inlb inlbs",
    "lbfft": "lbft ftlbf ftlb ftlbs",
    "psi": "psig lbf_in2",
    "%": "percent pct prozent",
}
_SPELT = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()} | {
    f"{prefix_name}{name}{plural}": prefix + unit
    for unit, names in _UNIT_NAMES.items()
    for prefix, prefix_name in (("", ""), *_PREFIX_NAMES.items())
    if prefix + unit in _FACTORS
    for name in names.split()
    for plural in ("", "s")
}


def _lower_case(unit: str) -> str:
    """Convert to lower case, except an initial M, since M is mega and m is milli."""
    return "M" + unit[1:].lower() if unit.startswith("M") else unit.lower()


BRACKETED = frozenset(["dm", "dN", "hN", "cN", "day"])
"""Units that are words or parts of names too, and are read in brackets only."""
# "KN" is kN, and "NM" is Nm.
_BY_LETTERS = {_lower_case(unit): unit for unit in _FACTORS if unit not in {"nm", *BRACKETED}} | {
    "Min": "min"
}

_SCALED = re.compile(r"×?([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)(.+)")
_POWER_OF_TEN = re.compile(  # before a unit, as in "0.1 N", "10^-3 N", "1/100 s" and "x1000 N"
    r"([x×*·]?) ?(1 ?/ ?10+|0?[.,]0*1|10 ?(?:\^|\*\*|(?=[-+])) ?[-+]?\d\d?|1e[-+]?\d\d?|10+) ?[x×*·]? ?(\D.*)"
)
_CLOCK = re.compile(r"(h{1,2}:)?m{1,2}:s{1,2}([.,:][sf0mx]+)?", re.IGNORECASE)  # format of a clock time


def normalize_unit(unit: str) -> str:
    """Convert a unit to its standard spelling: "mm/s^2" to "mm_s2", "N m" and "N*m" to "Nm".

    A capital M is mega and a small m is milli: "MN" is not a millinewton. "10^-3 N" becomes "×1e-3N".
    Unknown units are unchanged.

    Args:
        unit: unit as written, such as "mm/s^2".
    """
    plain = unit.strip().replace("²", "2").replace("^", "").replace("/", "_")
    plain = re.sub("[ *·⋅∙×]", "", re.sub("[µμ]", "u", plain)).rstrip(".")
    if dimension_of(known := "s" if _CLOCK.fullmatch(plain) else _power_of_ten(unit) or plain):
        return known
    upright, _, per = plain.partition("_")
    for whole, rest in ((plain, ""), (upright, f"_{per.lower()}")):
        spelt = _SPELT.get(whole.lower()) or _BY_LETTERS.get(_lower_case(whole), "")
        if dimension_of(spelt + rest):
            return spelt + rest
    if "." in plain and dimension_of(per_second := normalize_unit(plain.replace(".", "_"))):
        return per_second  # "rad.s" is rad/s, as R writes names
    if "." in plain or "-" in plain:  # products, such as "kN.m" and "ft-lbf"
        product = normalize_unit(re.sub("[.-]", "", plain))
        return product if dimension_of(product) == "torque" else plain
    return plain


def _power_of_ten(unit: str) -> str:
    """Convert "10^-3 N" to "×1e-3N"; empty for other text. "100 N" may be the range of a sensor."""
    match = _POWER_OF_TEN.fullmatch(unit.strip().replace("−", "-"))
    dimension = dimension_of(base := normalize_unit(match[3])) if match else None
    if not match or not dimension or (match[2].isdecimal() and not match[1] and dimension != "time"):
        return ""
    number = re.sub(r"^10(\^|\*\*|(?=[-+]))", "1e", match[2].replace(" ", "").replace(",", "."))
    return f"×{1.0 / float(number[2:]):g}{base}" if "/" in number else f"×{number}{base}"


def read_as(unit: str, dimensions: Collection[str]) -> str:
    """Resolve an ambiguous unit by the quantity's dimensions: "nm" of a torque is a newton meter.

    Args:
        unit: unit as written.
        dimensions: dimensions that the quantity may have.
    """
    return "Nm" if unit == "nm" and "torque" in dimensions else unit


def dimension_of(unit: str) -> str | None:
    """Return the dimension of a unit, or None for an unknown unit.

    Args:
        unit: unit in the standard spelling of `normalize_unit`, such as "mm_s2" or "×0.1N".
    """
    base = scaled_unit(unit, "")[1] if unit.startswith("×") else unit
    return _FACTORS[base][0] if base in _FACTORS else None


def si_factor(unit: str) -> float:
    """Return the factor of a known unit to SI.

    Args:
        unit: unit in the standard spelling of `normalize_unit`, such as "mm_s2" or "×0.1N".
    """
    scale, base = scaled_unit(unit, "")
    return scale * _FACTORS[base][1]


def likely_time_unit(step: float, span: float = math.inf) -> str:
    """Return the largest unit of time in which the step between samples is at most `MAX_STEP_S`.

    If the whole recording would be shorter than `MIN_RECORDING_S` in that unit, the next larger unit is
    returned.

    Args:
        step: step between samples, in the unknown unit of time.
        span: time from the first to the last sample, in the same unit.
    """
    units = ("s", "ms", "us", "ns")
    number = next((n for n, unit in enumerate(units[:3]) if step * _TIME[unit] <= MAX_STEP_S), 3)
    is_too_short = span * _TIME[units[number]] < MIN_RECORDING_S
    return units[number - 1] if is_too_short and number > 0 else units[number]


def other_time_unit(step_s: float, span_s: float, factor: float) -> str:
    """Return the unit of time to propose if the one in use gives an implausible step between samples.

    It is the unit with the most plausible step and duration; of equally plausible ones, the unit that is
    closest to the one in use. The unit in use is never returned, nor is a day, in which no clock counts.

    Args:
        step_s: step between samples in the unit in use, converted to seconds.
        span_s: time from the first to the last sample, converted likewise.
        factor: factor of the unit in use to seconds.
    """

    def distance(unit: str) -> tuple[float, float]:
        ratio = _TIME[unit] / factor
        step, span = max(ratio * step_s, SMALLEST), max(ratio * span_s, SMALLEST)
        excess = (
            max(step / _SLOW_STEP_S, 1.0) * max(MIN_STEP_S / step, 1.0) * max(MIN_RECORDING_S / span, 1.0)
        )
        return excess, abs(math.log(ratio))

    counted = (unit for unit in _TIME if unit != "day" and not math.isclose(_TIME[unit], factor))
    return min(counted, key=distance)


def is_scaled(unit: str) -> bool:
    """Return whether a unit begins with a number, such as "-1N".

    Args:
        unit: unit as written, such as "mm/s^2".
    """
    return _SCALED.fullmatch(unit.strip()) is not None


def scaled_unit(unit: str, own: str) -> tuple[float, str]:
    """Split a unit into the number before it and the unit, and resolve units such as Nm/A.

    Examples: "-1N" for a sensor of opposite sign, "0.5Nm/A" for a current in mA, "20N/V" for a voltage,
    "5e-4N/Pa" for a pressure, "0.05m/strain" for a strain.

    Args:
        unit: normalized unit stated by the user.
        own: normalized unit in the column's name; empty for none.

    Returns:
        The factor by which to multiply, and the resulting unit.
    """
    match = _SCALED.fullmatch(unit)
    if not match:
        return 1.0, unit
    scale, base_unit = float(match[1]), normalize_unit(match[2])
    whole, _, below = base_unit.rpartition("_")
    dimension, factor = _FACTORS.get(normalize_unit(below), ("", 1.0))
    if whole and dimension in {"current", "voltage", "pressure", "strain"}:
        read = own or normalize_unit(below)
        if dimension_of(read) == dimension:
            return scale * SI[dimension][read] / factor, normalize_unit(whole)
    return scale, base_unit


LARGEST_NUMBER = 1e30  # largest allowed number in any unit, so that squares do not overflow
SMALLEST = 1.0 / LARGEST_NUMBER  # least allowed maximum of a signal, so that squares do not underflow
MIN_INCREASE_S = 1e-12  # least increase between samples of a clock, far below any clock's step


def invalid_rows(values: FloatArray) -> NDArray[np.int64]:
    """Return the indices of rows with a value that is not finite or too large.

    Args:
        values: array of shape (n,) or (n, k).
    """
    usable = np.abs(values) <= LARGEST_NUMBER
    return np.flatnonzero(~(usable if usable.ndim == 1 else usable.all(axis=1)))


def describe_fault(number: float, count: int = 1) -> str:
    """Describe the fault of an invalid number and the number of further ones.

    Args:
        number: invalid number, see `invalid_rows`.
        count: total count of invalid numbers.
    """
    fault = "too large a number" if np.isfinite(number) else "not a finite number"
    return f"{fault} ({count - 1} more like it)" if count > 1 else fault
