"""Force sensors on a serial line, written from their protocols without the drivers.

A gauge that writes lines, a Loadstar DI-1000 and a Lorenz LCV-USB2 are written from Loadstar's "DI-100U /
DI-1000U Command Set" and "DI-1000HS-1K Output Formats", and, for Lorenz, from the description of the sensor
interface protocol that LorenzTelegram follows: STX doubled within a telegram, sum and weighted sum as
checksums, configuration blocks of 32 bytes, stream mode 3.
"""

import itertools
import math
import struct
from binascii import crc_hqx
from collections.abc import Callable
from typing import Any

from palpate.robot_io.drivers.serial_force.bota import BotaSettings
from palpate.robot_io.drivers.serial_force.gauges import ForceLinesSettings, LoadstarSettings, Mark10Settings
from palpate.robot_io.drivers.serial_force.line import SerialForceSettings, SerialLineSettings
from palpate.robot_io.drivers.serial_force.lorenz import LorenzSettings
from palpate.robot_io.drivers.serial_force.microcontroller_cell import MicrocontrollerCellSettings
from palpate.sim_backend.emulators.hardware import EmulatedWire
from palpate.sim_backend.emulators.serial_line import PtyLine, SerialSensor, StreamTimer
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest

_RATE_HZ = 500.0  # of gauges that send by themselves


class EmulatedGauge(SerialSensor):
    """One gauge, up to its capacity; it writes lines such as "-12.34 N"."""

    def __init__(self, settings: ForceLinesSettings) -> None:
        super().__init__(settings)
        self.range_n = settings.capacity_n
        self._timer = StreamTimer(_RATE_HZ)
        self._timer.start(0.0)

    def reading(self, force_n: float) -> bytes:
        return f"{force_n:.3f} N\r\n".encode()


LBF_N = 4.4482216152605


class EmulatedLoadstar(SerialSensor):
    """One interface with its load cell, in pounds; readings go a fifth beyond its capacity.

    Attributes:
        width: characters of a reading; 0 pads none, as some interfaces do.
    """

    width, _unit = 12, "lb"

    def __init__(self, settings: LoadstarSettings) -> None:
        super().__init__(settings)
        self.range_n, self._capacity_n = 1.2 * settings.capacity_n, settings.capacity_n
        self._timer = StreamTimer(_RATE_HZ)
        self._tare_n = self._last_n = 0.0
        self._input = b""

    def _process(self, data: bytes, now_s: float) -> bytes:
        *commands, self._input = (self._input + data).split(b"\r")
        return b"".join(self._answer(command.strip().upper(), now_s) for command in commands)

    def _answer(self, command: bytes, now_s: float) -> bytes:
        if self._timer.running:
            self._timer.stop()
            return b""
        word = command.decode("ascii", "replace")
        if word == "WC":
            self._timer.start(now_s)
            return b""
        if word in ("CT0", "TARE"):
            self._tare_n = self._last_n
        answers = {
            "": "A",
            "MODEL": "FCM DI-1000",
            "UNITS": self._unit,
            "LC": f"{self._capacity_n / LBF_N:.3f}",
            "CT0": "Tared",
            "TARE": "Tared",
            "W": self.reading(self._last_n).decode().strip(),
        }
        return answers.get(word, "?").encode() + b"\r\n"

    def reading(self, force_n: float) -> bytes:
        self._last_n = force_n
        return f"{(force_n - self._tare_n) / LBF_N:{self.width}.4f}\r\n".encode()

    def _power_up(self, now_s: float) -> None:
        self._timer.stop()
        self._tare_n, self._input = 0.0, b""


ADDRESS = 1
CONFIG_TIME_S = 200e-6  # the rate code counts periods of 200 us


def _checksums(content: bytes) -> bytes:
    """Return sum and weighted sum, whose carry is added back."""
    total, weighted = 0, 0
    for byte in content:
        total = (total + byte) % 256
        weighted += total
        weighted = (weighted + 1) % 256 if weighted > 255 else weighted
    return bytes((total, weighted))


