"""Units of force that instruments write, in newtons. Factors are exact: NIST SP 811, appendix B."""

from robot_io.errors import ProtocolError

_GRAVITY_M_S2 = 9.80665
_POUND_KG = 0.45359237

NEWTONS: dict[str, float] = {
    "n": 1.0,
    "mn": 1e-3,
    "kn": 1e3,
    "kgf": _GRAVITY_M_S2,
    "kg": _GRAVITY_M_S2,
    "gf": 1e-3 * _GRAVITY_M_S2,
    "g": 1e-3 * _GRAVITY_M_S2,
    "lbf": _POUND_KG * _GRAVITY_M_S2,
    "lb": _POUND_KG * _GRAVITY_M_S2,
    "ozf": _POUND_KG / 16 * _GRAVITY_M_S2,
    "oz": _POUND_KG / 16 * _GRAVITY_M_S2,
}


def newtons_per(unit: str) -> float:
    """Newtons in one `unit`; case does not matter, except that MN and mN differ a billion times.

    Raises:
        ProtocolError: it is no unit of force that is known here.
    """
    text = unit.strip()
    factor = None if text.startswith("M") and text[1:] in ("N", "n") else NEWTONS.get(text.lower())
    if factor is None:
        raise ProtocolError(f"unit '{text[:20]}' is no force that is known here. Valid: {', '.join(NEWTONS)}")
    return factor
