"""Lorenz Messtechnik force sensors with a digital interface (LCV-USB2 and kin)."""

from typing import Annotated

from pydantic import AfterValidator, Field, field_validator

from robot_io.drivers.serial_force import lorenz_protocol as lorenz
from robot_io.drivers.serial_force.lorenz_protocol import LorenzCommand, LorenzStream, Telegram
from robot_io.drivers.serial_force.sensor import SerialForceSensor, SerialForceSettings
from robot_io.drivers.serial_force.text import known_unit, newtons_per
from robot_io.errors import DeviceError, ProtocolError
from robot_io.examination import Examinable
from robot_io.files.file_model import Positive

_ANSWER_S = 0.3


class LorenzSettings(SerialForceSettings):
    """What the robot file says: the data sheet's values, and the sensor's own codes, which must agree."""

    nominal_load: Annotated[Positive, Field(le=1e6)]  # nominal load, in `unit`
    unit: Annotated[str, AfterValidator(known_unit)]  # unit of the nominal load
    counts_at_nominal: Annotated[Positive, Field(le=32767)]  # counts at nominal load
    # The sensor's code of its unit; the error of a first try with any code shows it.
    dimension_code: Annotated[int, Field(ge=0, le=255, strict=True)]
    load_code: Annotated[int, Field(ge=0, le=65535, strict=True)]  # the sensor's code of its nominal load
    rate_hz: Annotated[int, Field(strict=True)] = 1000  # samples a second
    address: Annotated[int, Field(ge=1, le=254, strict=True)] = 1  # bus address of the sensor

    @field_validator("rate_hz")
    @classmethod
    def _exists(cls, rate_hz: int) -> int:
        if rate_hz not in lorenz.SAMPLE_RATE_CODES:
            raise ValueError(f"valid are {', '.join(map(str, lorenz.SAMPLE_RATE_CODES))}")
        return rate_hz

    @property
    def nominal_n(self) -> float:
        """Nominal load [N]."""
        return self.nominal_load * newtons_per(self.unit)


class Lorenz(SerialForceSensor, Examinable):
    """A Lorenz sensor in its speed-optimised stream.

    Which sensor it is comes from its configuration, in telegrams with checksums; the stream itself has none.
    """

    name = "lorenz"
    Settings = LorenzSettings
    end_of_stream = lorenz.STOP_STREAM
    _own: LorenzSettings

    def configure(self) -> None:
        """Check which sensor it is, and start the stream.

        DeviceError: it does not answer, or is another one.
        """
        own = self._own
        self._bus.write(lorenz.STOP_STREAM)
        self._greet()
        block = bytes((lorenz.ROTOR_HEADER_BLOCK,))
        answer = self._ask(LorenzCommand.READ_CONFIG, block, LorenzCommand.READ_CONFIG)
        try:
            header = lorenz.decode_header_block(answer.parameters)
        except ProtocolError as error:
            raise self._error(str(error)) from error
        if (header.dimension_code, header.load_code) != (own.dimension_code, own.load_code):
            raise self._error(
                f"sensor {header.serial_number} has dimension_code "
                f"{header.dimension_code} and load_code {header.load_code}, the robot file says "
                f"{own.dimension_code} and {own.load_code}"
            )
        self._found = f"serial number {header.serial_number}, {own.nominal_n:.4g} N, {own.rate_hz} samples/s"
        self._command(lorenz.encode_start_stream(own.address, own.rate_hz), LorenzCommand.ACK, "the stream")
        stream = LorenzStream(own.nominal_n / own.counts_at_nominal)
        self._bus.listen(stream, own.nominal_n, held_back_s=1.0 / own.rate_hz)

    def _greet(self) -> None:
        """Say hello, twice if need be: what ended a stream may have spoilt the first telegram after it."""
        try:
            self._ask(LorenzCommand.HELLO, b"", LorenzCommand.HELLO)
        except DeviceError:
            self._ask(LorenzCommand.HELLO, b"", LorenzCommand.HELLO)

    def _ask(self, command: LorenzCommand, parameters: bytes, expected: LorenzCommand) -> Telegram:
        data = lorenz.encode_telegram(Telegram(command, self._own.address, lorenz.HOST, parameters))
        return self._command(data, expected, command.name)

    def _command(self, data: bytes, expected: LorenzCommand, what: str) -> Telegram:
        reader = lorenz.TelegramReader()

        def answer(received: bytes) -> Telegram | None:
            from_sensor = (t for t in reader.feed(received) if t.sender == self._own.address)
            return next((t for t in from_sensor if t.command in (expected, LorenzCommand.NACK)), None)

        telegram = self._bus.ask(data, answer, _ANSWER_S)
        if telegram is None:
            damaged = f" ({reader.rejected} damaged telegrams)" if reader.rejected else ""
            raise self._error(f"no answer to {what}{damaged}; check port, baud rate and address")
        if telegram.command != expected:
            raise self._error(f"the sensor refuses {what}, error {list(telegram.parameters)}")
        return telegram
