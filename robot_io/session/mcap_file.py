"""Writing and reading of session files in MCAP format.

Reading is one pass over the bytes of a file, whole or cut off, whose content is not trusted: the library's
readers need the summary at the end, which a killed program never wrote. MCAP: https://mcap.dev/spec
"""

import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import SEEK_END, BytesIO
from typing import IO, Any

import numpy as np
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Metadata
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from numpy.typing import NDArray

from palpate.robot_io.errors import SessionError
from palpate.robot_io.files.atomic_write import max_unpacked_bytes, replace_undecodable
from palpate.robot_io.session.event import (
    EVENT_STREAM,
    MAX_EVENT_BYTES,
    SessionMetadata,
    event_descriptor_set,
)
from palpate.robot_io.session.stream import TIME_COLUMN, RecordArray, Stream, streams_to_json
from palpate.robot_io.session.wire import PACKAGE, Decoder, WireFormat

MAX_CHUNK_BYTES = 4 * 1024 * 1024  # ours are 64 KiB or less
MAX_DATA_BYTES = 8 * 1024**3

_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence number, two times
_CHUNK_SIZES = struct.Struct("<QQQ")  # two times, unpacked size


@dataclass
class Scan:
    """Content of a file."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # the metadata records by their names
    # The messages of each topic that is not decoded, one after the other.
    messages: dict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    decoded: dict[str, Decoder] = field(default_factory=dict)  # the others
    # The sequence numbers of each topic's messages, in the order of the messages.
    sequence: "dict[str, array[int]]" = field(default_factory=lambda: defaultdict(lambda: array("L")))
    complete: bool = False  # whether the file was finished; else it was read up to the last whole chunk


Formats = Callable[[Mapping[str, str]], Mapping[str, WireFormat]]
"""Formats of the topics that are to be decoded, by the metadata of the session's header."""


def scan(file: IO[bytes], formats: Formats | None = None) -> Scan:
    """Read an MCAP file's metadata and messages.

    Args:
        file: the file, which can be read again from its start.
        formats: which topics are decoded on the way, if their messages are in order; None for no topic.

    Raises:
        SessionError: the file is not an MCAP file, or was damaged after it was finished.
    """
    file.seek(0)
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise SessionError("not a palpate session: the file is not MCAP")
    scanner = _Scanner(file, formats)
    try:
        scanner.run()
    except (struct.error, UnicodeDecodeError, McapError, RuntimeError) as error:
        if scanner.closed:
            raise _damaged(error) from error
    except SessionError:
        if scanner.closed:
            raise
    if scanner.closed and not scanner.content.complete:
        raise SessionError("damaged: its end is present, but parts before it are missing")
    # Put messages into the order in which they were logged: chunks of a file may lie in any.
    content = scanner.content
    numbers = (np.asarray(content.sequence[topic]) for topic in content.decoded)
    if any((topic_numbers[1:] < topic_numbers[:-1]).any() for topic_numbers in numbers):
        return scan(file)
    for topic, messages in content.messages.items():
        order = np.argsort(np.asarray(content.sequence[topic]), kind="stable")
        content.messages[topic] = [messages[index] for index in order.tolist()]
        content.sequence[topic] = array("L", sorted(content.sequence[topic]))
    return content


def _damaged(error: Exception) -> SessionError:
    """Make the error of a damaged file; messages about Python are replaced."""
    match error:
        case UnicodeDecodeError():
            return SessionError("damaged: a text in it is not UTF-8")
        case struct.error():
            return SessionError("damaged: a record in it is too short")
    return SessionError(f"damaged: {error}")


class GrowingFile:
    """A file that is still being written, of which each part is read once.

    Attributes:
        read_bytes: length of the part that was read.
    """

    def __init__(self) -> None:
        self._scanner = _Scanner(BytesIO(), None)
        self.read_bytes = len(MCAP0_MAGIC)

    def read(self, data: bytes) -> Scan:
        """Read new data; return new messages and all metadata so far; raise `SessionError` if damaged.

        Args:
            data: the file from `read_bytes` on.
        """
        scanner, content = self._scanner, self._scanner.content
        content.messages.clear()
        content.sequence.clear()
        try:
            for opcode, start, end in _records(data, 0):
                scanner.take(opcode, data[start:end])
                self.read_bytes += end - start + _RECORD.size
        except (struct.error, UnicodeDecodeError, McapError, RuntimeError) as error:
            raise _damaged(error) from error
        content.complete = data.endswith(MCAP0_MAGIC)
        return content


