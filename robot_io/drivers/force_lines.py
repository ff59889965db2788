"""Any force gauge that writes one line a sample: Mark-10, OpenScale, a microcontroller ..."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field, StrictBool, field_validator

from robot_io.driver import DriverContext
from robot_io.drivers.serial_line import SerialLine
from robot_io.errors import ProtocolError
from robot_io.files.file_model import FileModel, Positive
from robot_io.interfaces import ForceSensor
from robot_io.serial_force import newtons_per
from robot_io.serial_force.pattern import MAX_PATTERN, PatternStream, compile_pattern
from robot_io.types import Reading


class ForceLinesSettings(FileModel):
    """What the robot file says.

    Attributes:
        pattern: regular expression for a whole line, with a group (?P<value>...) and perhaps (?P<unit>...).
        unit: unit of lines that name none.
        scale: what a value is multiplied with before its unit; for its sign there is `reversed`.
        capacity_n: from this force on the sensor is saturated [N].
        reversed: whether the sensor counts tension as positive.
        start: what to send to make it stream, such as a carriage return.
    """

    pattern: Annotated[str, Field(min_length=1, max_length=MAX_PATTERN)]
    unit: str | None = None
    scale: Positive = 1.0
    capacity_n: Positive
    reversed: StrictBool = False
    start: Annotated[str, Field(max_length=100)] = ""

    @field_validator("pattern")
    @classmethod
    def _compiles(cls, pattern: str) -> str:
        compile_pattern(pattern)
        return pattern

    @field_validator("unit")
    @classmethod
    def _is_a_force(cls, unit: str | None) -> str | None:
        if unit is not None:
            try:
                newtons_per(unit)
            except ProtocolError as error:
                raise ValueError(str(error)) from error
        return unit


class ForceLines(ForceSensor):
    """A force sensor that writes lines.

    Args:
        settings: as `ForceLinesSettings`.
        context: must hold a `serial_line`.
    """

    name: ClassVar[str] = "force_lines"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(ForceLinesSettings, settings)
        self._bus = context.bus_as(SerialLine)

    def configure(self) -> None:
        """Start to listen.

        Raises:
            DeviceError: the port failed.
        """
        own = self._own
        self._bus.listen(PatternStream(compile_pattern(own.pattern), own.unit, own.scale))
        if own.start:
            self._bus.write(own.start.encode("ascii", "replace"))

    def read_force(self) -> Reading:
        """See `ForceSensor.read_force`."""
        return self._bus.reading(reversed_sign=self._own.reversed, capacity_n=self._own.capacity_n)
