"""What is put around every message: version, sender, sequence, the stamps of both clocks, and a checksum.

The checksum (CRC-32) finds what a line or a program has damaged. It keeps no attacker out: that is what TLS
with certificates on both sides is for (docs/teleoperation.md).
"""

import struct
import zlib
from dataclasses import dataclass
from typing import Any

from robot_io.errors import ProtocolError
from robot_io.link.messages import Intent, Message, ObjectEstimate, Report
from robot_io.link.wire import WireType

VERSION = 1
MOST_BYTES = 32 * 1024
_MOST_FRAMES = 2**40  # of one sender; gaps of many senders still fit a record's int64
_CHECKSUM = struct.Struct("<I")
_WIRE: dict[str, WireType[Any]] = {kind.__name__: WireType(kind) for kind in (Intent, Report, ObjectEstimate)}


class FrameError(ProtocolError):
    """Bytes that are no whole frame of this version."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One message with where and when it comes from."""

    version: int
    sender: int  # random number of the sending program, another each time it is started
    sequence: int  # counts up by one with each frame of a sender, from 0
    sent_s: float  # on the sender's clock [s]
    heard_sent_s: float  # `sent_s` of the newest frame that the sender has of its peer; NaN before the first
    heard_at_s: float  # when that frame arrived, on the sender's clock [s]; NaN before the first
    kind: str  # class of the message
    content: bytes  # the message

    @property
    def message(self) -> Message:
        """The message, checked.

        Raises:
            FrameError: it is none of its kind.
        """
        try:
            message: Message = _WIRE[self.kind].decode(self.content)
        except KeyError:
            raise FrameError(f"no message is called {self.kind[:40]!r}") from None
        except ProtocolError as error:
            raise FrameError(str(error)) from error
        return message


_FRAME = WireType(Frame)


def encode(  # noqa: PLR0917 (the header, field by field)
    sender: int, sequence: int, sent_s: float, heard_sent_s: float, heard_at_s: float, message: Message
) -> bytes:
    """A message in its frame."""
    kind = type(message).__name__
    content = _WIRE[kind].encode(message)
    body = _FRAME.encode(Frame(VERSION, sender, sequence, sent_s, heard_sent_s, heard_at_s, kind, content))
    return _CHECKSUM.pack(zlib.crc32(body)) + body


def decode(data: bytes) -> Frame:
    """The frame; its message is decoded when it is asked for.

    Raises:
        FrameError: the bytes were damaged, are too many, or are of another version.
    """
    if not _CHECKSUM.size < len(data) <= MOST_BYTES:
        raise FrameError(f"{len(data)} bytes: a frame has at most {MOST_BYTES}")
    body = data[_CHECKSUM.size :]
    if _CHECKSUM.unpack_from(data) != (zlib.crc32(body),):
        raise FrameError("the checksum does not fit: the frame was damaged")
    try:
        frame = _FRAME.decode(body)
    except ProtocolError as error:
        raise FrameError(str(error)) from error
    if frame.version != VERSION:
        raise FrameError(f"version {frame.version} of the messages; this program speaks {VERSION}")
    if not abs(frame.sent_s) < 1e12 or not 0 <= frame.sequence < _MOST_FRAMES:
        raise FrameError(f"sequence {frame.sequence}, sent at {frame.sent_s} s: out of range")
    return frame
