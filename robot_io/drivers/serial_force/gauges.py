"""Force gauges that send text: generic gauges with one line per sample, Loadstar DI-100/1000, and Mark-10.

Loadstar: Loadstar Sensors, "DI-100U / DI-1000U Command Set" and "DI-1000HS-1K Output Formats"
(loadstarsensors.com): a command ends with CR, an answer with CR LF; CR alone is answered with A and ends a
stream; readings come as decimal numbers in the unit that UNITS answers.

Mark-10 (Series 5 and 7, indicators 7i) is asked for each reading: Mark-10, "Series 7 Digital Force Gauges
User's Guide" and "Model 7i User's Guide", 14.6, Gauge Control Language 2: commands end with CR, answers with
CR LF; settings are not answered, errors are a star and a number. Compression is positive. Example of a
reading: "-18.78 lbF".
"""

import re
from contextlib import suppress
from functools import lru_cache, partial
from timeit import repeat
from typing import Annotated

from pydantic import AfterValidator, Field, StrictBool, field_validator

from palpate.robot_io.drivers.serial_force.line import SerialForceSensor, SerialForceSettings
from palpate.robot_io.drivers.serial_force.stream import (
    MAX_LINE,
    LineStream,
    Poll,
    check_unit,
    decode_text,
    newtons_per,
)
from palpate.robot_io.errors import InputError, ProtocolError
from palpate.robot_io.examination import Examinable
from palpate.robot_io.files.file_model import Capacity, Positive

MAX_PATTERN = 200
_REPEATED_GROUP = re.compile(r"\)[*+{]")  # its time can grow exponentially with the length of a line
# Lines of noise on which patterns backtrack, by their repeated part, and how long one may take: meanwhile no
# other thread runs, not even the control loop.
_NOISE = ("1", "a", " ", "-", ".", ",", ";", "1 ", "1,", "1.", "1;", "a ", "a1", "1 N ")
_SLOWEST_MATCH_S = 0.01


