"""What stands before every frame: a checksum, or with a key that both sides share the mark of who made it.

A checksum (CRC-32) finds what a line or a program has damaged, and keeps no attacker out. A mark (the first
16 bytes of HMAC-SHA-256, RFC 2104) can be made by those alone who have the key. It hides nothing; TLS does.
"""

import hmac
import os
import stat
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from robot_io.errors import InputError

_LEAST_BYTES, _MOST_BYTES = 16, 4096  # of a key


class Seal(NamedTuple):
    """How frames are marked and known again."""

    size: int  # of the mark [bytes]
    of: Callable[[bytes | memoryview], bytes]  # the mark of a frame
    broken: str  # what is said of a frame whose mark is another


def _checksum(frame: bytes | memoryview) -> bytes:
    return zlib.crc32(frame).to_bytes(4, "little")


def _mark(key: bytes, frame: bytes | memoryview) -> bytes:
    return hmac.digest(key, frame, "sha256")[:16]


CHECKSUM = Seal(4, _checksum, "its checksum does not fit: it was damaged, or made with a key")


def key_seal(key: bytes) -> Seal:
    """The seal of whoever has the key."""
    return Seal(16, partial(_mark, key), "it was not made with this side's key")


def load_seal(path: Path, topic: str) -> Seal:
    """The seal of whoever has this file, whose bytes are the secret, for what is said on one topic.

    Each topic has a key of its own: no frame of another pair, or of the other direction, passes for one.

    InputError: it cannot be read, others can read it, or it is too short for a secret or too long for a key.
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
            f"key {path}: {size}; {_LEAST_BYTES} to {_MOST_BYTES} are needed, and nobody may guess them; "
            "'head -c 32 /dev/urandom' makes some"
        )
    return key_seal(hmac.digest(key, topic.encode(), "sha256"))


def check_secret(path: Path, what: str) -> None:
    """Refuse a file with a secret that other users can read. InputError: they can, or it is not there."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise InputError(f"{what} {path}: {error.strerror}") from error
    if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InputError(
            f"{what} {path}: others can read it (mode {mode:o}): chmod 600, or make another if somebody may "
            "have read it"
        )
