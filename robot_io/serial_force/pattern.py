"""Readings of any instrument that writes one line a sample: a pattern finds number and unit."""

import re
from math import isfinite

from robot_io.errors import InputError, ProtocolError
from robot_io.serial_force.framing import LineSplitter
from robot_io.serial_force.loadstar import text_of
from robot_io.serial_force.units import newtons_per

MAX_PATTERN = 200
_REPEATED_GROUP = re.compile(r"\)[*+{]")  # the only way to take for ever on a short line


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """A pattern that must match a whole line, with a group `value` and perhaps a group `unit`.

    Raises:
        InputError: it is not a regular expression, lacks `value`, or repeats a group, which can take for
            ever.
    """
    if len(pattern) > MAX_PATTERN:
        raise InputError(f"pattern: longer than {MAX_PATTERN} characters")
    try:
        compiled = re.compile(pattern)
    except re.error as error:
        raise InputError(f"pattern '{pattern}': {error}") from error
    if "value" not in compiled.groupindex:
        raise InputError(f"pattern '{pattern}': has no group (?P<value>...)")
    if _REPEATED_GROUP.search(pattern):
        raise InputError(f"pattern '{pattern}': a repeated group can take for ever")
    return compiled


class PatternStream:
    """Lines that match a pattern. The unit is the one in the line, else the one that is stated.

    Args:
        pattern: from `compile_pattern`.
        unit: unit of lines that name none, or None: such lines are refused.
        scale: what a value is multiplied with before its unit.
    """

    def __init__(self, pattern: re.Pattern[str], unit: str | None, scale: float) -> None:
        self._pattern = pattern
        self._stated = None if unit is None else newtons_per(unit) * scale
        self._scale = scale
        self._lines = LineSplitter()
        self._lines.resynchronise()
        self._bad = 0

    @property
    def rejected(self) -> int:
        """Lines that were not readings."""
        return self._bad + self._lines.dropped

    def feed(self, data: bytes) -> list[float]:
        """See `Stream.feed`."""
        samples: list[float] = []
        for line in self._lines.feed(data):
            try:
                samples.append(self.force_n(text_of(line)))
            except ProtocolError:
                self._bad += 1
        return samples

    def force_n(self, line: str) -> float:
        """The force in one line [N].

        Raises:
            ProtocolError: the line does not match, its value is not a number or its unit not known.
        """
        match = self._pattern.fullmatch(line)
        if match is None:
            raise ProtocolError(f"does not match the pattern: '{line[:60]}'")
        found = match.groupdict()
        try:
            value = float(found["value"])
        except (TypeError, ValueError) as error:
            raise ProtocolError(f"not a number: '{found['value']}'") from error
        factor = newtons_per(found["unit"]) * self._scale if found.get("unit") else self._stated
        if factor is None:
            raise ProtocolError(f"names no unit, and none is stated: '{line[:60]}'")
        if not isfinite(value * factor):
            raise ProtocolError(f"not finite: '{line[:60]}'")
        return value * factor
