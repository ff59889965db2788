"""Any force gauge that writes one line a sample: Mark-10, OpenScale, a microcontroller ..."""

import re
from typing import Annotated

from pydantic import AfterValidator, Field, field_validator

from robot_io.drivers.serial_force.sensor import SerialForceSensor, SerialForceSettings
from robot_io.drivers.serial_force.text import LineStream, known_unit, newtons_per
from robot_io.errors import InputError, ProtocolError
from robot_io.files.file_model import Capacity, Positive

MAX_PATTERN = 200
_REPEATED_GROUP = re.compile(r"\)[*+{]")  # the only way to backtrack for ever on a short line


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """A pattern that must match a whole line, with a group `value` and perhaps a group `unit`.

    InputError: not a regular expression, without `value`, or with a repeated group, which can take for ever.
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


def pattern_stream(pattern: str, unit: str | None, scale: float, largest_n: float) -> LineStream:
    """Readings from lines that match `pattern`, see `compile_pattern`; a value is multiplied with `scale`.

    Lines that name no unit are in `unit`; where that is None, they are rejected.
    """
    compiled = compile_pattern(pattern)
    stated = None if unit is None else newtons_per(unit)

    def parse(line: str) -> tuple[str, float]:
        match = compiled.fullmatch(line)
        if match is None:
            raise ProtocolError(f"does not match the pattern: '{line[:60]}'")
        found = match.groupdict()
        newtons = newtons_per(found["unit"]) if found.get("unit") else stated
        if newtons is None:
            raise ProtocolError(f"names no unit, and none is stated: '{line[:60]}'")
        return found["value"] or "", newtons * scale

    return LineStream(parse, largest_n)


class ForceLinesSettings(SerialForceSettings):
    """What the robot file says."""

    # Regular expression for a whole line, with a group (?P<value>...) and perhaps (?P<unit>...).
    pattern: Annotated[str, Field(min_length=1, max_length=MAX_PATTERN)]
    unit: Annotated[str | None, AfterValidator(known_unit)] = None  # unit of lines that name none
    scale: Positive = 1.0  # what a value is multiplied with before its unit; for its sign there is `reversed`
    capacity_n: Capacity  # from this force on the sensor is saturated [N]
    # What to send to make it stream, such as a carriage return.
    start: Annotated[str, Field(max_length=100)] = ""

    @field_validator("pattern")
    @classmethod
    def _compiles(cls, pattern: str) -> str:
        compile_pattern(pattern)
        return pattern


class ForceLines(SerialForceSensor):
    """A force sensor that writes lines, on a `serial_line`."""

    name = "force_lines"
    Settings = ForceLinesSettings
    _own: ForceLinesSettings

    def configure(self) -> None:
        """Start to listen. DeviceError: the port failed."""
        own = self._own
        stream = pattern_stream(own.pattern, own.unit, own.scale, 1e9)
        self._bus.listen(stream, own.capacity_n)
        if own.start:
            self._bus.write(own.start.encode("ascii", "replace"))
