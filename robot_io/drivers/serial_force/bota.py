"""Bota Systems' force-torque sensors with a serial interface: protocol and sensor.

The serial protocol has commands of letters, and frames of 37 bytes.

A frame is AA, 34 bytes of data and their CRC-16 (X.25), all little-endian: status, forces and torques along
x, y and z as floats, the sensor's time in microseconds, its temperature. Commands are answered with `r,0,`,
the letter and a code: 0 is done. Source: Bota Systems' own examples and ROS driver for the serial sensors.
"""

import re
import struct
from binascii import crc_hqx
from math import copysign, isfinite
from typing import Final, Literal, NamedTuple

from palpate.robot_io.drivers.serial_force.line import AxisForceSettings, SerialForceSensor, SerialLine
from palpate.robot_io.drivers.serial_force.stream import ReadingStream, SensorClock
from palpate.robot_io.drivers.servo.stream import PacketStream, bit_names
from palpate.robot_io.errors import ProtocolError
from palpate.robot_io.examination import Examinable

CONFIGURE, RUN = b"C", b"R"
BAUD_RATE_CODES: Final = {9_600: 0, 57_600: 1, 115_200: 2, 230_400: 3, 460_800: 4}
_CONVERSIONS_HZ: Final = 51_200  # of which the filter makes one sample of as many as it is long

_HEADER: Final = 0xAA
_DATA: Final = struct.Struct("<H6fIf")
FRAME_SIZE: Final = 1 + _DATA.size + 2
_SKIPPED, _OVERRANGE = 0x01, 0x02
_STATUS: Final = {
    0x01: "skips measurements; lower rate_hz",
    0x04: "invalid measurements",
    0x08: "raw measurements",
}
_MANY_SKIPPED: Final = 5  # consecutive samples that indicate a restart rather than a late sample
_LONGEST_GAP_US: Final = 1_000_000
_TIMES: Final = 1 << 32


def setup_commands(baud_rate: int, rate_hz: int) -> tuple[bytes, ...]:
    """Make the commands from configuration to run: calibrated values in binary frames, plain filter.

    Values have no temperature compensation; chopping, fast mode and FIR filter are off.

    Args:
        baud_rate: of the line [bit/s].
        rate_hz: sample rate, which sets the length of the filter [Hz].
    """
    communication = f"c,0,1,0,{BAUD_RATE_CODES[baud_rate]}"
    filtering = f"f,{_CONVERSIONS_HZ // rate_hz},0,0,1"
    return CONFIGURE, communication.encode(), filtering.encode(), RUN


def find_answer_code(command: bytes, received: bytes | bytearray) -> int | None:
    """Find the answer code to a command in received bytes; None without an answer, 0 for success.

    Args:
        command: the command as sent; its first byte identifies the answer.
        received: all bytes since then, which may also hold samples.
    """
    match = re.search(rb"r,\d,%c,(\d)" % command[0], received)
    return int(match[1]) if match else None


def crc16(data: bytes) -> int:
    """Compute the CRC-16 of X.25, from 0 to FFFF, least significant bit first.

    Args:
        data: bytes covered by the checksum.
    """
    # `crc_hqx` has the same polynomial, most significant bit first.
    return int(f"{crc_hqx(data.translate(_REVERSED), 0xFFFF):016b}"[::-1], 2) ^ 0xFFFF


_REVERSED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


class BotaSample(NamedTuple):
    """Content of one frame."""

    status: int  # bits
    forces_n: tuple[float, ...]  # forces along x, y, z [N], then torques [N m]
    time_us: int  # the sensor's own time [us]
    temperature_c: float  # [degrees Celsius]


def decode_frame(frame: bytes) -> BotaSample:
    """Decode a frame; raise `ProtocolError` for a wrong size, header, CRC or value.

    Args:
        frame: received frame, with header and CRC.
    """
    if len(frame) != FRAME_SIZE or frame[0] != _HEADER:
        raise ProtocolError(f"not a frame: {frame[:40]!r}")
    if crc16(frame[1:-2]) != frame[-2] | frame[-1] << 8:
        raise ProtocolError("CRC mismatch")
    status, *forces, time_us, temperature_c = _DATA.unpack(frame[1:-2])
    if not all(map(isfinite, forces)):
        raise ProtocolError("a force is not a number")
    return BotaSample(status, tuple(forces), time_us, temperature_c)


class _FrameReader(PacketStream[BotaSample]):
    header = bytes((_HEADER,))
    head = 1

    def _size(self, buffer: bytes, start: int) -> int:
        return FRAME_SIZE

    def _decode(self, packet: bytes) -> BotaSample:
        return decode_frame(packet)


