"""What the columns of a data file are called, and what they hold."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from estimation.data.units import SI, dimension_of, normalise, read_as
from robot_io.errors import InputError

RUN, PHASE = "run", "phase"

QUANTITIES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "time": ("time",),
        "displacement": ("length",),
        "position": ("angle", "length"),
        "velocity": ("length_rate", "angle_rate"),
        "acceleration": ("length_rate_2", "angle_rate_2"),
        "force": ("force", "voltage", "pressure"),
        "torque": ("torque", "current"),
    }
)
"""Dimensions that each quantity may have; see `STANDS_FOR`."""

STANDS_FOR: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "current": ("N m", "torque constant", "0.5Nm/A"),
        "voltage": ("N", "sensor's constant", "20N/V"),
        "pressure": ("N", "area", "5e-4N/Pa"),
    }
)
"""What may stand for an effort: the effort's unit, the constant between them, and an example of it."""

OF_JOINTS = frozenset({"position", "velocity", "acceleration", "torque", "force"})

_ALSO = {"depth": "displacement", "angle": "position"}
_NAME = re.compile(rf"({'|'.join([*QUANTITIES, *_ALSO])})(?:_(\d+))?(?:_(.+))?", re.IGNORECASE)
_BRACKETED = re.compile(r"\s*[\[({<]\s*(?!\d+\s*\])([^\])}>]*?)\s*[\])}>]\s*$")  # an index is no unit
_AFTER = re.compile(r"\s*(?:/|,|\bin\b)\s*([^\s/,]+)\s*$")


@dataclass(frozen=True)
class Role:
    """What a column is for."""

    quantity: str  # key of `QUANTITIES`
    joint: int  # number of the joint from 1, or 0 where the name has none
    unit: str  # as in the name, normalised; empty where it has none
    shift: int = 0  # what the joint's number has more than in the file, whose joints may count from 0

    @property
    def key(self) -> tuple[str, int]:
        """Quantity and joint, which only one column may have."""
        return self.quantity, self.joint

    @property
    def numbered(self) -> str:
        """The quantity with the joint's number in the file, as options call it: position_2, force."""
        return f"{self.quantity}_{self.joint - self.shift}" if self.joint else self.quantity


def parse_role(name: str, shift: int = 0) -> Role | None:
    """Read a name such as `position_2_rad`, `force_N` or `time`; None if it is no such name.

    Args:
        name: of a column, or in an option.
        shift: to add to the number of a joint.
    """
    match = _NAME.fullmatch(name.strip())
    if not match:
        return None
    named, number, ending = match.group(1).lower(), match.group(2), match.group(3) or ""
    quantity = _ALSO.get(named, named)
    joint = int(number or 0) + shift * (number is not None and quantity in OF_JOINTS)
    unit = read_as(normalise(ending), QUANTITIES[quantity])
    if unit and dimension_of(unit) not in QUANTITIES[quantity]:
        return None
    if named == "angle" and dimension_of(unit) != "angle":  # without its unit it may be any angle
        return None
    return Role(quantity, joint, unit, shift)


def joint_number(name: str) -> int | None:
    """The number in a name of palpate's own; None where it has none.

    Args:
        name: of a column.
    """
    match = _NAME.fullmatch(name.strip())
    return int(match.group(2)) if match and match.group(2) else None


def role_of_option(name: str, shift: int) -> Role:
    """The role that a user names in --column.

    Args:
        name: as the user wrote it.
        shift: added to the number of a joint.

    Raises:
        InputError: it is none.
    """
    role = parse_role(name, shift)
    if role is None:
        valid = ", ".join([*QUANTITIES, RUN, PHASE])
        raise InputError(
            f"--column: '{name}' is no quantity with its unit. Quantities: {valid}; such as force_N"
        )
    return role


def split_unit(name: str) -> tuple[str, str]:
    """What any column's name says before its unit, and the unit, normalised; empty if it says none known.

    Units stand in brackets, after a slash, a comma or "in", or at the end: "Weg / mm", "load_mN", "Load N".

    Args:
        name: of a column.
    """
    match = _BRACKETED.search(name)
    stem, _, last = name.strip().rpartition(" ")
    if not match and stem and "/" in last and dimension_of(unit := normalise(last)):
        return stem.removesuffix(" in"), unit
    match = match or _AFTER.search(name)
    if match and dimension_of(unit := normalise(match[1])):
        return name[: match.start()], unit
    if match and match.re is _BRACKETED:
        return name[: match.start()], ""
    parts = re.split(r"[_ ]", name.strip())
    for count in (2, 1):
        if len(parts) <= count:
            continue
        for mark in ("_", ""):  # "mm s" may be mm/s, "kgf cm" is a product
            ending = normalise(mark.join(parts[-count:]))
            if dimension_of(ending):
                return "_".join(parts[:-count]), ending
    return name, ""


def unknown_unit(name: str) -> str:
    """What stands in brackets at the end of a name, if it is no unit that is known; else empty.

    Args:
        name: of a column.
    """
    match = _BRACKETED.search(name)
    return match[1] if match and not dimension_of(normalise(match[1])) else ""


def unit_in_name(name: str) -> str:
    """The unit that any column's name says, normalised; empty if it says none that is known.

    Args:
        name: of a column.
    """
    return split_unit(name)[1]


def si_unit(dimension: str) -> str:
    """The SI unit of a dimension, as names spell it.

    Args:
        dimension: such as "force".
    """
    return next(unit for unit, factor in SI[dimension].items() if factor == 1.0)
