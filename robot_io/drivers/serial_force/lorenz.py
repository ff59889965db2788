"""Lorenz Messtechnik sensors: telegrams with two checksums, which also start the fast stream.

A telegram is STX, command, receiver, sender, number of parameters, the parameters, checksum and weighted
checksum; an STX within it is sent twice. The checksum is the sum of the bytes; the weighted one sums the
running checksums, with the carry added back. Three STX end a stream.

Source: Lorenz Messtechnik, sensor interface protocol, as implemented by Duckle29/LorenzTelegram (facts:
layout, command numbers, checksums, stream mode 3, configuration blocks).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from math import inf, nan
from typing import Annotated

from pydantic import AfterValidator, Field, field_validator

from palpate.robot_io.drivers.serial_force.line import SerialForceSensor, SerialForceSettings
from palpate.robot_io.drivers.serial_force.stream import ReadingStream, SensorClock, check_unit, newtons_per
from palpate.robot_io.errors import DeviceError, InputError, ProtocolError
from palpate.robot_io.examination import Examinable
from palpate.robot_io.files.file_model import Positive

STX = 0x02
HOST = 0xFF
STOP_STREAM = bytes((STX, STX, STX))
ROTOR_HEADER_BLOCK = 128
ROTOR_HEADER_ID = 0x40
STREAM_MODE = 3
SAMPLE_RATE_CODES = {20: 250, 25: 200, 50: 100, 100: 50, 200: 25, 250: 20, 500: 10, 1000: 5, 1250: 4, 2500: 2}
_HEADER = 4  # bytes: command, receiver, sender, count
_BLOCK = 32  # bytes of a configuration block


class LorenzCommand(IntEnum):
    """Commands that are used here."""

    ACK = 0x06
    NACK = 0x15
    HELLO = 0x40
    READ_CONFIG = 0x44
    SPECIAL_MODE = 0x5A


@dataclass(frozen=True, slots=True)
class Telegram:
    """One telegram."""

    command: int  # command number
    receiver: int  # address of the receiver
    sender: int  # address of the sender
    parameters: bytes = b""  # up to 255 bytes


def checksums(content: bytes) -> tuple[int, int]:
    """Compute checksum and weighted checksum of a telegram's content, each from 0 to 255.

    Args:
        content: content of a telegram, between STX and the checksums.
    """
    plain = weighted = 0
    for byte in content:
        plain = (plain + byte) & 0xFF
        weighted += plain
        weighted = (weighted + (weighted > 0xFF)) & 0xFF
    return plain, weighted


def encode_telegram(telegram: Telegram) -> bytes:
    """Encode and stuff a telegram; raise `InputError` for more than 255 parameters.

    Args:
        telegram: telegram to send.
    """
    count = len(telegram.parameters)
    if count > 255:
        raise InputError(f"a telegram holds at most 255 parameters, not {count}")
    content = bytes((telegram.command, telegram.receiver, telegram.sender, count)) + telegram.parameters
    content += bytes(checksums(content))
    return bytes((STX,)) + content.replace(b"\x02", b"\x02\x02")


class TelegramReader:
    """Parser of telegrams from a byte stream, in any portions.

    A single STX always begins a telegram, even within another telegram that has lost its end.

    Attributes:
        rejected: telegrams that were broken off or had a wrong checksum.
    """

    def __init__(self) -> None:
        self._content: bytearray | None = None  # bytes since STX, unstuffed; None while waiting for STX
        self._half_stuffed = False
        self.rejected = 0

    def feed(self, data: bytes) -> list[Telegram]:
        """Process received bytes; return the telegrams that are now complete, oldest first."""
        telegrams = []
        for byte in data:
            if not self._process_byte(byte):
                continue
            content, self._content = bytes(self._content or b""), None
            if checksums(content[:-2]) == (content[-2], content[-1]):
                telegrams.append(Telegram(content[0], content[1], content[2], content[_HEADER:-2]))
            else:
                self.rejected += 1
        return telegrams

    def _process_byte(self, byte: int) -> bool:
        """Process one byte; return whether it was the last byte of a telegram."""
        if self._content is None:
            self._content = bytearray() if byte == STX else None
            return False
        if byte == STX and not self._half_stuffed:
            self._half_stuffed = True
            return False
        if self._half_stuffed and byte != STX:  # that STX began a new telegram
            self.rejected += bool(self._content)
            self._content = bytearray()
        self._half_stuffed = False
        self._content.append(byte)
        return len(self._content) >= _HEADER and len(self._content) == _HEADER + self._content[3] + 2


def decode_header_block(parameters: Sequence[int]) -> tuple[int, int, int]:
    """Decode the block "rotor header" of READ_CONFIG.

    Args:
        parameters: parameters of the answer, bytes from 0 to 255: the number of the block, and the block.

    Returns:
        Codes of the unit and of the nominal load of channel A, and the serial number.

    Raises:
        ProtocolError: it is another block, or its checksum is wrong.
    """
    if (
        len(parameters) != _BLOCK + 1
        or parameters[0] != ROTOR_HEADER_BLOCK
        or parameters[1] != ROTOR_HEADER_ID
    ):
        raise ProtocolError("not the configuration block 'rotor header'")
    block = bytes(parameters[1:])
    content = block[:28]
    plain = weighted = 0
    for byte in content:
        plain = (plain + byte) & 0xFFFF
        weighted = (weighted + plain) & 0xFFFF
    block_checksums = plain.to_bytes(2, "big") + weighted.to_bytes(2, "big")
    if block_checksums != block[28:]:
        raise ProtocolError("configuration block 'rotor header': wrong checksum")
    return block[8], int.from_bytes(block[10:12], "big"), int.from_bytes(block[4:8], "big")


_SYNC_SAMPLES = 5  # consecutive counters before a stream is accepted
_NEAR_COUNTS = 128  # half of a step of the high byte
_COUNTERS = 256


def _signed(high: int, low: int) -> int:
    return int.from_bytes((high, low), "big", signed=True)


class LorenzStream(ReadingStream):
    """Samples of the fast stream (mode 3): a counter, and 16 bits, signed, big-endian; no checksum.

    Only the counters determine where a sample begins and ends. A sample counts once the next counter has
    arrived and is larger by one. If that counter value also occurs within the sample, bytes may have been
    lost before it. The sample is then left out, unless it is near the last one and the force after such a
    loss would be far from it. After a gap, the stream is accepted again once five consecutive counters fit. A
    flipped bit in a value is not detected. The counters also date the samples, see `sensor_clock`.

    Args:
        rate_hz: sample rate [Hz]; a sample waits for the next counter for one period, 0 by default.
    """

    sensor_clock: SensorClock

    def __init__(self, newtons_per_count: float, rate_hz: float = inf) -> None:
        self._factor, self.held_back_s = newtons_per_count, 1.0 / rate_hz
        self.sensor_clock = SensorClock(longest_gap_s=(_COUNTERS - 1) / rate_hz)
        self._unprocessed = b""
        self._in_step = False  # whether the remaining bytes begin with a counter
        self._last_counter = 0  # of the last sample that was accepted
        self._last_counts = nan  # of the last sample that was accepted

    def feed(self, data: bytes) -> list[float]:
        buffer, index, samples = self._unprocessed + data, 0, []
        while True:
            if not self._in_step:
                index, self._in_step = self._search(buffer, index)
            if not self._in_step or index + 4 > len(buffer):
                break
            counter, high, low, following = buffer[index : index + 4]
            if (following - counter) & 0xFF != 1:
                self._in_step = False
                self.rejected += 1
                continue
            index += 3
            counts = _signed(high, low)
            if following not in (high, low) or self._is_likelier(counts, high, low, following):
                elapsed = (counter - self._last_counter) % _COUNTERS
                self.sensor_clock.advance(elapsed * self.held_back_s)
                self._last_counter, self._last_counts = counter, counts
                samples.append(counts * self._factor)
        self._unprocessed = buffer[index:]
        return samples

    def _is_likelier(self, counts: int, high: int, low: int, following: int) -> bool:
        """Return whether the sample is near the last one, while lost bytes would mean a distant force."""
        distances = []
        if high == following:  # two bytes lost: the true sample is the low byte and the next counter
            distances.append(abs(_signed(low, following) - self._last_counts))
        if low == following:  # one byte lost: the next sample's high byte, whose low byte has not arrived
            distances.append(abs(_signed(following, 128) - self._last_counts) - 128)
        return abs(counts - self._last_counts) < _NEAR_COUNTS <= min(distances)

    def _search(self, buffer: bytes, index: int) -> tuple[int, bool]:
        """Return where a row of fitting counters begins, or where to continue when more bytes arrive."""
        # A ramp of the force can also increase by one, and a lost or damaged byte of the true row leaves two
        # of its steps. So a row is accepted only if no other row has as many steps.
        while index + 3 * _SYNC_SAMPLES + 2 <= len(buffer):
            rows = (buffer[index + shift :: 3][:_SYNC_SAMPLES] for shift in range(3))
            # Number of times that each row increases by one.
            steps = [sum((second - first) & 0xFF == 1 for first, second in pairwise(row)) for row in rows]
            if max(steps) == _SYNC_SAMPLES - 1 and sorted(steps)[1] <= 1:
                return index + steps.index(max(steps)), True
            index += 1
        return index, False


_ANSWER_S = 0.3


class LorenzSettings(SerialForceSettings):
    """Settings in the robot file: data sheet values and the sensor's own codes, which must agree."""

    nominal_load: Annotated[Positive, Field(le=1e6)]  # nominal load, in `unit`
    unit: Annotated[str, AfterValidator(check_unit)]  # unit of the nominal load
    counts_at_nominal: Annotated[Positive, Field(le=32767)]  # counts at nominal load
    # The sensor's code of its unit; the error after a first try with any code shows the right one.
    dimension_code: Annotated[int, Field(ge=0, le=255, strict=True)]
    load_code: Annotated[int, Field(ge=0, le=65535, strict=True)]  # the sensor's code of its nominal load
    rate_hz: Annotated[int, Field(strict=True)] = 1000  # samples a second
    address: Annotated[int, Field(ge=1, le=254, strict=True)] = 1  # bus address of the sensor

    @field_validator("rate_hz")
    @classmethod
    def _check_rate(cls, rate_hz: int) -> int:
        if rate_hz not in SAMPLE_RATE_CODES:
            raise ValueError(f"not supported. Valid: {', '.join(map(str, SAMPLE_RATE_CODES))}")
        return rate_hz

    @property
    def nominal_n(self) -> float:
        """Nominal load [N]."""
        return self.nominal_load * newtons_per(self.unit)


