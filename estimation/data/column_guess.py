"""What a column seems to hold, by its name in common use and the unit in it."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from estimation.data.quantities import QUANTITIES, RUN, parse_role, split_unit
from estimation.data.units import dimension_of

WORDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        quantity: frozenset(words.split())
        for quantity, words in {
            "time": "t time times zeit prüfzeit testzeit messzeit temps tempo timestamp sec seconds clock",
            "displacement": "x z d depth disp displacement indentation deformation stroke extension "
            "compression travel distance crosshead traverse deflection weg standardweg traversenweg hub",
            "force": "f fz fn force load kraft standardkraft prüfkraft normalkraft last forcez forza",
            "torque": "tau torque torques moment drehmoment effort efforts current currents strom motorstrom",
            "position": "q angle angles theta pos position positions winkel",
            "velocity": "v vel dq qd velocity speed geschwindigkeit omega",
            RUN: "run trial cycle test rep repeat press",
        }.items()
    }
)
"""Words for each quantity, in lower case; one of three letters or more may stand among others."""

_CURRENT = frozenset({"current", "currents", "strom", "motorstrom", "i", "iq"})
_NOT_MEASURED = frozenset(
    [
        *("set", "setpoint", "target", "cmd", "command", "commanded", "goal", "desired", "des", "reference"),
        *("ref", "soll", "error", "err", "max", "min", "peak", "rate", "limit", "std", "mean", "stress"),
        *("strain", "offset", "temperature", "temp"),
    ]
)
_KNOWN = tuple((quantity, known) for quantity, known in WORDS.items() if quantity != RUN)
OWN_NAME, _BY_NAME, _BY_WORD, _BY_UNIT = 3, 2, 1, 0


@dataclass(frozen=True)
class Guess:
    """What a column seems to hold."""

    column: str  # its name in the file
    quantity: str  # key of `QUANTITIES`, or "run"; empty for none
    joint: int | None = None  # number in the name, None where it has none
    unit: str = ""  # as the name says it, normalised; empty where it says none
    rank: int = _BY_NAME  # how well the name fits; the highest is a name of palpate's own
    why: str = ""  # in words

    @property
    def key(self) -> tuple[str, int]:
        """Quantity and number of the joint, 0 where there is none."""
        return self.quantity, self.joint or 0

    @property
    def fit(self) -> tuple[bool, int, bool]:
        """How well it suits its quantity, to compare columns; a current only for want of a torque."""
        return dimension_of(self.unit) != "current", self.rank, bool(self.unit)


def guess_columns(names: Sequence[str]) -> list[Guess]:
    """What each column seems to hold; joints that are numbered from 0 are renumbered from 1."""
    found = [_guess(name) for name in names]
    loose = [one for one in found if one.joint is not None and one.rank <= _BY_NAME]
    if not any(one.joint == 0 for one in loose):
        return found
    return [
        Guess(one.column, one.quantity, one.joint + 1, one.unit, one.rank, one.why)
        if one in loose and one.joint is not None
        else one
        for one in found
    ]


def _guess(name: str) -> Guess:
    role = parse_role(name)
    if role is not None:
        rank = OWN_NAME if role.unit else _BY_NAME
        return Guess(name, role.quantity, role.joint or None, role.unit, rank, "by its name")
    if name.strip().lower() in WORDS[RUN]:
        return Guess(name, RUN, why="by its name")
    stem, unit = split_unit(name)
    words = re.findall(r"[^\W\d_]+|\d+", re.sub(r"(?<=[a-zäöü])(?=[A-Z])", " ", stem))
    numbers = [int(word) for word in words if word.isdecimal() and len(word) < 4]
    letters = [word.lower() for word in words if not word.isdecimal()]
    joint = numbers[0] if len(numbers) == 1 else None
    if not letters or _NOT_MEASURED & set(letters):
        return Guess(name, "")
    quantity, rank = _named("".join(letters), letters, unit)
    if not quantity:
        return Guess(name, "")
    if quantity not in ("position", "torque"):
        joint = None
    why = ("by its unit", "by a word in its name", "by its name")[rank]
    return Guess(name, quantity, joint, unit, rank, why)


def _named(whole: str, words: Sequence[str], unit: str) -> tuple[str, int]:
    """Quantity and rank: by the whole name, by one of its words with a unit that fits, or by the unit."""
    dimension = dimension_of(unit)
    long = [word for word in words if len(word) > 2]
    for quantity, known in _KNOWN:
        named = whole in known or (quantity == "torque" and dimension == "current" and whole in _CURRENT)
        if named and (dimension is None or _fits(quantity, unit)):
            return quantity, _BY_NAME
    for quantity, known in _KNOWN:
        if _fits(quantity, unit) and not known.isdisjoint(long):
            return quantity, _BY_WORD
    return next(((quantity, _BY_UNIT) for quantity in QUANTITIES if _fits(quantity, unit)), ("", 0))


def _fits(quantity: str, unit: str) -> bool:
    return dimension_of(unit) in QUANTITIES[quantity]