def telegram(command: int, to: int, parameters: bytes = b"", sender: int = ADDRESS) -> bytes:
    """Make a telegram of a sensor with its checksums: STX, and the content with every 02 doubled.

    Args:
        command: number.
        to: receiver.
        parameters: bytes.
        sender: address of the sensor.
    """
    content = bytes((command, to, sender, len(parameters))) + parameters
    return b"\x02" + (content + _checksums(content)).replace(b"\x02", b"\x02\x02")


class EmulatedLorenz(SerialSensor):
    """One sensor; its range is that of its counts."""

    def __init__(self, settings: LorenzSettings) -> None:
        super().__init__(settings)
        nominal_n = settings.nominal_load * NEWTONS[settings.unit]
        self.range_n = nominal_n * 32767 / settings.counts_at_nominal
        self._counts_per_n = settings.counts_at_nominal / nominal_n
        self._dimension_code, self._load_code = settings.dimension_code, settings.load_code
        self._timer = StreamTimer(1000.0)
        self._counter = 0
        self._input = b""
        self._stx_in_a_row = 0

    def _process(self, data: bytes, now_s: float) -> bytes:
        answers = b""
        for byte in data:
            self._stx_in_a_row = self._stx_in_a_row + 1 if byte == 2 else 0
            if self._timer.running:
                if self._stx_in_a_row == 3:
                    self._timer.stop()
                continue
            self._input = (self._input + bytes((byte,)))[-600:]
            answers += self._parse_telegram(now_s)
        return answers

    def _parse_telegram(self, now_s: float) -> bytes:
        """Execute the telegram at the end of the input, if there is a complete one."""
        for start in (index for index, byte in enumerate(self._input) if byte == 2):
            stuffed = self._input[start + 1 :]
            content = stuffed.replace(b"\x02\x02", b"\x02")
            is_complete = len(content) >= 6 and len(content) == 6 + content[3]
            is_complete = is_complete and content.replace(b"\x02", b"\x02\x02") == stuffed
            if is_complete and _checksums(content[:-2]) == content[-2:] and content[1] in (0, ADDRESS):
                self._input = b""
                return self._execute(content[0], content[2], content[4:-2], now_s)
        return b""

    def _execute(self, command: int, host: int, parameters: bytes, now_s: float) -> bytes:
        if command == 0x40:
            return telegram(0x40, host, b"\x01")
        if command == 0x44 and parameters == b"\x80":
            block = bytearray(28)
            block[0] = 0x40
            block[4:8] = (123456).to_bytes(4, "big")
            block[8] = self._dimension_code
            block[10:12] = self._load_code.to_bytes(2, "big")
            total, weighted = sum(block) % 65536, sum(itertools.accumulate(block)) % 65536
            rotor_header = bytes(block) + struct.pack(">HH", total, weighted)
            return telegram(0x44, host, b"\x80" + rotor_header)
        if command == 0x5A and len(parameters) == 5 and parameters[0] == 3 and parameters[1] > 0:
            self._timer = StreamTimer(1.0 / (parameters[1] * CONFIG_TIME_S))
            self._timer.start(now_s)
            self._counter = 0
            return telegram(0x06, host)
        return telegram(0x15, host, bytes((41,)))

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; a missing value (NaN) is the end of the range."""
        counts = -32768 if math.isnan(force_n) else round(force_n * self._counts_per_n)
        sample = bytes((self._counter,)) + min(max(counts, -32768), 32767).to_bytes(2, "big", signed=True)
        self._counter = (self._counter + 1) % 256
        return sample

    def _power_up(self, now_s: float) -> None:
        self._timer.stop()
        self._input = b""


_UNITS = {  # command, unit text behind a reading, and its size [N] or [N m]
    "N": ("N", 1.0),
    "LB": ("lbF", LBF_N),
    "KG": ("kgF", 9.80665),
    "G": ("gF", 0.00980665),
    "MN": ("mN", 1e-3),
    "LBIN": ("lbFin", 1.0),
}
_ANSWER_S = 1.5e-3
_SILENT = ("AOUT", "AOFF", "IPOL", "OPOL", "FULL", "NUM", "CUR")  # settings that are not answered


class EmulatedMark10(SerialSensor):
    """One gauge; it reads a tenth beyond its capacity.

    Attributes:
        unit: command of the unit that it reads in.
        unknown: commands that it does not know.
    """

    unit, unknown = "LB", ()

    def __init__(self, settings: Mark10Settings) -> None:
        super().__init__(settings)
        self.range_n = 1.1 * settings.capacity_n
        self._input, self._due_s = b"", math.inf

    def _process(self, data: bytes, now_s: float) -> bytes:
        *commands, self._input = (self._input + data).replace(b"\n", b"").split(b"\r")
        return b"".join(self._execute(command.decode("ascii", "replace"), now_s) for command in commands)

    def _execute(self, command: str, now_s: float) -> bytes:
        if command == "?C":
            self._due_s = now_s + _ANSWER_S
        elif command == "RM":
            return b"M7-50\r\n"
        elif command.rstrip("0123456789") in self.unknown or not command:
            return b"*10\r\n" if command else b""
        elif command in _UNITS:
            self.unit = command
        elif command.rstrip("0123456789") not in _SILENT:
            return b"*10\r\n"
        return b""

    def due(self, now_s: float) -> bool:
        """See `SerialSensor.due`: once per request."""
        is_due = self._due_s <= now_s + 1e-9 and now_s >= self._silent_until_s
        self._due_s = math.inf if is_due else self._due_s
        return is_due

    def reading(self, force_n: float) -> bytes:
        written, newtons = _UNITS[self.unit]
        value = f"{force_n / newtons:.3f}" if math.isfinite(force_n) else "---"
        return f"{value} {written}\r\n".encode()

    def _power_up(self, now_s: float) -> None:
        self._input, self._due_s = b"", math.inf


_RAIL = 0x7FFFFF  # of a 24 bit converter


def cell_line(text: str) -> bytes:
    """Make a line of the firmware, with checksum and end.

    Args:
        text: text without checksum and line end.
    """
    return text.encode() + f"*{crc_hqx(text.encode(), 0xFFFF):04X}\n".encode()


class EmulatedCell(SerialSensor):
    """One cell with its converter."""

    def __init__(self, settings: MicrocontrollerCellSettings) -> None:
        super().__init__(settings)
        self.range_n = math.inf
        self._counts_per_n, self._zero = 1.0 / settings.newtons_per_count, settings.zero_counts
        self._rate_hz, self._counter = settings.rate_hz, 0
        self._timer = StreamTimer(settings.rate_hz)
        self._timer.start(0.0)

    def _process(self, data: bytes, now_s: float) -> bytes:
        return cell_line(f"cell 1 nau7802 {self._rate_hz}") * data.count(b"?")

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; a missing value (NaN) is a fault, other values are clipped."""
        self._counter = (self._counter + 1) % 256
        if math.isnan(force_n):
            return cell_line("fault converter")
        counts = force_n * self._counts_per_n + self._zero if math.isfinite(force_n) else math.inf
        return cell_line(f"{self._counter} {round(min(max(counts, -_RAIL - 1), _RAIL))}")

    def _power_up(self, now_s: float) -> None:
        """See `SerialSensor._power_up`; it streams again without a request."""
        self._counter = 0


