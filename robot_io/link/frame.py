"""What is put around every message: version, sender, sequence, the stamps of both clocks, and a checksum.

The checksum (CRC-32) finds what a line or a program has damaged. It keeps no attacker out: that is what TLS
with certificates on both sides is for (docs/teleoperation.md).

A frame is its checksum and a protobuf message of seven fields of eight bytes each and the message's bytes.
Their length is a varint padded to three bytes, so that everything has its place, and one call reads it all.
"""

import struct
import zlib
from operator import itemgetter
from typing import Any, NamedTuple

from robot_io.errors import ProtocolError
from robot_io.link.messages import Intent, Message, ObjectEstimate, Report
from robot_io.link.wire import WireType

VERSION = 2
MOST_BYTES = 32 * 1024
_MOST_FRAMES = 2**40  # of one sender; gaps of many senders still fit a record's int64
_CHECKSUM = struct.Struct("<I")
_HEADER = struct.Struct("<BqBqBqBdBdBdBqBBBB")
_TAGS = (0x09, 0x11, 0x19, 0x21, 0x29, 0x31, 0x39, 0x42)  # fields 1 to 7 of eight bytes each; 8, bytes
_tags_of, _fields_of = itemgetter(*range(0, 15, 2)), itemgetter(*range(1, 15, 2))  # of an unpacked header
_BEGIN = _CHECKSUM.size + _HEADER.size
_KINDS: dict[type[Message], int] = {Intent: 0, Report: 1, ObjectEstimate: 2}  # they travel: add at the end
_WIRE: tuple[WireType[Any], ...] = tuple(WireType(kind) for kind in _KINDS)


class FrameError(ProtocolError):
    """Bytes that are no whole frame of this version."""


class Frame(NamedTuple):
    """One message with where and when it comes from."""

    version: int
    sender: int  # random number of the sending program, another each time it is started
    sequence: int  # counts up by one with each frame of a sender, from 0
    sent_s: float  # on the sender's clock [s]
    heard_sent_s: float  # `sent_s` of the newest frame that the sender has of its peer; NaN before the first
    heard_at_s: float  # when that frame arrived, on the sender's clock [s]; NaN before the first
    kind: int  # class of the message
    content: bytes  # the message

    @property
    def message(self) -> Message:
        """The message, checked. FrameError: it is none of its kind."""
        if not 0 <= self.kind < len(_WIRE):
            raise FrameError(f"no message has the number {self.kind}")
        try:
            message: Message = _WIRE[self.kind].decode(self.content)
        except ProtocolError as error:
            raise FrameError(str(error)) from error
        return message


def encode(  # noqa: PLR0917 (the header, field by field)
    sender: int, sequence: int, sent_s: float, heard_sent_s: float, heard_at_s: float, message: Message
) -> bytes:
    """A message in its frame."""
    kind = _KINDS[type(message)]
    content = _WIRE[kind].encode(message)
    t1, t2, t3, t4, t5, t6, t7, t8 = _TAGS
    length = len(content)
    low, middle, high = length & 0x7F | 0x80, length >> 7 & 0x7F | 0x80, length >> 14
    # fmt: off
    header = _HEADER.pack(
        t1, VERSION, t2, sender, t3, sequence, t4, sent_s, t5, heard_sent_s, t6, heard_at_s, t7, kind,
        t8, low, middle, high,
    )
    # fmt: on
    return _CHECKSUM.pack(zlib.crc32(content, zlib.crc32(header))) + header + content


def decode(data: bytes) -> Frame:
    """The frame; its message is decoded when it is asked for.

    Raises:
        FrameError: the bytes were damaged, are too many, or are of another version.
    """
    if not _BEGIN <= len(data) <= MOST_BYTES:
        raise FrameError(f"{len(data)} bytes: a frame has {_BEGIN} to {MOST_BYTES}")
    if _CHECKSUM.unpack_from(data)[0] != zlib.crc32(memoryview(data)[_CHECKSUM.size :]):
        raise FrameError("the checksum does not fit: the frame was damaged")
    values = _HEADER.unpack_from(data, _CHECKSUM.size)
    if values[:2] != (_TAGS[0], VERSION):
        raise FrameError(f"version {values[1]} of the messages; this program speaks {VERSION}")
    low, middle, high = values[-3:]
    length = low & 0x7F | (middle & 0x7F) << 7 | high << 14
    if _tags_of(values) != _TAGS or length != len(data) - _BEGIN:
        raise FrameError("no frame of this program: its fields are not where they belong")
    frame = Frame._make((*_fields_of(values), data[_BEGIN:]))
    if not -1e12 < frame.sent_s < 1e12 or not 0 <= frame.sequence < _MOST_FRAMES:
        raise FrameError(f"sequence {frame.sequence}, sent at {frame.sent_s} s: out of range")
    return frame