class BotaStream(ReadingStream):
    """Forces of one axis ("x", "y" or "z") from frames; see `ReadingStream`.

    The sensor's time must advance by no more than a second from sample to sample, because a CRC of 16 bits
    lets one damaged frame in 65 536 through. After a larger step, or at the start, a sample counts once the
    next one continues its time. If the sensor reports an exceeded range, at least `capacity_n` [N] is
    returned. Rejected are damaged frames, repeated samples, and samples that the sensor skipped.
    """

    has_checksums = True
    sensor_clock: SensorClock

    def __init__(self, axis: str, capacity_n: float) -> None:
        self._axis, self._capacity_n = "xyz".index(axis), capacity_n
        self._frames = _FrameReader(FRAME_SIZE)
        self._time_us: int | None = None  # of the last sample, and of a sample whose time did not continue
        self._odd_us: int | None = None
        self._left_out = self._skipped = 0  # the latter in a row
        self._restarted = ""
        self.sensor_clock = SensorClock()

    def feed(self, data: bytes) -> list[float]:
        forces_n = []
        for sample in self._frames.feed(data):
            is_new, is_skipped = self._is_new(sample.time_us), sample.status & _SKIPPED
            self._skipped = self._skipped + 1 if is_skipped else 0
            if not is_new or (is_skipped and self._skipped < _MANY_SKIPPED):
                self._left_out += 1
                continue
            errors = sample.status & ~_OVERRANGE
            problem = f"the sensor says '{bit_names(errors, _STATUS)}'" if errors else ""
            self.fault_text = self._restarted or problem
            force_n = sample.forces_n[self._axis]
            if sample.status & _OVERRANGE:
                force_n = copysign(max(abs(force_n), self._capacity_n), force_n)
            if not errors:
                forces_n.append(force_n)
        self.rejected = self._frames.rejected + self._left_out
        return forces_n

    def _is_new(self, time_us: int) -> bool:
        goes_on, odd_goes_on = _follows(time_us, self._time_us), _follows(time_us, self._odd_us)
        if not (goes_on or odd_goes_on):
            self._odd_us = time_us
            return False
        if self._time_us is not None:
            elapsed_us = (time_us - self._time_us) % _TIMES
            if elapsed_us >= _TIMES // 2:
                self._restarted = "the sensor has restarted, with its stored settings"
            self.sensor_clock.advance(1e-6 * elapsed_us)
        self._time_us, self._odd_us = time_us, None
        return True


def _follows(time_us: int, before_us: int | None) -> bool:
    return before_us is not None and 0 < (time_us - before_us) % _TIMES <= _LONGEST_GAP_US


_ANSWER_S = 0.5
_ATTEMPTS, _STARTING = 3, 8  # the latter where opening the port may have restarted it, for some seconds
_BITS = 10  # bits per byte on the line


class BotaSettings(AxisForceSettings):
    """Settings in the robot file."""

    rate_hz: Literal[100, 200, 400, 800] = 800  # samples a second, by the length of the sensor's filter


class Bota(SerialForceSensor, Examinable):
    """One axis of the sensor, on a `serial_line`; the sensor identifies itself only when it starts."""

    name = "bota"
    Settings = BotaSettings
    _settings: BotaSettings
    _bus: SerialLine

    def configure(self) -> None:
        """Set the sensor up and start it; raise `DeviceError` if it refuses, or the line is too slow."""
        settings, baud_rate = self._settings, self._bus.baud_rate
        if baud_rate not in BAUD_RATE_CODES or settings.rate_hz * FRAME_SIZE * _BITS > baud_rate:
            needed = settings.rate_hz * FRAME_SIZE * _BITS
            valid = ", ".join(str(rate) for rate in BAUD_RATE_CODES if rate >= needed)
            raise self._error(f"{baud_rate} bit/s cannot carry {settings.rate_hz} samples/s. Valid: {valid}")
        for command in setup_commands(baud_rate, settings.rate_hz):
            self._command(command)
        self._identified = (
            f"Bota, {settings.rate_hz} samples/s, {settings.axis} axis, {settings.capacity_n:.4g} N "
            "according to the robot file"
        )
        self._bus.listen(BotaStream(settings.axis, settings.capacity_n), settings.capacity_n)

    def _command(self, command: bytes) -> None:
        """Send a command until it is confirmed; the sensor may be starting or may have lost a letter."""
        received = bytearray()

        def parse_reply(data: bytes) -> int | None:
            received.extend(data)
            return find_answer_code(command, received)

        for _ in range(_STARTING if command == CONFIGURE else _ATTEMPTS):
            code = self._bus.ask(command, parse_reply, _ANSWER_S)
            if code:
                raise self._error(f"the sensor refuses '{command.decode()}', code {code}")
            if code == 0:
                return
        raise self._error(f"no answer to '{command.decode()}'; check port, baud rate and supply")