SKIPPED, OVERRANGE, INVALID, RAW = 1, 2, 4, 8  # status bits
_STEP_US = 19.53125  # of one conversion
_TEMPERATURE_C = 31.5  # of the sensor


def bota_crc(data: bytes) -> int:
    """Compute the inverted CRC-16 of X.25: x^16 + x^12 + x^5 + 1, reflected, FFFF at the start.

    Args:
        data: bytes that it covers.
    """
    remainder = 0xFFFF
    for byte in data:
        for place in range(8):
            low = (remainder ^ byte >> place) & 1
            remainder = remainder >> 1 ^ (0x8408 if low else 0)
    return ~remainder & 0xFFFF


def bota_frame(status: int, values: list[float], time_us: int) -> bytes:
    """Make one frame with its checksum: three forces, three torques.

    Args:
        status: bits.
        values: three forces [N], three torques [N m].
        time_us: sensor's clock [us].
    """
    data = struct.pack("<H6fIf", status, *values, time_us % 2**32, _TEMPERATURE_C)
    return b"\xaa" + data + struct.pack("<H", bota_crc(data))


class EmulatedBota(SerialSensor):
    """One force-torque sensor with a force on one axis, up to its capacity.

    The length of its filter, which determines its rate, is stored in the sensor.

    Attributes:
        status: status bits in addition to those of its reading.
        refused: letters of commands that it refuses.
        starts_until_s: end of its start, from which on it receives commands [s].
    """

    def __init__(self, settings: BotaSettings) -> None:
        super().__init__(settings)
        self.range_n, self._axis = settings.capacity_n, "xyz".index(settings.axis)
        self.status, self.refused = 0, ""
        self._saved = self._length = 512
        self._configures = False
        self.starts_until_s = 0.0
        self._time_us = 0.0
        self._run(0.0)

    def _run(self, now_s: float) -> None:
        self._configures = False
        self._timer = StreamTimer(1e6 / (_STEP_US * self._length))
        self._timer.start(now_s)

    def _process(self, data: bytes, now_s: float) -> bytes:
        word = data.decode("ascii", "replace")
        if now_s < self.starts_until_s or not (self._configures or word == "C"):
            return b""
        if word[:1] in self.refused:
            return f"r,0,{word[:1]},1".encode()
        letter, *values = word.split(",")
        if letter == "C":
            self._configures = True
            self._timer.stop()
        elif letter == "f" and len(values) == 4 and int(values[0]) in (51, 64, 128, 205, 256, 512):
            self._length = int(values[0])
        elif letter == "c" and len(values) == 4:
            self.status = self.status & ~RAW | (0 if values[1] == "1" else RAW)
        elif letter == "R":
            self._run(now_s)
        else:
            return b""
        return f"r,0,{letter},0".encode()

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; the frame of a missing value (NaN) is marked as invalid."""
        self._time_us += self._timer.passed * _STEP_US * self._length
        status, values = self.status, [1.5, -2.5, 3.5, 0.25, -0.5, 0.75]
        if math.isnan(force_n):
            status, force_n = status | INVALID, 0.0
        status |= OVERRANGE if abs(force_n) >= self.range_n else 0
        values[self._axis] = force_n
        return bota_frame(status, values, round(self._time_us))

    def _power_up(self, now_s: float) -> None:
        """See `SerialSensor._power_up`; it streams again with its stored settings."""
        self._length, self._time_us = self._saved, 0.0
        self._run(now_s)


NEWTONS = {"N": 1.0, "kN": 1e3, "lbf": LBF_N, "klbf": 4448.2216152605, "kgf": 9.80665}


def check_unit(unit: str, request: WireRequest) -> None:
    """Check that emulated sensors can count in a unit.

    Args:
        unit: such as "lbf".
        request: the bus of the sensor.

    Raises:
        InputError: they cannot.
    """
    if unit not in NEWTONS:
        raise request.refusal(f"no emulated sensor reads in '{unit}'. Valid: {', '.join(NEWTONS)}")


# By driver: settings in the robot file, and the emulated sensor.
_SENSORS: dict[str, tuple[type[SerialForceSettings], Callable[[Any], SerialSensor]]] = {
    "bota": (BotaSettings, EmulatedBota),
    "force_lines": (ForceLinesSettings, EmulatedGauge),
    "loadstar": (LoadstarSettings, EmulatedLoadstar),
    "lorenz": (LorenzSettings, EmulatedLorenz),
    "mark10": (Mark10Settings, EmulatedMark10),
    "microcontroller_cell": (MicrocontrollerCellSettings, EmulatedCell),
}


class SerialWires(WireMaker):
    """The force sensor that the robot file names, on a pseudo terminal."""

    name = "serial_line"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        if request.force is None:
            raise request.refusal("a serial_line without a force sensor cannot be emulated")
        if request.force.driver not in _SENSORS:
            raise request.refusal(
                f"no sensor is emulated for the driver '{request.force.driver}'. Emulated: "
                f"{', '.join(_SENSORS)}; name one of them to try the rest of the arm, or omit --wire"
            )
        model, make = _SENSORS[request.force.driver]
        settings = request.force_settings_as(model)
        if isinstance(settings, LorenzSettings):
            check_unit(settings.unit, request)
        line = PtyLine(
            make(settings),
            request.plant,
            request.faults,
            in_lock_step=request.in_lock_step,
            baud_rate=request.settings_as(SerialLineSettings).baud_rate,
        )
        return line, {"port": line.path}