class _Scanner:
    def __init__(self, file: IO[bytes], formats: Formats | None) -> None:
        self.content = Scan()
        self._file, self._formats = file, formats
        self._topics: dict[int, str] = {}
        self._size = file.seek(0, SEEK_END)
        file.seek(max(self._size - len(MCAP0_MAGIC), 0))
        self.closed = self._size > len(MCAP0_MAGIC) and file.read() == MCAP0_MAGIC
        unpacked = max_unpacked_bytes(self._size) if self._size else MAX_DATA_BYTES
        self._bytes_left = min(MAX_DATA_BYTES, unpacked)

    def run(self) -> None:
        file = self._file
        file.seek(len(MCAP0_MAGIC))
        checksum = zlib.crc32(MCAP0_MAGIC)
        while file.tell() + _RECORD.size <= self._size:
            head = file.read(_RECORD.size)
            opcode, length = _RECORD.unpack(head)
            if opcode == 0 or file.tell() + length > self._size:
                return
            record = file.read(length)
            if opcode == Opcode.DATA_END:
                if DataEnd.read(_stream(record)).data_section_crc not in {0, checksum}:
                    raise SessionError("damaged: the checksum of its data does not match")
                self.content.complete = self.closed
                return
            checksum = zlib.crc32(record, zlib.crc32(head, checksum))
            self.take(opcode, record)

    def take(self, opcode: int, record: bytes) -> None:
        if opcode == Opcode.METADATA:
            metadata = Metadata.read(_stream(record))
            self.content.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.CHUNK:
            if self._formats is not None:  # choose the decoded topics, with room for all messages of the file
                start = position = self._file.tell()
                unpacked = MAX_CHUNK_BYTES  # of this chunk
                while position + _RECORD.size <= self._size:
                    self._file.seek(position)
                    code, length = _RECORD.unpack(self._file.read(_RECORD.size))
                    position += _RECORD.size + length
                    if code == Opcode.CHUNK and length >= _CHUNK_SIZES.size and position <= self._size:
                        *_, size = _CHUNK_SIZES.unpack(self._file.read(_CHUNK_SIZES.size))
                        unpacked += min(size, MAX_CHUNK_BYTES)
                self._file.seek(start)
                wires = self._formats(self.content.metadata.get(HEADER_RECORD, {}))
                capacity_bytes, self._formats = min(unpacked, self._bytes_left), None
                self.content.decoded = {topic: Decoder(wire, capacity_bytes) for topic, wire in wires.items()}
            chunk = Chunk.read(_stream(record))
            size = chunk.uncompressed_size
            if size > MAX_CHUNK_BYTES:
                raise SessionError(f"has a chunk of {size} bytes; at most {MAX_CHUNK_BYTES} are allowed")
            if chunk.compression == "lz4":
                data: bytes = LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
            elif chunk.compression == "":
                data = chunk.data
            else:
                raise SessionError(
                    f"has a chunk compressed with '{chunk.compression[:20]}'; allowed: lz4 or none"
                )
            if len(data) != size or zlib.crc32(data) != chunk.uncompressed_crc:
                raise SessionError("damaged: the checksum of a chunk does not match")
            self._take_chunk(data)

    def _take_chunk(self, chunk: bytes) -> None:
        self._bytes_left -= len(chunk)
        if self._bytes_left < 0:
            raise SessionError("unpacks to far more data than a session file of this size can hold")
        for opcode, start, end in _records(chunk, 0):
            if opcode == Opcode.MESSAGE:
                channel, sequence, _, _ = _MESSAGE.unpack_from(chunk, start)
                topic = self._topics.get(channel)
                if topic is None:
                    raise SessionError(f"damaged: a message belongs to no channel ({channel})")
                message = chunk[start + _MESSAGE.size : end]
                if decoder := self.content.decoded.get(topic):
                    decoder.add(message)
                else:
                    self.content.messages[topic].append(message)
                self.content.sequence[topic].append(sequence)
            elif opcode == Opcode.CHANNEL:
                record = Channel.read(_stream(chunk[start:end]))
                self._topics[record.id] = record.topic


