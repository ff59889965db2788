"""A Net F/T on a network socket: RDT over UDP and the page of its configuration, from ATI's manuals."""

import math
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from palpate.robot_io.drivers.net_ft import NetFtSettings
from palpate.sim_backend.emulators.faults import Faults
from palpate.sim_backend.emulators.hardware import EmulatedWire, Plant
from palpate.sim_backend.emulators.serial_line import SensorWire, SerialSensor, StreamTimer
from palpate.sim_backend.emulators.serial_sensors import NEWTONS, check_unit
from palpate.sim_backend.emulators.wiring import WireMaker, WireRequest

_END = 0x7FFFFFFF
BROKEN_GAGE, SENSING_RANGE, ANY_ERROR = 1 << 2, 1 << 30, 1 << 31
_INTERNAL_HZ = 7000
_LOOK_S = 0.01  # whether it is to end, in real time


def record(sequence: int, measurement: int, status: int, counts: list[int]) -> bytes:
    """Make one RDT record of 36 bytes, most significant first.

    Args:
        sequence: number of the record.
        measurement: number of the internal measurement.
        status: bits.
        counts: three forces, three torques.
    """
    words = [sequence % 2**32, measurement % 2**32, status, *(count % 2**32 for count in counts)]
    return b"".join(word.to_bytes(4, "big") for word in words)


class EmulatedNetFt(SerialSensor):
    """One force-torque sensor with a force on one axis, up to its capacity.

    Attributes:
        enabled: whether RDT is switched on.
        rate_hz: records per second.
        status: status bits in addition to those of its reading.
        measures: whether it takes new measurements; otherwise it repeats the last one.
        settings: other settings, by their names on the page.
    """

    def __init__(self, settings: NetFtSettings) -> None:
        super().__init__(settings)
        self.range_n, self._axis = settings.capacity_n, "xyz".index(settings.axis)
        self.counts_per_force, self.unit = settings.counts_per_force, settings.unit
        self.enabled, self.rate_hz, self.status, self.measures = True, 1000, 0, True
        self.settings = {"setcfgsel": "0", "setuserfilter": "0"}
        self.settings |= dict.fromkeys(("setbias", "cfgtfx"), "0;0;0;0;0;0")
        self._timer = StreamTimer(self.rate_hz)
        self._sequence = self._measurement = 0

    def _process(self, data: bytes, now_s: float) -> bytes:
        if len(data) != 8 or data[:2] != b"\x12\x34" or not self.enabled:
            return b""
        command = data[2] * 256 + data[3]
        if command in (2, 3) and data[4:] == bytes(4):
            self._timer.start(now_s)
            self._sequence = 0
        elif command == 0:
            self._timer.stop()
        return b""

    def reading(self, force_n: float) -> bytes:
        """See `SerialSensor.reading`; a missing value (NaN) sets the status of a broken gage."""
        self._sequence += self._timer.passed
        self._measurement += self._timer.passed * self.measures * _INTERNAL_HZ // self.rate_hz
        status, counts = self.status, [17, -23, 31, 5, -7, 11]
        if math.isnan(force_n):
            status |= BROKEN_GAGE | ANY_ERROR
        else:
            status |= SENSING_RANGE | ANY_ERROR if abs(force_n) >= self.range_n else 0
            value = round(force_n / NEWTONS[self.unit] * self.counts_per_force)
            counts[self._axis] = min(max(value, -_END), _END)
        return record(self._sequence, self._measurement, status, counts)

    def _power_up(self, now_s: float) -> None:
        """See `SerialSensor._power_up`; nothing is sent until the host requests it again."""
        self._timer.stop()

    def page(self) -> bytes:
        """Return the configuration page netftapi2.xml."""
        values = {
            "prodname": "Ethernet F/T",
            "runpkmx": f"{self._measurement};0;0;0;0;0",
            **self.settings,
            "scfgfu": self.unit,
            "cfgcpf": f"{self.counts_per_force:.0f}",
            "comrdte": "Enabled" if self.enabled else "Disabled",
            "comrdtrate": str(self.rate_hz),
        }
        lines = "".join(f"<{name}>{value}</{name}>\n" for name, value in values.items())
        return f'<?xml version="1.0"?>\n<netft>\n{lines}</netft>\n'.encode()


class EmulatedNetFtLine(SensorWire):
    """The network between a sensor and its host, here this machine's own; see `SensorWire`.

    It receives requests at `rdt_port` and serves its page at `http_port`. A corrupt datagram is truncated,
    because UDP's checksum lets no flipped bit through.
    """

    _sensor: EmulatedNetFt

    def __init__(self, sensor: EmulatedNetFt, plant: Plant, faults: Faults | None = None) -> None:
        super().__init__(sensor, plant, faults)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(("127.0.0.1", 0))
        self._host: Any = None
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _pages(sensor))
        threading.Thread(target=self._server.serve_forever, args=(_LOOK_S,), daemon=True).start()
        self.rdt_port, self.http_port = self._socket.getsockname()[1], self._server.server_address[1]
        self._is_open = True

    def receive(self, now_s: float) -> None:
        while self._is_open:
            try:
                data, self._host = self._socket.recvfrom(2048)
            except BlockingIOError:
                return
            self._put(self._sensor.receive(data, now_s), now_s)

    def close(self) -> None:
        """See `EmulatedWire.close`: the host receives nothing more."""
        if self._is_open:
            self._is_open = False
            self._socket.close()
            self._server.shutdown()
            self._server.server_close()

    def _put(self, frame: bytes, now_s: float) -> None:
        if self._is_open and self._host and frame:
            self._socket.sendto(frame, self._host)

    def _corrupted(self, data: bytes) -> bytes:
        return self.faults.lose_a_byte(data)


def _pages(sensor: EmulatedNetFt) -> type[BaseHTTPRequestHandler]:
    class ConfigurationHandler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Answer with the only page."""
            page = sensor.page() if self.path == "/netftapi2.xml" else b""
            self.send_response(200 if page else 404)
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    return ConfigurationHandler


class NetFtWires(WireMaker):
    """The sensor that the robot file names, on this machine's own network."""

    name = "net_ft_line"

    def make(self, request: WireRequest) -> tuple[EmulatedWire, dict[str, Any]]:
        if request.force is None or request.force.driver != "net_ft":
            raise request.refusal("a net_ft_line is emulated with a force sensor of the driver 'net_ft' only")
        settings = request.force_settings_as(NetFtSettings)
        check_unit(settings.unit, request)
        line = EmulatedNetFtLine(EmulatedNetFt(settings), request.plant, request.faults)
        return line, {"host": "127.0.0.1", "rdt_port": line.rdt_port, "http_port": line.http_port}
