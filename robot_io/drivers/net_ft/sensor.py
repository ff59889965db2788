"""One axis of an ATI Net F/T or Ethernet Axia as the force sensor."""

from typing import Annotated

from pydantic import AfterValidator

from robot_io.drivers.net_ft import protocol
from robot_io.drivers.net_ft.line import NetFtLine
from robot_io.drivers.net_ft.protocol import NetFtStream, decode_record
from robot_io.drivers.serial_force.sensor import AxisForceSettings, SerialForceSensor
from robot_io.drivers.serial_force.text import known_unit, newtons_per
from robot_io.errors import ProtocolError
from robot_io.examination import Examinable
from robot_io.files.file_model import Positive

_ANSWER_S, _REQUESTS = 0.2, 3
_AGREE = 1e-6  # of a scale


class NetFtSettings(AxisForceSettings):
    """What the robot file says; what the sensor's active configuration says must agree."""

    counts_per_force: Positive  # counts of one `unit`
    unit: Annotated[str, AfterValidator(known_unit)] = "N"


class NetFt(SerialForceSensor, Examinable):
    """One axis of the sensor, on a `net_ft_line`."""

    name = "net_ft"
    Settings = NetFtSettings
    line_type = NetFtLine
    end_of_stream = protocol.STOP
    _own: NetFtSettings
    _bus: NetFtLine

    def configure(self) -> None:
        """Read the sensor's configuration, and start the records.

        DeviceError: it does not answer, its forces have another scale, or it sends no records.
        """
        own, found = self._own, self._bus.read_configuration()
        newtons_per_count = newtons_per(found.unit) / found.counts_per_force
        stated = newtons_per(own.unit) / own.counts_per_force
        if not abs(newtons_per_count / stated - 1.0) <= _AGREE:
            raise self._error(
                f"counts {found.counts_per_force:.10g} for 1 {found.unit}, the robot file "
                f"says {own.counts_per_force:.10g} for 1 {own.unit}: another configuration is active"
            )
        if not found.is_streaming:
            raise self._error("RDT is disabled: enable it on its page 'Communications'")
        self._start()
        self._found = f"{found.product}, {found.rate_hz} records/s, {own.axis} axis, {own.capacity_n:.4g} N"
        stream = NetFtStream(newtons_per_count, own.axis, found.rate_hz)
        self._bus.listen(stream, own.capacity_n, has_checksums=True, own_time=stream.own_time)

    def _start(self) -> None:
        """Ask for records until one comes; a request may be lost."""
        for _ in range(_REQUESTS):
            if self._bus.ask(protocol.START, _is_record, _ANSWER_S):
                return
        raise self._error("sends no records; check rdt_port, firewall and other programs")


def _is_record(datagram: bytes) -> bool | None:
    try:
        decode_record(datagram)
    except ProtocolError:
        return None
    return True