def _records(data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each whole record from the position `at` on."""
    while at + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        start = at + _RECORD.size
        at = start + length
        if opcode == 0 or at > len(data):
            return
        yield opcode, start, at


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))


PROFILE = "palpate"
FORMAT_VERSIONS = ("1", "2")  # the second with messages that hold several records of a stream
HEADER_RECORD = "palpate.session"
EXTRA_RECORD = "palpate.extra"
END_RECORD = "palpate.end"
CHUNK_BYTES = 64 * 1024

_MESSAGE_HEADER_BYTES = 31


class McapFile:
    """Writes a session to an empty binary file, which the caller closes.

    Every method may raise OSError if the file cannot be written; its content up to then can be read.
    """

    def __init__(self, file: IO[bytes], streams: Sequence[Stream], metadata: SessionMetadata) -> None:
        self._file = file
        self._formats = {stream.name: WireFormat(stream) for stream in streams}
        # The library ends a chunk after the message that passes its limit; that message must fit as well.
        longest = max([MAX_EVENT_BYTES, *(wire.dtype.itemsize for wire in self._formats.values())])
        self._mcap: Any = Writer(
            file,
            chunk_size=CHUNK_BYTES - longest - _MESSAGE_HEADER_BYTES,
            compression=CompressionType.LZ4,
            enable_data_crcs=True,
        )
        self._mcap.start(profile=PROFILE)
        version = FORMAT_VERSIONS[any(stream.batch > 1 for stream in streams)]
        header = {"format_version": version, "streams": streams_to_json(tuple(streams))}
        for record, texts in (
            (HEADER_RECORD, header | metadata.to_strings()),
            (EXTRA_RECORD, metadata.extra),
        ):
            self._mcap.add_metadata(
                record, {replace_undecodable(key): replace_undecodable(text) for key, text in texts.items()}
            )
        self._channels = {EVENT_STREAM: self._register(EVENT_STREAM, event_descriptor_set(), {"time_s": "s"})}
        for name, wire in self._formats.items():
            units = {column.name: column.unit for column in wire.stream.columns}
            self._channels[name] = self._register(name, wire.descriptor_set(), units)
        self.flush()

    def _register(self, name: str, descriptor_set: bytes, units: dict[str, str]) -> int:
        schema: int = self._mcap.register_schema(f"{PACKAGE}.{name}", "protobuf", descriptor_set)
        channel: int = self._mcap.register_channel(name, "protobuf", schema, units)
        return channel

    def write_records(self, stream_name: str, sequence: NDArray[np.uint64], records: RecordArray) -> None:
        """Append records.

        Args:
            stream_name: name of the stream.
            sequence: numbers of the records, shape (n,); a message carries the number of its first record.
            records: shape (n,).
        """
        wire = self._formats[stream_name]
        first = slice(None, None, wire.stream.batch)
        times_ns, numbers = _nanoseconds(records[TIME_COLUMN][first]), sequence[first].tolist()
        for message, number, time_ns in zip(wire.encode(records), numbers, times_ns, strict=True):
            self._write(stream_name, number, time_ns, message)

    def write_events(
        self, sequence: Iterable[int], times_s: Sequence[float], events: Iterable[bytes]
    ) -> None:
        """Add encoded events.

        Args:
            sequence: their numbers.
            times_s: their times [s].
            events: messages.
        """
        times_ns = _nanoseconds(np.asarray(times_s, np.float64))
        for event, number, time_ns in zip(events, sequence, times_ns, strict=True):
            self._write(EVENT_STREAM, number, time_ns, event)

    def _write(self, stream_name: str, number: int, time_ns: int, data: bytes) -> None:
        channel = self._channels[stream_name]
        self._mcap.add_message(channel, time_ns, data, publish_time=time_ns, sequence=number & 0xFFFFFFFF)

    def flush(self) -> None:
        """Pass complete chunks to the operating system, which keeps them if this process is killed."""
        self._file.flush()

    def end_chunk(self) -> None:
        """Pass the current chunk to the operating system too."""
        self._mcap.flush()

    def finish(self, offered: Mapping[str, int]) -> None:
        """Write how many records were offered to each stream, then summary and index.

        Args:
            offered: number of records by stream name, with those that were dropped.
        """
        self._mcap.flush()
        self._mcap.add_metadata(END_RECORD, {name: str(count) for name, count in offered.items()})
        self._mcap.finish()
        self._file.flush()


def _nanoseconds(time_s: NDArray[np.float64]) -> list[int]:
    """Convert times for MCAP, which has no negative ones; the exact time stays in the record."""
    clipped = np.clip(np.nan_to_num(time_s, nan=0.0), 0.0, 9e9)
    nanoseconds: list[Any] = np.rint(clipped * 1e9).astype(np.uint64).tolist()
    return nanoseconds
