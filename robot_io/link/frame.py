"""What is put around every message: version, sender, sequence, the stamps of both clocks, and a seal.

A frame is its seal (see `seal`) and a protobuf message of eight fields of eight bytes each and the message's
bytes. Their length is a varint padded to three bytes, so that everything has its place, and one call reads it
all.
"""

import struct
from hmac import compare_digest
from math import nan
from typing import Any, NamedTuple

from robot_io.errors import ProtocolError
from robot_io.link.messages import Intent, Message, ObjectEstimate, Report
from robot_io.link.seal import CHECKSUM, Seal
from robot_io.link.wire import WireType

VERSION = 3
MOST_BYTES = 32 * 1024
_MOST_FRAMES = 2**40  # of one sender; gaps of many senders still fit a record's int64
_HEADER = struct.Struct("<BqBqBqBdBqBdBdBqBBBB")
_FIELDS = struct.Struct("<xqxqxqxdxqxdxdxq4x")  # the same without tags and length
_TAGS = (0x09, 0x11, 0x19, 0x21, 0x29, 0x31, 0x39, 0x41, 0x4A)  # fields 1 to 8 of eight bytes each; 9, bytes
_KINDS: dict[type[Message], int] = {Intent: 0, Report: 1, ObjectEstimate: 2}  # they travel: add at the end
_WIRE: tuple[WireType[Any], ...] = tuple(WireType(kind) for kind in _KINDS)


class FrameError(ProtocolError):
    """Bytes that are no whole frame of this version."""


class Heard(NamedTuple):
    """The newest frame that a side has of its peer."""

    sender: int = 0  # of that frame; 0 before the first
    sent_s: float = nan  # on the peer's clock [s]; NaN before the first
    at_s: float = nan  # when it arrived, on the own clock [s]; NaN before the first


class Frame(NamedTuple):
    """One message with where and when it comes from."""

    version: int
    sender: int  # random number of the sending program, another each time it is started
    sequence: int  # counts up by one with each frame of a sender, from 0
    sent_s: float  # on the sender's clock [s]
    heard_sender: int  # these three as in `Heard`, of the sender's own peer
    heard_sent_s: float
    heard_at_s: float
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


def encode(  # noqa: PLR0917 (what a frame is made of)
    sender: int, sequence: int, sent_s: float, heard: Heard, message: Message, seal: Seal = CHECKSUM
) -> bytes:
    """A message in its frame."""
    kind = _KINDS[type(message)]
    content = _WIRE[kind].encode(message)
    t1, t2, t3, t4, t5, t6, t7, t8, t9 = _TAGS
    length = len(content)
    low, middle, high = length & 0x7F | 0x80, length >> 7 & 0x7F | 0x80, length >> 14
    # fmt: off
    header = _HEADER.pack(
        t1, VERSION, t2, sender, t3, sequence, t4, sent_s, t5, heard.sender, t6, heard.sent_s, t7, heard.at_s,
        t8, kind, t9, low, middle, high,
    )
    # fmt: on
    body = header + content
    return seal.of(body) + body


def decode(data: bytes, seal: Seal = CHECKSUM) -> Frame:
    """The frame; its message is decoded when it is asked for.

    FrameError: the bytes are too many, of another version, damaged, or not of whoever has the key.
    """
    begin = seal.size + _HEADER.size
    if not begin <= len(data) <= MOST_BYTES:
        raise FrameError(f"{len(data)} bytes: a frame has {begin} to {MOST_BYTES}")
    if not compare_digest(data[: seal.size], seal.of(memoryview(data)[seal.size :])):
        raise FrameError(seal.broken)
    frame = Frame._make((*_FIELDS.unpack_from(data, seal.size), data[begin:]))
    if frame.version != VERSION:
        raise FrameError(f"version {frame.version} of the messages; this program speaks {VERSION}")
    if not -1e12 < frame.sent_s < 1e12 or not 0 <= frame.sequence < _MOST_FRAMES:
        raise FrameError(f"sequence {frame.sequence}, sent at {frame.sent_s} s: out of range")
    return frame
