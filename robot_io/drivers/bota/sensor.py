"""One axis of a Bota Systems sensor (Rokubi, SensONE, with a serial or USB interface) as the force sensor."""

from typing import Literal

from robot_io.drivers.bota import protocol
from robot_io.drivers.bota.protocol import BAUD_RATE_CODES, FRAME_SIZE, BotaStream
from robot_io.drivers.serial_force.line import SerialLine
from robot_io.drivers.serial_force.sensor import AxisForceSettings, SerialForceSensor
from robot_io.examination import Examinable

_ANSWER_S = 0.5
_ATTEMPTS, _STARTING = 3, 8  # the latter where opening the port may have restarted it, for some seconds
_BITS = 10  # of a byte on the line


class BotaSettings(AxisForceSettings):
    """What the robot file says."""

    rate_hz: Literal[100, 200, 400, 800] = 800  # samples a second, by the length of the sensor's filter


class Bota(SerialForceSensor, Examinable):
    """One axis of the sensor, on a `serial_line`; it says which one it is when it starts, and then only."""

    name = "bota"
    Settings = BotaSettings
    _own: BotaSettings
    _bus: SerialLine

    def configure(self) -> None:
        """Set the sensor up, and let it run.

        DeviceError: it does not answer, or refuses; or the line is too slow.
        """
        own, baud_rate = self._own, self._bus.baud_rate
        if baud_rate not in BAUD_RATE_CODES or own.rate_hz * FRAME_SIZE * _BITS > baud_rate:
            needed = own.rate_hz * FRAME_SIZE * _BITS
            valid = ", ".join(str(rate) for rate in BAUD_RATE_CODES if rate >= needed)
            raise self._error(
                f"{own.rate_hz} samples/s do not go over a line of {baud_rate} bit/s. Valid: {valid}"
            )
        for command in (
            protocol.CONFIGURE,
            protocol.communication_setup(baud_rate),
            protocol.filter_setup(own.rate_hz),
            protocol.RUN,
        ):
            self._command(command)
        self._found = (
            f"Bota, {own.rate_hz} samples/s, {own.axis} axis, {own.capacity_n:.4g} N by the robot file"
        )
        stream = BotaStream(own.axis, own.capacity_n)
        self._bus.listen(stream, own.capacity_n, has_checksums=True, own_time=stream.own_time)

    def _command(self, command: bytes) -> None:
        """Have a command done; the sensor may still have been starting, or have lost a letter."""
        received = bytearray()

        def understand(data: bytes) -> int | None:
            received.extend(data)
            return protocol.code_of(command, received)

        for _ in range(_STARTING if command == protocol.CONFIGURE else _ATTEMPTS):
            code = self._bus.ask(command, understand, _ANSWER_S)
            if code:
                raise self._error(f"the sensor refuses '{command.decode()}', code {code}")
            if code == 0:
                return
        raise self._error(f"no answer to '{command.decode()}'; check port, baud rate and supply")