class Lorenz(SerialForceSensor, Examinable):
    """A Lorenz sensor in its speed-optimized stream.

    The sensor is identified from its configuration, in telegrams with checksums; the stream has none.
    """

    name = "lorenz"
    Settings = LorenzSettings
    end_of_stream = STOP_STREAM
    _settings: LorenzSettings

    def configure(self) -> None:
        """Identify the sensor and start the stream; raise `DeviceError` if it is silent or differs."""
        settings = self._settings
        self._bus.write(STOP_STREAM)
        # Ask up to twice: the end of a stream may have damaged the first telegram after it.
        try:
            self._ask(LorenzCommand.HELLO)
        except DeviceError:
            self._ask(LorenzCommand.HELLO)
        answer = self._ask(LorenzCommand.READ_CONFIG, bytes((ROTOR_HEADER_BLOCK,)))
        try:
            *codes, serial_number = decode_header_block(answer.parameters)
        except ProtocolError as error:
            raise self._error(str(error)) from error
        if codes != [settings.dimension_code, settings.load_code]:
            raise self._error(
                f"sensor {serial_number} has dimension_code {codes[0]} and load_code {codes[1]}, but the "
                f"robot file states {settings.dimension_code} and {settings.load_code}"
            )
        self._identified = (
            f"serial number {serial_number}, {settings.nominal_n:.4g} N, {settings.rate_hz} samples/s"
        )
        # The request for an endless stream of channel A.
        parameters = bytes((STREAM_MODE, SAMPLE_RATE_CODES[settings.rate_hz], 0, 0, ord("A")))
        self._ask(LorenzCommand.SPECIAL_MODE, parameters)
        stream = LorenzStream(settings.nominal_n / settings.counts_at_nominal, settings.rate_hz)
        self._bus.listen(stream, settings.nominal_n)

    def _ask(self, command: LorenzCommand, parameters: bytes = b"") -> Telegram:
        """Return the answer to a command; raise `DeviceError` if it is missing or a refusal."""
        is_stream = command is LorenzCommand.SPECIAL_MODE
        expected, what = (LorenzCommand.ACK, "the stream") if is_stream else (command, command.name)
        data = encode_telegram(Telegram(command, self._settings.address, HOST, parameters))
        reader = TelegramReader()

        def answer(received: bytes) -> Telegram | None:
            from_sensor = (t for t in reader.feed(received) if t.sender == self._settings.address)
            return next((t for t in from_sensor if t.command in (expected, LorenzCommand.NACK)), None)

        telegram = self._bus.ask(data, answer, _ANSWER_S)
        if telegram is None:
            damaged = f" ({reader.rejected} damaged telegrams)" if reader.rejected else ""
            raise self._error(f"no answer to {what}{damaged}; check port, baud rate and address")
        if telegram.command != expected:
            raise self._error(f"the sensor refuses {what}, error {list(telegram.parameters)}")
        return telegram
