"""Loadstar DI-100 and DI-1000 load cell interfaces: ASCII commands and lines of readings.

Source: Loadstar Sensors, "DI-100U / DI-1000U Command Set" and "DI-1000HS-1K Output Formats"
(loadstarsensors.com): a command ends with CR, an answer with CR LF; CR alone is answered with A and ends a
stream; readings come as decimal numbers in the unit that UNITS answers.
"""

import re

from pydantic import StrictBool

from robot_io.drivers.serial_force.sensor import SerialForceSensor, SerialForceSettings
from robot_io.drivers.serial_force.text import LineStream, newtons_per, text_of
from robot_io.errors import ProtocolError
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
            raise self._error(str(error)) from error
        if abs(capacity_n - self._own.capacity_n) > 0.01 * self._own.capacity_n:
            raise self._error(
                f"the interface is set for a load cell of {capacity_n:.4g} N, "
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
            if self._ask_line(PING, lambda line: line.strip() == YES.encode() or None, _ANSWER_S):
                return
        raise self._error("no DI-100 or DI-1000 answers; check port and baud rate")

    def _ask(self, question: bytes, *, may_be_yes: bool = False) -> str:
        """The answer; a yes that nobody asked for is a late one to the ping. DeviceError: none, or a no."""

        def take(line: bytes) -> str | None:
            text = text_of(line)
            return text if text and (may_be_yes or text != YES) else None

        answer = self._ask_line(question, take, _ANSWER_S)
        if answer is None:
            raise self._error(f"no answer to {question.decode().strip()}")
        if answer == NO:
            raise self._error(f"the interface does not know {question.decode().strip()}")
        return answer
