"""CAN adapters: open them, read without waiting, and classify failures; with a reader for slcan.

slcan writes frames as lines of text, each ended by CR: `t` and three hexadecimal digits of an id, or `T` and
eight, then the number of data bytes, and these; `r` and `R` request a frame instead. BEL in place of CR is an
error. Source: LAWICEL, "CAN232 Manual", ASCII command set.

python-can's own slcan reader waits in each poll, stamps frames when they are read, and never recovers from a
byte that is not text. Here the port is read like a servo port: all received bytes, without waiting.

All other adapters use python-can. Its `Notifier` is not used, because its thread ends silently at the first
error.
"""

import errno
import fcntl
import hashlib
import os
import re
import socket
import stat
import sys
import time
from collections import Counter, deque
from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import DeviceError, ProtocolError
from palpate.robot_io.extras import LazyModule
from palpate.robot_io.files.file_model import FileModel, matching
from palpate.robot_io.serial_port import SerialPort

if TYPE_CHECKING:
    import can
else:
    can = LazyModule("can")

_SPEEDS = dict(zip((10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000), range(7), strict=True))
_SPEEDS[1_000_000] = 8  # 7 is 750 or 800 kbit/s, depending on the adapter's maker
_USUAL_BAUD_RATE = 115_200  # USB adapters accept any
_LONGEST_LINE = 32  # bytes; a frame takes up to 27, and a time stamp four more
_CONFIRMATIONS = (b"", b"z", b"Z")  # replies of an adapter to a command or a sent frame
_FRAME = re.compile(
    rb"(?:(?P<short>[tr])(?P<short_id>[0-7][0-9A-Fa-f]{2})|(?P<long>[TR])(?P<long_id>[01][0-9A-Fa-f]{7}))"
    rb"(?P<size>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)


def encode_line(message: "can.Message") -> bytes:
    """Return the line for a frame, ended by CR.

    Args:
        message: frame, at most 8 data bytes.
    """
    kind, digits = ("r" if message.is_remote_frame else "t"), 3
    if message.is_extended_id:
        kind, digits = kind.upper(), 8
    return f"{kind}{message.arbitration_id:0{digits}X}{message.dlc}{message.data.hex().upper()}\r".encode()


def decode_line(line: bytes) -> "can.Message":
    """Return the frame in a line without its end; a time stamp is left out.

    Args:
        line: received line.

    Raises:
        ValueError: the line is not a frame, or is damaged.
    """
    match = _FRAME.fullmatch(line)
    if match is None:
        raise ValueError(f"not a frame: {line!r}")
    kind, can_id = match["short"] or match["long"], match["short_id"] or match["long_id"]
    size, data = int(match["size"]), bytes.fromhex(match["data"].decode())
    is_remote = kind in b"rR"
    if len(data) - (0 if is_remote else size) not in (0, 2):
        raise ValueError(f"a frame whose length differs from its length field: {line!r}")
    return can.Message(
        arbitration_id=int(can_id, 16),
        is_extended_id=kind in b"TR",
        is_remote_frame=is_remote,
        dlc=size,
        data=None if is_remote else data[:size],
    )


class _Slcan:
    """One slcan adapter, with the part of python-can's bus interface that is used here.

    The channel is its port, with its baud rate if need be: /dev/ttyACM0@3000000. A bit rate of None leaves
    the adapter as it is set up.

    Raises:
        ValueError: slcan does not support the bit rate, or the baud rate is invalid.
        DeviceError: the port does not exist, or another program uses it.
    """

    def __init__(self, channel: str, bitrate: int | None, clock: Clock) -> None:
        path, at, baud_rate = channel.partition("@")
        if at and not baud_rate.isdecimal():
            raise ValueError(f"channel {channel}: after @, give a baud rate like 3000000, not '{baud_rate}'")
        if bitrate is not None and bitrate not in _SPEEDS:
            raise ValueError(f"bitrate {bitrate}: not supported. Valid: {', '.join(map(str, _SPEEDS))}")
        self._port = SerialPort(path, int(baud_rate or _USUAL_BAUD_RATE), clock)
        self._unfinished, self._lines = b"", deque[bytes]()  # received line without its end; whole lines
        self._port.open()
        speed = b"" if bitrate is None else b"S%d\r" % _SPEEDS[bitrate]
        # Sent before the next frame: here, the commands that open the bus.
        self._prefix = b"\rC\r" + speed + b"O\r"
        try:
            self._write(b"")
        except DeviceError:
            self._port.close()
            raise

    def send(self, message: "can.Message", timeout: float | None = None) -> None:
        """Hand a frame to the adapter; raise `DeviceError` if the port failed, or its buffer is full."""
        self._write(encode_line(message))

    def recv(self, timeout: float | None = None) -> "can.Message | None":
        """Return the next received frame, never waiting; raise `ValueError` if the bytes are not a frame."""
        if not self._lines:
            received = self._unfinished + self._port.wait(0.0)  # detects a hang-up too
            *lines, self._unfinished = re.split(rb"[\r\a]", received)
            self._lines.extend(line for line in lines if line not in _CONFIRMATIONS)
            self._unfinished = self._unfinished[-_LONGEST_LINE:]  # what is longer is noise, not a frame
        return decode_line(self._lines.popleft()) if self._lines else None

    def shutdown(self) -> None:
        """Take the adapter off the bus, and release the port. Can be called repeatedly."""
        try:
            if self._port.is_open:
                self._write(b"C\r")
        finally:
            self._port.close()

    def _write(self, line: bytes) -> None:
        try:
            self._port.write(self._prefix + line)
        except DeviceError:
            self._prefix = b"\r"  # ends a line that may have been sent in part
            raise
        self._prefix = b""


BUS_OFF = 0x040  # error classes in the id of an error frame: linux/can/error.h
RESTARTED = 0x100
SLCAN = "slcan"
_MOST_FRAMES = 1000  # most frames per poll, so that a babbling node does not delay the loop


class CanFrame(NamedTuple):
    """One CAN frame."""

    can_id: int  # arbitration id, 11 bits, or 29 when `extended`
    data: bytes = b""  # 0 to 8 bytes, or to 64 when `fd`
    extended: bool = False  # whether the id has 29 bits
    remote: bool = False  # whether it requests a frame of this id
    fd: bool = False  # whether it is a CAN FD frame, whose data travels at the second bit rate


def expect_length(frame: CanFrame, what: str, *lengths: int) -> None:
    """Raise `ProtocolError` if the number of data bytes is not one of `lengths`.

    Args:
        frame: received frame.
        what: name of its content in errors.
        *lengths: numbers of bytes that are valid.
    """
    if len(frame.data) not in lengths:
        valid = " or ".join(map(str, lengths))
        raise ProtocolError(f"{what} has {len(frame.data)} bytes, expected {valid}")


class Timestamps(StrEnum):
    """Meaning of an adapter's time stamps."""

    WALL = "wall"  # seconds since 1970, as from socketcan, virtual and udp_multicast
    ROBOT = "robot"  # the robot's own clock, as from emulated devices in lockstep
    NONE = "none"  # unknown


def _refuse_empty_name(channel: str | int) -> str | int:
    if not str(channel).strip():
        raise ValueError("give the channel's name, such as can0, /dev/ttyACM0 or PCAN_USBBUS1")
    return channel


class CanLineSettings(FileModel):
    """Settings of the adapter."""

    fd: ClassVar = False  # whether the devices speak CAN FD

    # slcan, or an interface of python-can, such as socketcan, pcan, virtual or udp_multicast.
    interface: Annotated[str, matching(r"[a-z0-9_]{1,32}", "1 to 32 lower-case letters, digits or _")]
    # Name of the channel in the interface.
    channel: Annotated[str | int, AfterValidator(_refuse_empty_name)]
    # Bit rate [bit/s], for adapters that set it themselves; None leaves it unchanged.
    bitrate: Annotated[int, Field(gt=0, le=1_000_000, strict=True)] | None = None
    # Further arguments of the python-can interface.
    options: dict[str, str | bool | int | float] = Field(default_factory=dict)
    timestamps: Timestamps = Timestamps.WALL  # meaning of its time stamps

    @model_validator(mode="after")
    def _refuse_unknown_interface(self) -> Self:
        try:
            valid = sorted({SLCAN, *can.VALID_INTERFACES})
        except ModuleNotFoundError:  # opening the adapter states which package is missing
            return self
        if self.interface not in valid:
            raise ValueError(f"interface: {self.interface} is unknown. Valid: {', '.join(valid)}")
        return self

    @model_validator(mode="after")
    def _refuse_can_fd_over_slcan(self) -> Self:
        if self.fd and self.interface == SLCAN:
            raise ValueError("interface: slcan carries no CAN FD frames; use another interface of python-can")
        return self

    def bus_arguments(self) -> dict[str, Any]:
        """Return the arguments for `can.Bus`; by default, multicast stays on this machine."""
        arguments: dict[str, Any] = {"interface": self.interface, "channel": self.channel}
        if self.bitrate is not None:
            arguments["bitrate"] = self.bitrate
        if self.interface == "udp_multicast":
            arguments.update(hop_limit=0, fd=self.fd)
        elif self.fd:
            arguments["fd"] = True
        return {**arguments, **self.options}


class CanLine:
    """One opened adapter.

    Attributes:
        counts: frames that were not passed on, by kind: "error frame", "damaged", "CAN FD".
        bus_off: whether the adapter has left the bus because of too many errors.
    """

    def __init__(self, settings: CanLineSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._bus: can.BusABC | _Slcan | None = None
        self._lock: PortLock | None = None
        self.counts: Counter[str] = Counter()
        self.bus_off = False

    @property
    def label(self) -> str:
        """Name of the adapter in messages."""
        return f"CAN {self._settings.interface} {self._settings.channel}"

    @property
    def bitrate(self) -> int | None:
        """Bit rate [bit/s]; None if the robot file leaves it to the adapter."""
        return self._settings.bitrate

    def open(self) -> None:
        """Open the adapter; raise `DeviceError` if it is absent or cannot be opened, or is in use."""
        settings = self._settings
        lock = None
        try:
            if settings.interface != SLCAN:
                lock = PortLock(settings.channel, settings.interface, settings.options)
            _ = can.Message  # imported now: an import at the first frame would make its answer late
            if lock is None:
                self._bus = _Slcan(str(settings.channel), settings.bitrate, self._clock, **settings.options)
            else:
                self._bus = can.Bus(**settings.bus_arguments())
        except DeviceError as error:
            raise DeviceError(f"{self.label}: {error}") from error
        except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
            if lock is not None:
                lock.release()
            raise DeviceError(f"{self.label}: cannot be opened ({error})") from error
        self._lock = lock
        self._drained_s = self._clock.now_s()
        self.bus_off = False

    def close(self) -> None:
        """Release the adapter. Can be called repeatedly."""
        bus, self._bus = self._bus, None
        try:
            if bus is not None:
                bus.shutdown()
        except (can.CanError, OSError) as error:
            raise DeviceError(f"{self.label}: cannot be closed ({error})") from error
        finally:
            if self._lock is not None:
                self._lock.release()

    @property
    def is_open(self) -> bool:
        """Whether frames can be sent."""
        return self._bus is not None

    def send(self, frame: CanFrame, deadline_s: float) -> None:
        """Hand a frame to the adapter.

        Args:
            frame: frame to send.
            deadline_s: end of the retries while the adapter refuses the frame, robot's clock [s].

        Raises:
            DeviceError: the adapter is closed or bus-off, or refuses the frame until the deadline.
        """
        bus = self._opened()
        if self.bus_off:
            raise DeviceError(f"{self.label}: bus-off, nothing can be sent")
        message = can.Message(
            arbitration_id=frame.can_id,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            data=None if frame.remote else frame.data,
            dlc=8 if frame.remote else len(frame.data),
            is_fd=frame.fd,
            bitrate_switch=frame.fd,
            timestamp=self._clock.now_s() if self._settings.timestamps is Timestamps.ROBOT else 0.0,
        )
        try:
            bus.send(message, timeout=max(0.0, deadline_s - self._clock.now_s()))
        except (can.CanError, OSError) as error:
            raise DeviceError(f"{self.label}: cannot send ({error})") from error

    def drain(self, deadline_s: float) -> list[tuple[CanFrame, float]]:
        """Return all received frames, oldest first, with their arrival times [s]; never waits.

        A new frame has arrived since the last call. A time stamp outside this interval is ignored, and a
        frame without a time stamp gets the earliest possible time. If more frames are queued than one call
        returns, the remaining frames do not get later times.

        Args:
            deadline_s: end of the poll, robot's clock [s].

        Raises:
            DeviceError: the adapter failed or is bus-off.
        """
        bus, clock = self._opened(), self._clock
        now_s = clock.now_s()
        stamps = Timestamps.NONE if self._settings.interface == SLCAN else self._settings.timestamps
        # Offset from a time stamp to the robot's time [s]; None if unknown.
        offset_s = {Timestamps.ROBOT: 0.0, Timestamps.WALL: now_s - time.time()}.get(stamps)
        frames: list[tuple[CanFrame, float]] = []
        emptied = False
        for _ in range(_MOST_FRAMES):
            try:
                message = bus.recv(timeout=0.0)
            except (can.CanError, OSError) as error:
                raise DeviceError(f"{self.label}: cannot receive ({error})") from error
            except (ValueError, IndexError, KeyError, TypeError):  # bytes that are not a frame
                self.counts["damaged"] += 1
                continue
            if message is None:
                emptied = True
                break
            frame = self._accept(message)
            if frame is not None:
                now_s = clock.now_s()
                at_s = self._drained_s if offset_s is None else message.timestamp + offset_s
                frames.append((frame, min(max(at_s, self._drained_s), now_s)))
            if now_s > deadline_s and len(frames) > _MOST_FRAMES // 10:
                break
        if self.bus_off:
            raise DeviceError(f"{self.label}: bus-off, the adapter has left the bus after too many errors")
        if emptied:
            self._drained_s = now_s
        elif frames:
            self._drained_s = frames[-1][1]
        return frames

    def _opened(self) -> "can.BusABC | _Slcan":
        if self._bus is None:
            raise DeviceError(f"{self.label}: not open")
        return self._bus

    def _accept(self, message: "can.Message") -> CanFrame | None:
        if message.is_error_frame:
            self.counts["error frame"] += 1
            if message.arbitration_id & BUS_OFF:
                self.bus_off = True
            elif message.arbitration_id & RESTARTED:
                self.bus_off = False
            return None
        if message.is_fd and not self._settings.fd:
            self.counts["CAN FD"] += 1
            return None
        return CanFrame(
            message.arbitration_id,
            bytes(message.data),
            message.is_extended_id,
            message.is_remote_frame,
            message.is_fd,
        )


class PortLock:
    """Exclusive lock on a serial port, as pyserial and others use it, or on a CAN channel; until `release`.

    Parts of this program can share a channel, which the devices on it divide among themselves. A channel of
    the interface "virtual" exists in this program only, and is not locked. CAN channels are locked on Linux.

    Args:
        channel: channel of the python-can interface, such as /dev/ttyACM0@115200 or can0.
        interface: name of the interface.
        options: further arguments of the interface.

    Raises:
        DeviceError: another program uses the port or channel, or another part of this one uses the port.
    """

    _shared: ClassVar[dict[str, tuple[socket.socket, int]]] = {}  # open channels, with the number of users

    def __init__(
        self, channel: str | int, interface: str = "virtual", options: Mapping[str, object] | None = None
    ) -> None:
        self._fd = -1
        self._name = ""
        path = str(channel).partition("@")[0]
        try:
            is_port = stat.S_ISCHR(os.stat(path).st_mode)
            self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) if is_port else -1
        except OSError:
            is_port = path.startswith("/")  # opening the adapter reports the cause
        if self._fd >= 0:
            try:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                self.release()
                raise DeviceError(f"{path}: in use by another program") from error
        elif not is_port and interface != "virtual" and sys.platform == "linux":
            # Options may tell apart adapters with the same channel, such as by a serial number.
            whole = f"{interface}/{channel}/{sorted((options or {}).items())}"
            name = hashlib.sha256(whole.encode()).hexdigest()
            # Linux releases an abstract socket when this program ends, however it ends.
            lock, users = self._shared.get(name) or (socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM), 0)
            if not users:
                try:
                    lock.bind(f"\0palpate/can/{name}")
                except OSError as error:
                    lock.close()
                    if error.errno != errno.EADDRINUSE:
                        raise
                    raise DeviceError(
                        "in use by another program; sharing it could cut that program's torque"
                    ) from error
            self._shared[name], self._name = (lock, users + 1), name

    def release(self) -> None:
        """Release the port or channel. Can be called repeatedly."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)
        name, self._name = self._name, ""
        if name:
            lock, users = self._shared.pop(name)
            if users > 1:
                self._shared[name] = lock, users - 1
            else:
                lock.close()
