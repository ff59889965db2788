"""The active configuration of a Net F/T, from the page `netftapi2.xml` of its web server.

Source: ATI 9620-05-NET FT, "XML Pages". Only the values that are needed are taken out of the text.
"""

import re
from http.client import OK, HTTPConnection, HTTPException
from math import isfinite
from typing import Final, NamedTuple

from robot_io.drivers.serial_force.text import newtons_per
from robot_io.errors import DeviceError, ProtocolError

PAGE: Final = "/netftapi2.xml"
_LARGEST_PAGE = 262_144  # bytes
_PATIENCE_S = 2.0


class Configuration(NamedTuple):
    """What a sensor says of itself."""

    product: str  # name of the product
    counts_per_force: float  # counts of one `unit`
    unit: str  # of its forces
    rate_hz: int  # records a second
    is_streaming: bool  # whether records are sent at all


def parse_configuration(page: bytes) -> Configuration:
    """The configuration on a page. ProtocolError: something is missing, or cannot be."""
    text = page.decode("utf-8", "replace")
    try:
        configuration = Configuration(
            product=_value(text, "prodname", "Net F/T"),
            counts_per_force=float(_value(text, "cfgcpf")),
            unit=_value(text, "scfgfu"),
            rate_hz=int(_value(text, "comrdtrate")),
            is_streaming=_value(text, "comrdte").lower() == "enabled",
        )
    except ValueError as error:
        raise ProtocolError(f"not a number: {error}") from error
    newtons_per(configuration.unit)
    if not (configuration.counts_per_force > 0.0 and isfinite(configuration.counts_per_force)):
        raise ProtocolError(f"{configuration.counts_per_force:g} counts per {configuration.unit}")
    if configuration.rate_hz < 1:
        raise ProtocolError(f"{configuration.rate_hz} records a second")
    return configuration


def _value(text: str, name: str, default: str | None = None) -> str:
    found = re.search(rf"<{name}>\s*([ -~]{{1,60}}?)\s*</{name}>", text)
    if found is None and default is None:
        raise ProtocolError(f"'{name}' is missing")
    return found[1] if found else str(default)


def read_configuration(host: str, port: int) -> Configuration:
    """Ask a sensor. DeviceError: it does not answer in time, or with something else."""
    where = f"http://{host}:{port}{PAGE}"
    connection = HTTPConnection(host, port, timeout=_PATIENCE_S)
    try:
        connection.request("GET", PAGE)
        answer = connection.getresponse()
        page = answer.read(_LARGEST_PAGE) if answer.status == OK else b""
    except (OSError, HTTPException) as error:
        raise DeviceError(
            f"{where}: no answer ({error}); check power, cable, host and this machine's address"
        ) from error
    finally:
        connection.close()
    if answer.status != OK:
        raise DeviceError(f"{where}: answers '{answer.status} {answer.reason}': is that a Net F/T?")
    try:
        return parse_configuration(page)
    except ProtocolError as error:
        raise DeviceError(f"{where}: is no configuration of a Net F/T: {error}") from error
