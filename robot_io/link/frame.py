"""Frame around every message: a seal, version, sender, sequence number, and times of both clocks.

A frame is its seal, eight numbers of eight bytes each, little-endian, and the message as JSON.

The seal is a checksum, or with a key that both sides share a message authentication code. A checksum (CRC-32)
detects damage, and does not stop an attacker. The code (first 16 bytes of HMAC-SHA-256, RFC 2104) requires
the key. It does not encrypt; TLS does.
"""

import hmac
import os
import stat
import struct
import zlib
from collections.abc import Callable
from hmac import compare_digest
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from palpate.robot_io.errors import InputError, ProtocolError
from palpate.robot_io.files.file_model import input_error
from palpate.robot_io.link.messages import Intent, Message, ObjectEstimate, Report

_LEAST_BYTES, _MOST_BYTES = 16, 4096  # smallest and largest size of a key


class FrameCode(NamedTuple):
    """Checksum or message authentication code of frames."""

    size: int  # length of the code [bytes]
    of: Callable[[bytes | memoryview], bytes]  # computes the code of a frame
    broken: str  # message for a frame with a wrong code


CHECKSUM = FrameCode(
    4,
    lambda frame: zlib.crc32(frame).to_bytes(4, "little"),
    "its checksum does not match, so it was damaged, or made with a key",
)


def key_seal(key: bytes) -> FrameCode:
    """Make the message authentication code (HMAC) of a key.

    Args:
        key: the secret.
    """
    broken = "it was not made with this side's key"
    return FrameCode(16, lambda frame: hmac.digest(key, frame, "sha256")[:16], broken)


def load_seal(path: Path, topic: str) -> FrameCode:
    """Make the message authentication code of a key file for the messages on one topic.

    Each topic has its own derived key: a frame of another pair, or of the other direction, is not valid.

    Args:
        path: file whose bytes are the secret.
        topic: name of the topic.

    Raises:
        InputError: the file cannot be read, other users can read it, or it is too short or too long.
    """
    check_secret(path, "key")
    try:
        with path.open("rb") as file:
            key = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise InputError(f"key {path}: {error.strerror}") from error
    if not _LEAST_BYTES <= len(key) <= _MOST_BYTES:
        size = f"{len(key)} bytes" if len(key) <= _MOST_BYTES else "too many bytes"
        raise InputError(
            f"key {path}: {size}; it must hold {_LEAST_BYTES} to {_MOST_BYTES} random bytes; 'head -c 32 "
            "/dev/urandom > FILE' creates such a key"
        )
    return key_seal(hmac.digest(key, topic.encode(), "sha256"))


def check_secret(path: Path, what: str) -> None:
    """Raise `InputError` if a file with a secret does not exist, or other users can read it.

    Args:
        path: the file.
        what: name of the file in the error.
    """
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise InputError(f"{what} {path}: {error.strerror}") from error
    if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InputError(
            f"{what} {path}: other users can read this file (mode {mode:o}); run chmod 600 on it, or, if "
            "somebody may have read it, make a new secret"
        )


VERSION = 4
MOST_BYTES = 32 * 1024
_MOST_FRAMES = 2**40  # of one sender; gaps of many senders still fit a record's int64
_HEADER = struct.Struct("<qqqdqddq")  # the fields of a frame, except its content
# Transmitted numbers: add new ones at the end.
_KINDS: dict[type[Message], int] = {Intent: 0, Report: 1, ObjectEstimate: 2}
_WIRE: tuple[TypeAdapter[Any], ...] = tuple(TypeAdapter(kind) for kind in _KINDS)


class FrameError(ProtocolError):
    """The received bytes are not a complete frame of this version."""


class LastReceived(NamedTuple):
    """The newest frame that a side has received from its peer."""

    sender: int = 0  # sender of that frame; 0 before the first
    sent_s: float = nan  # on the peer's clock [s]; NaN before the first
    at_s: float = nan  # when it arrived, on the own clock [s]; NaN before the first


class Frame(NamedTuple):
    """One message with its origin and times."""

    version: int
    sender: int  # random number of the sending program, different for each start
    sequence: int  # counts up by one with each frame of a sender, from 0
    sent_s: float  # on the sender's clock [s]
    heard_sender: int  # these three as in `LastReceived`, of the sender's own peer
    heard_sent_s: float
    heard_at_s: float
    kind: int  # class of the message
    content: bytes  # the message as JSON

    @property
    def message(self) -> Message:
        """Decode the message; raise `FrameError` if the content is not valid for its kind."""
        if not 0 <= self.kind < len(_WIRE):
            raise FrameError(f"no message has the number {self.kind}")
        try:
            message: Message = _WIRE[self.kind].validate_json(self.content, strict=True)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False, include_input=False)[0]
            text = first["msg"].removeprefix("Value error, ")
            raise FrameError(str(input_error(None, first["loc"], text))[:200]) from error
        return message


def encode(  # noqa: PLR0917
    sender: int,
    sequence: int,
    sent_s: float,
    heard: LastReceived,
    message: Message,
    seal: FrameCode = CHECKSUM,
) -> bytes:
    """Put a message into a frame.

    Args:
        sender: random number of this program.
        sequence: number of the frame.
        sent_s: time of sending on this side's clock [s].
        heard: newest frame of the peer.
        message: the content.
        seal: seal of this side.

    Raises:
        InputError: the frame would be too long for the other side.
    """
    kind = _KINDS[type(message)]
    header = _HEADER.pack(VERSION, sender, sequence, sent_s, *heard, kind)
    body = header + _WIRE[kind].dump_json(message)
    data = seal.of(body) + body
    if len(data) > MOST_BYTES:
        raise InputError(f"{type(message).__name__} of {len(data)} bytes: a frame has at most {MOST_BYTES}")
    return data


def decode(data: bytes, seal: FrameCode = CHECKSUM) -> Frame:
    """Read a frame; its message is decoded on access.

    Args:
        data: received bytes.
        seal: seal of the other side.

    Raises:
        FrameError: the bytes are too many, of another version, damaged, or made without the key.
    """
    begin = seal.size + _HEADER.size
    if not begin <= len(data) <= MOST_BYTES:
        raise FrameError(f"{len(data)} bytes: a frame has {begin} to {MOST_BYTES}")
    if not compare_digest(data[: seal.size], seal.of(memoryview(data)[seal.size :])):
        raise FrameError(seal.broken)
    frame = Frame._make((*_HEADER.unpack_from(data, seal.size), data[begin:]))
    if frame.version != VERSION:
        raise FrameError(f"version {frame.version} of the messages; this program supports version {VERSION}")
    if not -1e12 < frame.sent_s < 1e12 or not 0 <= frame.sequence < _MOST_FRAMES:
        raise FrameError(f"sequence {frame.sequence}, sent at {frame.sent_s} s: out of range")
    return frame
