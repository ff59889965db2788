"""A Net F/T at the other end of a network cable, read by a thread of its own as a serial port is."""

import os
import socket
from contextlib import suppress
from typing import Annotated

from pydantic import Field

from robot_io.drivers.net_ft.configuration import Configuration, read_configuration
from robot_io.drivers.serial_force.line import ForceLine, ForceLineSettings
from robot_io.drivers.serial_force.reader import SerialReader
from robot_io.errors import DeviceError
from robot_io.files.file_model import matching

_LARGEST_DATAGRAM = 2048  # bytes
_AT_ONCE = 1000  # datagrams in one look, at most

_Port = Annotated[int, Field(ge=1, le=65_535, strict=True)]


class NetFtLineSettings(ForceLineSettings):
    """What the robot file says."""

    # As delivered, 192.168.1.1.
    host: Annotated[str, matching("[A-Za-z0-9._-]{1,253}", "its address alone, such as 192.168.1.1")]
    rdt_port: _Port = 49_152
    http_port: _Port = 80


class DatagramReader(SerialReader):
    """Hands each datagram on by itself."""

    def _receive(self) -> list[bytes]:
        datagrams: list[bytes] = []
        with suppress(BlockingIOError):
            while len(datagrams) < _AT_ONCE:
                datagrams.append(os.read(self._file_descriptor, _LARGEST_DATAGRAM))
        return datagrams


class _Socket:
    """A socket that hears one sender, as a port."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((host, port))
        except (OSError, UnicodeError):
            self._socket.close()
            raise
        self.fileno, self.close = self._socket.fileno, self._socket.close

    def read(self, size: int) -> bytes:
        """One datagram, or nothing; also where a host says that nobody hears what was sent."""
        with suppress(BlockingIOError, ConnectionRefusedError):
            return self._socket.recv(size)
        return b""

    def write(self, data: bytes) -> None:
        """Send; a host that says that nobody hears there means what was sent before."""
        with suppress(ConnectionRefusedError):
            self._socket.send(data)


class NetFtLine(ForceLine):
    """One sensor; datagrams of others are not heard."""

    name = "net_ft_line"
    Settings = NetFtLineSettings
    reader_type = DatagramReader
    _own: NetFtLineSettings
    _port: _Socket | None

    @property
    def label(self) -> str:
        """See `ForceLine.label`."""
        return f"Net F/T {self._own.host}"

    def configure(self) -> None:
        """Open a socket. DeviceError: the host has no address, or there is no way to it."""
        try:
            self._port = _Socket(self._own.host, self._own.rdt_port)
        except (OSError, UnicodeError) as error:  # the latter for what can be no host's name
            raise DeviceError(f"{self.label}: cannot be reached ({error})") from error

    def read_configuration(self) -> Configuration:
        """What the sensor says of itself. DeviceError: it does not answer, or with something else."""
        return read_configuration(self._own.host, self._own.http_port)

    def _close_port(self) -> None:
        if self._port is not None:
            self._port.close()
