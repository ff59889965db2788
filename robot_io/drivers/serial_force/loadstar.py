"""Loadstar DI-100 and DI-1000 load cell interfaces: ASCII commands and lines of readings.

Source: Loadstar Sensors, "DI-100U / DI-1000U Command Set" and "DI-1000HS-1K Output Formats"
(loadstarsensors.com): a command ends with CR, an answer with CR LF; CR alone is answered with A and ends a
stream; readings come as decimal numbers in the unit that UNITS answers.
"""

import re

from pydantic import StrictBool

from robot_io.drivers.serial_force.sensor import SerialForceSensor, SerialForceSettings
from robot_io.drivers.serial_force.text import LineSplitter, LineStream, newtons_per, text_of
from robot_io.errors import DeviceError, ProtocolError
from robot_io.examination import Examinable
from robot_io.files.file_model import Capacity

PING, YES, NO = b"\r", "A", "?"
ASK_MODEL, ASK_UNITS, ASK_CAPACITY = b"MODEL\r", b"UNITS\r", b"LC\r"
TARE, STREAM, STOP = b"CT0\r", b"WC\r", b"\r"
MODELS = ("DI-1000", "DI-100")

_NUMBER = re.compile(r"[+-]?([0-9]{1,9}(\.[0-9]{0,9})?|\.[0-9]{1,9})")
_ANSWER_S = 0.3
_PINGS = 4


def model_of(answer: str) -> str:
    """Which interface answered MODEL. ProtocolError: an unknown one."""
    for model in MODELS:
        if model in answer.upper():
            return model
    raise ProtocolError(f"model '{answer[:40]}' is not a {' or '.join(MODELS)}")


def unit_of(answer: str) -> float:
    """Newtons in one unit of the readings, from the answer to UNITS. ProtocolError: not a unit of force."""
    words = answer.split()
    return newtons_per(words[-1] if words else "")


def number_of(text: str) -> float:
    """A decimal number as the interface writes it. ProtocolError: it is not one."""
    if not _NUMBER.fullmatch(text.strip()):
        raise ProtocolError(f"not a number: '{text[:40]}'")
    return float(text)


def loadstar_stream(newtons_per_unit: float, capacity_n: float) -> LineStream:
    """Readings of the continuous mode; twice the capacity [N] is not accepted as a reading."""

    def parse(line: str) -> tuple[str, float]:
        number_of(line)
        return line, newtons_per_unit

    return LineStream(parse, 2.0 * capacity_n)


class LoadstarSettings(SerialForceSettings):
    """What the robot file says."""

    capacity_n: Capacity  # capacity of the load cell [N]; the interface must say the same within 1 %
    tare: StrictBool = False  # whether to zero it when the robot is configured; nothing must touch it then


class Loadstar(SerialForceSensor, Examinable):
    """A load cell in continuous mode, on a `serial_line`. Unit and capacity are read from the interface."""

    name = "loadstar"
    Settings = LoadstarSettings
    end_of_stream = STOP
    _own: LoadstarSettings

    def configure(self) -> None:
        """Check model, unit and capacity, and start the stream. DeviceError: no answer, or another device."""
        self._wake()
        try:
            model = model_of(self._ask(ASK_MODEL))
            unit = self._ask(ASK_UNITS)
            newtons_per_unit = unit_of(unit)
            capacity_n = number_of(self._ask(ASK_CAPACITY).split()[0]) * newtons_per_unit
        except ProtocolError as error:
            raise DeviceError(f"{self._bus.label}: {error}") from error
        if abs(capacity_n - self._own.capacity_n) > 0.01 * self._own.capacity_n:
            raise DeviceError(
                f"{self._bus.label}: the interface is set for a load cell of {capacity_n:.4g} N, "
                f"the robot file says {self._own.capacity_n:.4g} N"
            )
        self._found = f"{model}, counts in {unit.split()[-1]}, load cell of {capacity_n:.4g} N"
        if self._own.tare:
            self._ask(TARE, may_be_yes=True)
        self._bus.listen(loadstar_stream(newtons_per_unit, capacity_n), self._own.capacity_n)
        self._bus.write(STREAM)

    def _wake(self) -> None:
        """End a stream that may still run; then it answers to a ping."""
        for _ in range(_PINGS):
            lines = LineSplitter()

            def pong(data: bytes, lines: LineSplitter = lines) -> bool | None:
                return True if YES.encode() in [line.strip() for line in lines.feed(data)] else None

            if self._bus.ask(PING, pong, _ANSWER_S):
                return
        raise DeviceError(f"{self._bus.label}: no DI-100 or DI-1000 answers; check port and baud rate")

    def _ask(self, question: bytes, *, may_be_yes: bool = False) -> str:
        """The answer; a yes that nobody asked for is a late one to the ping. DeviceError: none, or a no."""
        lines = LineSplitter()

        def first_line(data: bytes) -> str | None:
            complete = [text_of(line) for line in lines.feed(data)]
            return next((line for line in complete if line and (may_be_yes or line != YES)), None)

        answer = self._bus.ask(question, first_line, _ANSWER_S)
        if answer is None:
            raise DeviceError(f"{self._bus.label}: no answer to {question.decode().strip()}")
        if answer == NO:
            raise DeviceError(f"{self._bus.label}: the interface does not know {question.decode().strip()}")
        return answer
