"""Text from force sensors: lines cut out of a stream of bytes, decimal numbers, and units of force."""

from collections.abc import Callable
from typing import Protocol

from robot_io.errors import ProtocolError

MAX_LINE = 200  # bytes; a longer one is noise
_FIXED_FORMAT = 200  # lines of equal decimals in a row; by chance, trailing zeros left out, 1 in 10^9
_GRAVITY_M_S2 = 9.80665
_POUND_N = 0.45359237 * _GRAVITY_M_S2

# In one unit; exact factors of NIST SP 811, appendix B.
NEWTONS = {
    **{"n": 1.0, "mn": 1e-3, "kn": 1e3},
    **dict.fromkeys(("kgf", "kg"), _GRAVITY_M_S2),
    **dict.fromkeys(("gf", "g"), 1e-3 * _GRAVITY_M_S2),
    **dict.fromkeys(("lbf", "lb", "lbs"), _POUND_N),
    **dict.fromkeys(("ozf", "oz"), _POUND_N / 16),
    "klbf": 1e3 * _POUND_N,
}


def newtons_per(unit: str) -> float:
    """Newtons in one `unit`; case does not matter, except that MN is not mN. ProtocolError: unknown unit."""
    text = unit.strip()
    factor = None if text.startswith("M") and text[1:] in ("N", "n") else NEWTONS.get(text.lower())
    if factor is None:
        raise ProtocolError(f"unit '{text[:20]}' is not a known unit of force. Valid: {', '.join(NEWTONS)}")
    return factor


def known_unit(unit: str | None) -> str | None:
    """A unit from a robot file, for pydantic. ValueError: it is unknown."""
    if unit is not None:
        try:
            newtons_per(unit)
        except ProtocolError as error:
            raise ValueError(str(error)) from error
    return unit


def text_of(line: bytes) -> str:
    """A line as text, stripped. ProtocolError: it holds something that is not printable ASCII."""
    if not all(32 <= byte < 127 or byte == 9 for byte in line):
        raise ProtocolError(f"not a line of text: {line[:40]!r}")
    return line.decode("ascii").strip()


class Stream(Protocol):
    """Makes force samples out of bytes, in any portions. Damaged ones are counted and left out."""

    complaint: str  # what the device itself says is wrong with it since its last sample, or nothing

    @property
    def rejected(self) -> int:
        """How much was not a sample."""

    def feed(self, data: bytes) -> list[float]:
        """Samples that are complete now, oldest first [N], in the sensor's own sign."""


class LineSplitter:
    """Cuts at CR and LF, whichever come; empty lines are dropped.

    Attributes:
        dropped: lines that were too long.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._skipping = False  # until the end of a line whose beginning was not seen or was too long
        self.dropped = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Lines that are complete now, without their ends."""
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if lines and self._skipping:
            lines, self._skipping = lines[1:], False
        if len(self._rest) > MAX_LINE:
            self._rest, self._skipping = b"", True
            self.dropped += 1
        self.dropped += sum(len(line) > MAX_LINE for line in lines)
        return [line for line in lines if line and len(line) <= MAX_LINE]

    def resynchronise(self) -> None:
        """Forget what is incomplete, and the rest of it that is still to come."""
        self._rest, self._skipping = b"", True


class LineStream:
    """Readings from lines of text, none beyond `largest_n` [N].

    Where all lines have had the same number of decimals, one with another number is rejected: a byte is
    missing ("0.65" without its point is 65). A first line may have lost its beginning, and is left out unless
    `from_beginning`.

    `parse` makes of a line the number as it is written, and newtons per unit.
    ProtocolError: it is no reading.
    """

    complaint = ""  # such devices do not complain

    def __init__(
        self, parse: Callable[[str], tuple[str, float]], largest_n: float, *, from_beginning: bool = False
    ) -> None:
        self._parse, self._largest_n = parse, largest_n
        self._lines = LineSplitter()
        if not from_beginning:
            self._lines.resynchronise()
        self._decimals, self._same = 0, 0  # in so many lines in a row
        self._bad = 0

    @property
    def rejected(self) -> int:
        """Lines that were not readings."""
        return self._bad + self._lines.dropped

    def feed(self, data: bytes) -> list[float]:
        samples: list[float] = []
        for line in self._lines.feed(data):
            self._take(line, samples)
        return samples

    def _take(self, line: bytes, samples: list[float]) -> None:
        """Add what a line says to the samples."""
        try:
            samples.append(self._force_n(text_of(line)))
        except ProtocolError:
            self._bad += 1

    def _force_n(self, line: str) -> float:
        text, newtons = self._parse(line)
        try:
            force_n = float(text) * newtons
        except ValueError as error:
            raise ProtocolError(f"not a number: '{text[:40]}'") from error
        self._check_decimals(len(text.lower().partition("e")[0].partition(".")[2]))
        if not abs(force_n) <= self._largest_n:  # nor NaN
            raise ProtocolError(f"{force_n:g} N is beyond {self._largest_n:g} N")
        return force_n

    def _check_decimals(self, decimals: int) -> None:
        if decimals == self._decimals:
            self._same += 1
        elif self._same < _FIXED_FORMAT:
            self._decimals, self._same = decimals, 0
        else:
            self._same //= 2  # a format that really has changed is learnt anew
            raise ProtocolError(f"{decimals} decimals, where all lines had {self._decimals}")
