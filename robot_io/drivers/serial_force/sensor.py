"""What every force sensor on a `serial_line` has in common."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import ClassVar, Literal

from pydantic import StrictBool

from robot_io.driver import DriverContext
from robot_io.drivers.serial_force.line import Answer, ForceLine, SerialLine
from robot_io.drivers.serial_force.text import LineSplitter
from robot_io.errors import DeviceError
from robot_io.examination import Finding, ok
from robot_io.files.file_model import Capacity, FileModel
from robot_io.interfaces import ForceSensor
from robot_io.types import Reading


class SerialForceSettings(FileModel):
    """What the robot file says; a sensor adds its own."""

    reversed: StrictBool = False  # whether the sensor counts tension as positive


class AxisForceSettings(SerialForceSettings):
    """One axis of a sensor of forces and torques."""

    axis: Literal["x", "y", "z"]  # of the sensor, along which the tool pushes
    capacity_n: Capacity  # of this axis [N]


class SerialForceSensor(ForceSensor):
    """A force sensor on a line of its own; one that can be asked who it is, is `Examinable` as well."""

    Settings: ClassVar[type[SerialForceSettings]]
    line_type: ClassVar[type[ForceLine]] = SerialLine
    end_of_stream: ClassVar[bytes] = b""  # what ends its stream, if it must be told

    _own: SerialForceSettings

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(self.Settings, settings)
        self._bus = context.bus_as(self.line_type)
        self._found = ""  # who answered

    def _ask_line(
        self, question: bytes, take: Callable[[bytes], Answer | None], timeout_s: float
    ) -> Answer | None:
        """What `take` makes of the first line of an answer that it takes; None where none comes in time."""
        lines = LineSplitter()

        def first(data: bytes) -> Answer | None:
            return next((found for line in lines.feed(data) if (found := take(line)) is not None), None)

        return self._bus.ask(question, first, timeout_s)

    def _error(self, problem: str) -> DeviceError:
        return DeviceError(f"{self._bus.label}: {problem}")

    def examine(self) -> tuple[Finding, ...]:
        """Who answered in `configure`."""
        return (ok("force sensor", self._found),) if self._found else ()

    def close(self) -> None:
        """End the stream."""
        if self.end_of_stream:
            with suppress(DeviceError):  # it is gone, or was never there: nothing to end
                self._bus.write(self.end_of_stream)

    def read_force(self) -> Reading:
        return self._bus.reading(reversed_sign=self._own.reversed)
