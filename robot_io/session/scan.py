"""One pass over the bytes of an MCAP file, whole or cut off; what is inside is not trusted.

MCAP: https://mcap.dev/spec. The library's readers want the summary at the end, which a killed program never
wrote.
"""

import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Metadata
from mcap.writer import MCAP0_MAGIC

from robot_io.errors import SessionError
from robot_io.files.unpacked import most_unpacked

MAX_CHUNK_BYTES = 4 * 1024 * 1024  # ours are 64 KiB or less
MAX_DATA_BYTES = 8 * 1024**3

_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence number, two times


@dataclass
class Scan:
    """What the pass found."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # the metadata records by their names
    # The messages of each topic, one after the other.
    messages: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    # The sequence numbers of each topic's messages, in the order of the messages.
    sequence: "dict[str, array[int]]" = field(default_factory=lambda: defaultdict(lambda: array("L")))
    complete: bool = False  # whether the file was finished; else it was read up to the last whole chunk


def scan(data: bytes) -> Scan:
    """Read an MCAP file's metadata and messages.

    SessionError: it is no MCAP file, or one that was finished and then damaged.
    """
    if not data.startswith(MCAP0_MAGIC):
        raise SessionError("no session: it does not begin as an MCAP file does")
    scanner = _Scanner(data)
    try:
        scanner.run()
    except (struct.error, UnicodeDecodeError, McapError, RuntimeError) as error:
        if scanner.closed:
            raise _damaged(error) from error
    except SessionError:
        if scanner.closed:
            raise
    if scanner.closed and not scanner.found.complete:
        raise SessionError("damaged: its end is there, but not all that comes before")
    _put_in_order(scanner.found)
    return scanner.found


def _damaged(error: Exception) -> SessionError:
    """What is wrong with a file, in our words where those of the library are about Python."""
    match error:
        case UnicodeDecodeError():
            return SessionError("damaged: a text in it is not UTF-8")
        case struct.error():
            return SessionError("damaged: a record in it is too short")
    return SessionError(f"damaged: {error}")


def _put_in_order(found: Scan) -> None:
    """Put messages into the order in which they were logged: chunks of a file may lie in any."""
    for topic, numbers in found.sequence.items():
        order, messages = np.argsort(np.asarray(numbers), kind="stable"), found.messages[topic]
        found.messages[topic] = [messages[index] for index in order.tolist()]
        found.sequence[topic] = array("L", sorted(numbers))


class Growing:
    """A file that is still being written, of which each part is read once."""

    def __init__(self) -> None:
        self._scanner = _Scanner(b"")
        self.read_bytes = len(MCAP0_MAGIC)  # from the beginning, that need not be given again

    def more(self, data: bytes) -> Scan:
        """What is new in `data`, which is the file from `read_bytes` on; metadata is of all that was read.

        SessionError: it is damaged.
        """
        scanner, found = self._scanner, self._scanner.found
        found.messages.clear()
        found.sequence.clear()
        try:
            for opcode, start, end in _records(data, 0):
                scanner.take(opcode, data[start:end])
                self.read_bytes += end - start + _RECORD.size
        except (struct.error, UnicodeDecodeError, McapError, RuntimeError) as error:
            raise _damaged(error) from error
        found.complete = data.endswith(MCAP0_MAGIC)
        return found


class _Scanner:
    def __init__(self, data: bytes) -> None:
        self.found = Scan()
        self.closed = len(data) > len(MCAP0_MAGIC) and data.endswith(MCAP0_MAGIC)
        self._data = data
        self._topics: dict[int, str] = {}
        self._bytes_left = min(MAX_DATA_BYTES, most_unpacked(len(data))) if data else MAX_DATA_BYTES

    def run(self) -> None:
        for opcode, start, end in _records(self._data, len(MCAP0_MAGIC)):
            if opcode == Opcode.DATA_END:
                self._check_sum(DataEnd.read(_stream(self._data[start:end])), start - _RECORD.size)
                self.found.complete = self.closed
                return
            self.take(opcode, self._data[start:end])

    def take(self, opcode: int, record: bytes) -> None:
        if opcode == Opcode.METADATA:
            found = Metadata.read(_stream(record))
            self.found.metadata[found.name] = found.metadata
        elif opcode == Opcode.CHUNK:
            self._take_chunk(_uncompressed(Chunk.read(_stream(record))))

    def _check_sum(self, record: DataEnd, data_end: int) -> None:
        if record.data_section_crc not in {0, zlib.crc32(memoryview(self._data)[:data_end])}:
            raise SessionError("damaged: the checksum of its data does not fit")

    def _take_chunk(self, chunk: bytes) -> None:
        self._bytes_left -= len(chunk)
        if self._bytes_left < 0:
            raise SessionError("unpacks to far more data than a session of its size holds")
        for opcode, start, end in _records(chunk, 0):
            if opcode == Opcode.MESSAGE:
                channel, sequence, _, _ = _MESSAGE.unpack_from(chunk, start)
                topic = self._topics.get(channel)
                if topic is None:
                    raise SessionError(f"damaged: a message belongs to no channel ({channel})")
                self.found.messages[topic].append(chunk[start + _MESSAGE.size : end])
                self.found.sequence[topic].append(sequence)
            elif opcode == Opcode.CHANNEL:
                record = Channel.read(_stream(chunk[start:end]))
                self._topics[record.id] = record.topic


def _records(data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of each whole record from the place `at` on."""
    while at + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        start = at + _RECORD.size
        at = start + length
        if opcode == 0 or at > len(data):
            return
        yield opcode, start, at


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))


def _uncompressed(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise SessionError(f"a chunk of {size} bytes; at most {MAX_CHUNK_BYTES}")
    if chunk.compression == "lz4":
        data: bytes = LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise SessionError(f"a chunk compressed with '{chunk.compression[:20]}'; sessions use lz4 or none")
    if len(data) != size or zlib.crc32(data) != chunk.uncompressed_crc:
        raise SessionError("damaged: the checksum of a chunk does not fit")
    return data
