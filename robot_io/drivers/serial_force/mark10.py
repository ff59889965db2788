"""Mark-10 force gauges (Series 5 and 7, indicators 7i): asked for each reading, which comes with its unit.

Source: Mark-10, "Series 7 Digital Force Gauges User's Guide" and "Model 7i User's Guide", 14.6, Gauge Control
Language 2: commands end with CR, answers with CR LF; settings are not answered, errors are a star and a
number. Compression is positive. Example of a reading: "-18.78 lbF".
"""

import re
from contextlib import suppress

from robot_io.drivers.serial_force.poll import Poll
from robot_io.drivers.serial_force.sensor import SerialForceSensor, SerialForceSettings
from robot_io.drivers.serial_force.text import LineStream, newtons_per, text_of
from robot_io.errors import ProtocolError
from robot_io.examination import Examinable
from robot_io.files.file_model import Capacity

ASK = b"?C\r"  # the current reading, whatever is displayed
# No readings unasked, units with readings, no peak on the display, and no switching off by itself.
SET_UP = b"AOUT0\rFULL\rCUR\rAOFF0\r"
SIGNS = b"\rIPOL0\rOPOL0\r"  # signs neither inverted nor left out; firmware that knows none does neither
ASK_MODEL = b"RM\r"
ERRORS = {10: "illegal command", 11: "not applicable", 12: "invalid specifier", 22: "value too large"}

_READING = re.compile(r"([+-]?[0-9]{0,7}\.?[0-9]{1,6}) ([A-Za-z]{1,8})")
_ERROR = re.compile(r"\*([0-9]{2})")
_ANSWER_S, _TWICE = 0.3, 2


def reading_of(line: str) -> tuple[str, str]:
    """The number as it is written, and its unit. ProtocolError: it is no reading."""
    found = _READING.fullmatch(line)
    if found is None:
        raise ProtocolError(f"no reading: '{line[:40]}'")
    return found[1], found[2]


class Mark10Stream(LineStream):
    """Readings in one unit, as the gauge writes it; a gauge that has gone over to another one complains.

    Twice the gauge's capacity [N] is not accepted as a reading. Its model is the answer to the marker of the
    poll, and readings before it are left out. ProtocolError: the unit is none of force.
    """

    def __init__(self, unit: str, capacity_n: float, model: str, poll: Poll) -> None:
        super().__init__(self._in_unit, 2.0 * capacity_n, from_beginning=True)
        self._model, self._poll = model.encode("ascii"), poll
        self._unit, self._newtons = unit, newtons_per(unit)
        self._other, self._others = "", 0  # so many readings in another unit in a row
        self.complaint = ""

    def _take(self, line: bytes, samples: list[float]) -> None:
        if line.rstrip().endswith(self._model):  # perhaps behind a reading that has lost its end
            self._poll.marked()
            samples.clear()
        else:
            super()._take(line, samples)

    def _in_unit(self, line: str) -> tuple[str, float]:
        if found := _ERROR.fullmatch(line):
            self.complaint = f"the gauge says '{error_name(int(found[1]))}'"
        number, unit = reading_of(line)
        if unit != self._unit:
            self._others = self._others + 1 if unit == self._other else 1
            self._other = unit
            if self._others >= _TWICE:  # no damaged letter
                self.complaint = f"the gauge reads in {unit}, and read in {self._unit} when it was configured"
            raise ProtocolError(f"in {unit} in place of {self._unit}")
        self._others, self.complaint = 0, ""
        return number, self._newtons


def error_name(code: int) -> str:
    """What an error code means."""
    return f"*{code} {ERRORS.get(code, 'unknown error')}"


class Mark10Settings(SerialForceSettings):
    """What the robot file says."""

    capacity_n: Capacity  # capacity of the gauge [N]


class Mark10(SerialForceSensor, Examinable):
    """A gauge on a `serial_line`."""

    name = "mark10"
    Settings = Mark10Settings
    _own: Mark10Settings

    def configure(self) -> None:
        """Set the gauge up, and ask it. DeviceError: no answer, an error, or a unit that is none of force."""
        self._ask(SIGNS + ASK, "an answer", but=_ERROR)
        model = self._ask(SET_UP + ASK_MODEL, "its model", but=_READING)  # of a stream that has ended now
        line = self._ask(ASK, "a reading")
        try:
            _, unit = reading_of(line)
            poll = Poll(ASK, ASK_MODEL)
            stream = Mark10Stream(unit, self._own.capacity_n, model, poll)
        except ProtocolError as error:
            raise self._error(str(error)) from error
        self._found = f"{model}, reads in {unit}, {self._own.capacity_n:.4g} N by the robot file"
        self._bus.listen(stream, self._own.capacity_n, poll=poll)

    def _ask(self, commands: bytes, what: str, but: re.Pattern[str] | None = None) -> str:
        """The first line of an answer that is none of `but`. DeviceError: none came, or an error."""

        def take(line: bytes) -> str | None:
            text = _text(line)
            return text if text and not (but and but.fullmatch(text)) else None

        answer = self._ask_line(commands, take, _ANSWER_S)
        if answer is None:
            raise self._error(f"no gauge says {what}; check port and baud rate")
        if found := _ERROR.fullmatch(answer):
            said = error_name(int(found[1]))
            raise self._error(f"the gauge says '{said}' when asked for {what}")
        return answer


def _text(line: bytes) -> str:
    with suppress(ProtocolError):
        return text_of(line)
    return ""