@lru_cache(maxsize=16)
def compile_pattern(pattern: str) -> re.Pattern[str]:
    """Compile a pattern that must match a whole line, with a group `value` and perhaps a group `unit`.

    Args:
        pattern: regular expression.

    Raises:
        InputError: the pattern is not a regular expression, lacks `value`, or has a repeated group, or a line
            of noise takes it so long that the control loop would stall.
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
        raise InputError(f"pattern '{pattern}': repeats a group, and matching it may never end")
    for halvings in range(6, -1, -1):  # short first: a line may take hours
        length = MAX_LINE >> halvings
        for text in _NOISE:
            match = partial(compiled.fullmatch, (text * length)[:length])
            match_s = min(repeat(match, number=1, repeat=3))
            if match_s > _SLOWEST_MATCH_S:
                raise InputError(
                    f"pattern '{pattern}': matching a line of {length} characters, '{text * 3}...', takes "
                    f"{1e3 * match_s:.0f} ms; use fewer parts with * or + that can match the same characters"
                )
    return compiled


_NO_LIMIT_N = 1e9  # the capacity of the sensor is unknown


def pattern_stream(pattern: str, unit: str | None, scale: float) -> LineStream:
    """Make a stream of readings from lines that match `pattern`, see `compile_pattern`.

    Lines without a unit are in `unit`; if that is None, they are rejected.

    Args:
        pattern: regular expression of a line.
        unit: unit of lines without a unit, or None.
        scale: factor applied to a value.
    """
    compiled = compile_pattern(pattern)
    stated = None if unit is None else newtons_per(unit)

    def parse(line: str) -> tuple[str, float]:
        match = compiled.fullmatch(line)
        if match is None:
            raise ProtocolError(f"does not match the pattern: '{line[:60]}'")
        groups = match.groupdict()
        newtons = newtons_per(groups["unit"]) if groups.get("unit") else stated
        if newtons is None:
            raise ProtocolError(f"reading without a unit, and the robot file states none: '{line[:60]}'")
        return groups["value"] or "", newtons * scale

    return LineStream(parse, _NO_LIMIT_N)


class ForceLinesSettings(SerialForceSettings):
    """Settings in the robot file."""

    # Regular expression for a whole line, with a group (?P<value>...) and perhaps (?P<unit>...).
    pattern: Annotated[str, Field(min_length=1, max_length=MAX_PATTERN)]
    unit: Annotated[str | None, AfterValidator(check_unit)] = None  # unit of lines without a unit
    scale: Positive = 1.0  # factor applied to a value; `reversed` sets its sign
    capacity_n: Capacity  # force from which the sensor is saturated [N]
    # Command that starts the stream, such as a carriage return.
    start: Annotated[str, Field(max_length=100)] = ""

    @field_validator("pattern")
    @classmethod
    def _check_pattern(cls, pattern: str) -> str:
        compile_pattern(pattern)
        return pattern


class ForceLines(SerialForceSensor):
    """A force sensor that writes lines, on a `serial_line`."""

    name = "force_lines"
    Settings = ForceLinesSettings
    _settings: ForceLinesSettings

    def configure(self) -> None:
        """Start to listen; raise `DeviceError` if the port failed."""
        settings = self._settings
        stream = pattern_stream(settings.pattern, settings.unit, settings.scale)
        self._bus.listen(stream, settings.capacity_n)
        if settings.start:
            self._bus.write(settings.start.encode("ascii", "replace"))


PING, YES, NO = b"\r", "A", "?"
ASK_MODEL, ASK_UNITS, ASK_CAPACITY = b"MODEL\r", b"UNITS\r", b"LC\r"
TARE, STREAM, STOP = b"CT0\r", b"WC\r", b"\r"
MODELS = ("DI-1000", "DI-100")

_NUMBER = re.compile(r"[+-]?([0-9]{1,9}(\.[0-9]{0,9})?|\.[0-9]{1,9})")
_ANSWER_S = 0.3
_PINGS = 4


def parse_model(answer: str) -> str:
    """Return the interface model from the answer to MODEL.

    Args:
        answer: text of the answer; the model may be part of it, in any case.

    Raises:
        ProtocolError: the answer names none of `MODELS`.
    """
    for model in MODELS:
        if model in answer.upper():
            return model
    raise ProtocolError(f"model '{answer[:40]}' is not a {' or '.join(MODELS)}")


def parse_number(text: str) -> float:
    """Parse a decimal number in the interface's format.

    Args:
        text: the number, which may be surrounded by white space.

    Raises:
        ProtocolError: the text is not one number.
    """
    if not _NUMBER.fullmatch(text.strip()):
        raise ProtocolError(f"not a number: '{text[:40]}'")
    return float(text)


def loadstar_stream(newtons_per_unit: float, capacity_n: float) -> LineStream:
    """Make a stream of readings in continuous mode; twice the capacity [N] is not accepted as a reading.

    Args:
        newtons_per_unit: newtons in one unit of the readings.
        capacity_n: of the load cell [N].
    """

    def parse(line: str) -> tuple[str, float]:
        parse_number(line)
        return line, newtons_per_unit

    return LineStream(parse, 2.0 * capacity_n)


class LoadstarSettings(SerialForceSettings):
    """Settings in the robot file."""

    capacity_n: Capacity  # capacity of the load cell [N]; the interface must report the same within 1 %
    tare: StrictBool = False  # whether to zero it when the robot is configured; nothing must touch it then


class Loadstar(SerialForceSensor, Examinable):
    """A load cell in continuous mode, on a `serial_line`. Unit and capacity are read from the interface."""

    name = "loadstar"
    Settings = LoadstarSettings
    end_of_stream = STOP
    _settings: LoadstarSettings

    def configure(self) -> None:
        """Check model, unit and capacity; start the stream; raise `DeviceError` without a valid answer."""
        # End a stream that may still run; then the interface answers a ping.

        def is_yes(line: bytes) -> bool | None:
            return line.strip() == YES.encode() or None

        if not any(self._ask_line(PING, is_yes, _ANSWER_S) for _ in range(_PINGS)):
            raise self._error("no DI-100 or DI-1000 answers; check port and baud rate")
        try:
            model = parse_model(self._ask(ASK_MODEL))
            unit = (self._ask(ASK_UNITS).split() or [""])[-1]
            newtons_per_unit = newtons_per(unit)
            capacity_n = parse_number(self._ask(ASK_CAPACITY).split()[0]) * newtons_per_unit
        except ProtocolError as error:
            raise self._error(str(error)) from error
        if abs(capacity_n - self._settings.capacity_n) > 0.01 * self._settings.capacity_n:
            raise self._error(
                f"the interface is set for a load cell of {capacity_n:.4g} N, "
                f"but the robot file states {self._settings.capacity_n:.4g} N"
            )
        self._identified = f"{model}, counts in {unit}, load cell of {capacity_n:.4g} N"
        if self._settings.tare:
            self._ask(TARE, may_be_yes=True)
        self._bus.listen(loadstar_stream(newtons_per_unit, capacity_n), self._settings.capacity_n)
        self._bus.write(STREAM)

    def _ask(self, question: bytes, *, may_be_yes: bool = False) -> str:
        """Return the answer; raise `DeviceError` if it is negative or missing."""
        # An unexpected "yes" is a late answer to the ping, and is skipped.

        def take(line: bytes) -> str | None:
            text = decode_text(line)
            return text if text and (may_be_yes or text != YES) else None

        answer = self._ask_line(question, take, _ANSWER_S)
        if answer is None:
            raise self._error(f"no answer to {question.decode().strip()}")
        if answer == NO:
            raise self._error(f"the interface does not recognize {question.decode().strip()}")
        return answer


ASK = b"?C\r"  # the current reading, independent of the display
# No unsolicited readings, units with readings, no peak on the display, no automatic shutoff.
SET_UP = b"AOUT0\rFULL\rCUR\rAOFF0\r"
SIGNS = b"\rIPOL0\rOPOL0\r"  # signs neither inverted nor left out, as in firmware without these commands
ASK_GAUGE_MODEL = b"RM\r"
ERRORS = {10: "illegal command", 11: "not applicable", 12: "invalid specifier", 22: "value too large"}

_READING = re.compile(r"([+-]?[0-9]{0,7}\.?[0-9]{1,6}) ([A-Za-z]{1,8})")
_ERROR = re.compile(r"\*([0-9]{2})")
_GAUGE_ANSWER_S, _TWICE = 0.3, 2


def parse_reading(line: str) -> tuple[str, str]:
    """Return the number as text, and its unit; raise `ProtocolError` if the line is not a reading.

    Args:
        line: received line.
    """
    match = _READING.fullmatch(line)
    if match is None:
        raise ProtocolError(f"not a reading: '{line[:40]}'")
    return match[1], match[2]


class Mark10Stream(LineStream):
    """Readings in one unit, as the gauge writes it; a change of the unit is reported as an error.

    Readings above twice the gauge's capacity [N] are rejected. The model is the answer to the poll's marker,
    and readings before it are left out; raise `ProtocolError` if the unit is not a unit of force.
    """

    poll: Poll

    def __init__(self, unit: str, capacity_n: float, model: str, poll: Poll) -> None:
        super().__init__(self._in_unit, 2.0 * capacity_n, from_beginning=True)
        self._model, self.poll = model.encode("ascii"), poll
        self._unit, self._newtons = unit, newtons_per(unit)
        self._new_unit, self._new_unit_count = "", 0  # consecutive readings in another unit

    def _parse_line(self, line: bytes, samples: list[float]) -> None:
        if line.rstrip().endswith(self._model):  # may follow a reading that has lost its end
            self.poll.marked()
            samples.clear()
        else:
            super()._parse_line(line, samples)

    def _in_unit(self, line: str) -> tuple[str, float]:
        if error := _ERROR.fullmatch(line):
            self.fault_text = f"the gauge says '{_error_name(int(error[1]))}'"
        number, unit = parse_reading(line)
        if unit != self._unit:
            self._new_unit_count = self._new_unit_count + 1 if unit == self._new_unit else 1
            self._new_unit = unit
            if self._new_unit_count >= _TWICE:  # not just a damaged letter
                self.fault_text = f"the gauge reads in {unit}; when configured, it read in {self._unit}"
            raise ProtocolError(f"reading in {unit} instead of {self._unit}")
        self._new_unit_count, self.fault_text = 0, ""
        return number, self._newtons


def _error_name(code: int) -> str:
    return f"*{code} {ERRORS.get(code, 'unknown error')}"


class Mark10Settings(SerialForceSettings):
    """Settings in the robot file."""

    capacity_n: Capacity  # capacity of the gauge [N]


class Mark10(SerialForceSensor, Examinable):
    """A gauge on a `serial_line`."""

    name = "mark10"
    Settings = Mark10Settings
    _settings: Mark10Settings

    def configure(self) -> None:
        """Configure and identify the gauge; raise `DeviceError` on an error or without a unit of force."""
        self._ask(SIGNS + ASK, "an answer", but=_ERROR)
        model = self._ask(SET_UP + ASK_GAUGE_MODEL, "its model", but=_READING)
        line = self._ask(ASK, "a reading")
        try:
            _, unit = parse_reading(line)
            stream = Mark10Stream(unit, self._settings.capacity_n, model, Poll(ASK, ASK_GAUGE_MODEL))
        except ProtocolError as error:
            raise self._error(str(error)) from error
        self._identified = (
            f"{model}, reads in {unit}, {self._settings.capacity_n:.4g} N according to the robot file"
        )
        self._bus.listen(stream, self._settings.capacity_n)

    def _ask(self, commands: bytes, what: str, but: re.Pattern[str] | None = None) -> str:
        """Return the first answer line that is not in `but`; raise `DeviceError` on an error or silence."""

        def take(line: bytes) -> str | None:
            with suppress(ProtocolError):
                text = decode_text(line)
                return text if text and not (but and but.fullmatch(text)) else None
            return None

        answer = self._ask_line(commands, take, _GAUGE_ANSWER_S)
        if answer is None:
            raise self._error(f"no gauge gives {what}; check port and baud rate")
        if error := _ERROR.fullmatch(answer):
            problem = _error_name(int(error[1]))
            raise self._error(f"the gauge answers '{problem}' to a request for {what}")
        return answer
