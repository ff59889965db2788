"""A serial CAN adapter (CANable, USBtin ...) that speaks slcan: frames as lines of text, each ended by CR.

`t` and three hexadecimal digits of an id, or `T` and eight, then the number of data bytes, and these; `r` and
`R` ask for a frame instead. BEL in place of CR is a no. Source: LAWICEL, "CAN232 Manual", ASCII command set.

python-can's own reader waits in each poll, stamps frames when they are read and never recovers from a byte
that is no text. Here the port is read as those of servos are: all that has come, and never a wait.
"""

import re
from collections import deque

import can

from robot_io.clock import Clock
from robot_io.errors import DeviceError
from robot_io.serial_port import SerialPort

_SPEEDS = dict(zip((10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000), range(7), strict=True))
_SPEEDS[1_000_000] = 8  # 7 is 750 or 800 kbit/s, as the adapter's maker likes it
_USUAL_BAUD_RATE = 115_200  # USB adapters take any
_LONGEST = 32  # bytes of a line; a frame takes up to 27, and a time stamp four more
_TAKEN = (b"", b"z", b"Z")  # what an adapter says to what it was sent
_FRAME = re.compile(
    rb"(?:(?P<short>[tr])(?P<short_id>[0-7][0-9A-Fa-f]{2})|(?P<long>[TR])(?P<long_id>[01][0-9A-Fa-f]{7}))"
    rb"(?P<size>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)


def encode_line(message: can.Message) -> bytes:
    """The line for a frame."""
    kind, digits = ("r" if message.is_remote_frame else "t"), 3
    if message.is_extended_id:
        kind, digits = kind.upper(), 8
    return f"{kind}{message.arbitration_id:0{digits}X}{message.dlc}{message.data.hex().upper()}\r".encode()


def decode_line(line: bytes) -> can.Message:
    """The frame in a line without its end; a time stamp is left out. ValueError: it is none, or damaged."""
    found = _FRAME.fullmatch(line)
    if found is None:
        raise ValueError(f"no frame: {line!r}")
    kind, can_id = found["short"] or found["long"], found["short_id"] or found["long_id"]
    size, data = int(found["size"]), bytes.fromhex(found["data"].decode())
    is_remote = kind in b"rR"
    if len(data) - (0 if is_remote else size) not in (0, 2):
        raise ValueError(f"a frame of another length than it says: {line!r}")
    return can.Message(
        arbitration_id=int(can_id, 16),
        is_extended_id=kind in b"TR",
        is_remote_frame=is_remote,
        dlc=size,
        data=None if is_remote else data[:size],
    )


class SlcanBus:
    """One adapter, with the part of python-can's bus that is used here.

    The channel is its port, with its baud rate if need be: /dev/ttyACM0@3000000. A bit rate of None leaves
    the adapter as it is set up.

    Raises:
        ValueError: slcan has no such bit rate, or that is no baud rate.
        DeviceError: there is no such port, or another program has it.
    """

    def __init__(self, channel: str, bitrate: int | None, clock: Clock) -> None:
        path, _, baud_rate = channel.partition("@")
        if bitrate is not None and bitrate not in _SPEEDS:
            raise ValueError(f"bitrate {bitrate}: valid are {', '.join(map(str, _SPEEDS))}")
        self._port = SerialPort(path, int(baud_rate or _USUAL_BAUD_RATE), clock)
        self._rest, self._lines = b"", deque[bytes]()
        self._port.open()
        speed = b"" if bitrate is None else b"S%d\r" % _SPEEDS[bitrate]
        self._lead = b"\rC\r" + speed + b"O\r"  # before the next frame: here, what opens the bus
        self._write(b"")

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to the adapter at once. DeviceError: the port has failed, or takes no more."""
        self._write(encode_line(message))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame that has come, or None; never waits.

        ValueError: something came that is no frame; DeviceError: the port has failed.
        """
        if not self._lines:
            come = self._rest + self._port.wait(0.0)  # sees a hang-up, too
            *lines, self._rest = re.split(rb"[\r\a]", come)
            self._lines.extend(line for line in lines if line not in _TAKEN)
            if len(self._rest) > _LONGEST:  # noise, up to the next end of a line
                self._rest = self._rest[-_LONGEST:]
        return decode_line(self._lines.popleft()) if self._lines else None

    def shutdown(self) -> None:
        """Take the adapter off the bus, and let the port go. Can be called again."""
        try:
            if self._port.is_open:
                self._write(b"C\r")
        finally:
            self._port.close()

    def _write(self, line: bytes) -> None:
        try:
            self._port.write(self._lead + line)
        except DeviceError:
            self._lead = b"\r"  # ends what may have gone out of it
            raise
        self._lead = b""
