"""Loadstar DI-100 and DI-1000 load cell interfaces."""

from collections.abc import Mapping
from typing import ClassVar

from pydantic import StrictBool

from robot_io.driver import DriverContext
from robot_io.drivers.serial_line import SerialLine
from robot_io.errors import DeviceError, ProtocolError
from robot_io.examination import Examinable, Observation
from robot_io.files.file_model import FileModel, Positive
from robot_io.interfaces import ForceSensor
from robot_io.serial_force import LineSplitter, loadstar
from robot_io.types import Reading

_ANSWER_S = 0.3
_PINGS = 4


class LoadstarSettings(FileModel):
    """What the robot file says.

    Attributes:
        capacity_n: capacity of the load cell [N]; the interface must say the same within 1 %.
        reversed: whether the load cell counts tension as positive.
        tare: whether to zero it when the robot is configured; nothing must touch it then.
    """

    capacity_n: Positive
    reversed: StrictBool = False
    tare: StrictBool = False


class Loadstar(ForceSensor, Examinable):
    """A load cell on a DI-100 or DI-1000, in continuous mode. Unit and capacity are read from the interface.

    Args:
        settings: as `LoadstarSettings`.
        context: must hold a `serial_line`.
    """

    name: ClassVar[str] = "loadstar"

    def __init__(self, settings: Mapping[str, object], context: DriverContext) -> None:
        self._own = context.settings_as(LoadstarSettings, settings)
        self._bus = context.bus_as(SerialLine)
        self._found = ""

    def configure(self) -> None:
        """Check model, unit and capacity, and start the stream.

        Raises:
            DeviceError: it does not answer, or is another one.
        """
        self._wake()
        try:
            model = loadstar.model_of(self._ask(loadstar.ASK_MODEL))
            unit = self._ask(loadstar.ASK_UNITS)
            newtons_per_unit = loadstar.unit_of(unit)
            capacity = self._ask(loadstar.ASK_CAPACITY)
            capacity_n = loadstar.number_of(capacity.split()[0]) * newtons_per_unit
        except ProtocolError as error:
            raise DeviceError(f"{self._bus.label}: {error}") from error
        if abs(capacity_n - self._own.capacity_n) > 0.01 * self._own.capacity_n:
            raise DeviceError(
                f"{self._bus.label}: the interface is set for a load cell of {capacity_n:.4g} N, "
                f"the robot file says {self._own.capacity_n:.4g} N"
            )
        self._found = f"{model}, counts in {unit.split()[-1]}, load cell of {capacity_n:.4g} N"
        if self._own.tare:
            self._ask(loadstar.TARE)
        self._bus.listen(loadstar.LoadstarStream(newtons_per_unit, capacity_n))
        self._bus.write(loadstar.STREAM)

    def examine(self) -> tuple[Observation, ...]:
        """See `Examinable.examine`."""
        return (Observation("force sensor", self._found),) if self._found else ()

    def close(self) -> None:
        """End the stream."""
        try:
            self._bus.write(loadstar.STOP)
        except DeviceError:
            return  # it is gone, or was never there: nothing to end

    def read_force(self) -> Reading:
        """See `ForceSensor.read_force`."""
        return self._bus.reading(reversed_sign=self._own.reversed, capacity_n=self._own.capacity_n)

    def _wake(self) -> None:
        """End a stream that may still run; then it answers to a ping."""
        for _ in range(_PINGS):
            lines = LineSplitter()

            def pong(data: bytes, lines: LineSplitter = lines) -> bool | None:
                return True if loadstar.PONG.encode() in [line.strip() for line in lines.feed(data)] else None

            if self._bus.ask(loadstar.PING, pong, _ANSWER_S):
                return
        raise DeviceError(f"{self._bus.label}: no DI-100 or DI-1000 answers; check port and baud rate")

    def _ask(self, question: bytes) -> str:
        lines = LineSplitter()

        def first_line(data: bytes) -> str | None:
            complete = [loadstar.text_of(line) for line in lines.feed(data)]
            return next((line for line in complete if line and line != loadstar.PONG), None)

        answer = self._bus.ask(question, first_line, _ANSWER_S)
        if answer is None:
            raise DeviceError(f"{self._bus.label}: no answer to {question.decode().strip()}")
        return answer
