"""Writes MCAP files from whole arrays of messages, in the same bytes as the library's writer.

That one takes one message at a time, some ten microseconds each: a minute for an hour at 1 kHz. Records of
every other kind are the library's own.

MCAP: https://mcap.dev/spec
"""

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import IO, Any

import lz4.frame
import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import LIBRARY_IDENTIFIER, MCAP0_MAGIC
from numpy.typing import NDArray

_COMPRESSION = "lz4"
_FOOTER_HEAD = struct.Struct("<BQQQ")  # opcode, length, and the two places that the checksum covers
_FOOTER_BYTES = 20
_RECORD_HEAD_BYTES = 9  # opcode and length
_MESSAGE_HEAD = [("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
_INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


@dataclass
class _Chunk:
    """What is in the chunk in progress: its bytes, and time and place of its messages by channel."""

    content: bytearray = field(default_factory=bytearray)
    index: dict[int, list[NDArray[np.void]]] = field(default_factory=dict)

    def times(self) -> tuple[int, int]:
        """The first and the last time of its messages [ns]."""
        parts = [part["time"] for parts in self.index.values() for part in parts]
        return min(int(part.min()) for part in parts), max(int(part.max()) for part in parts)


class McapWriter:
    """An MCAP file being written, in chunks compressed by LZ4.

    Args:
        file: binary, at its start, writable and able to tell its position; the caller closes it.
        profile: what the file is for, in a word.
        chunk_bytes: a chunk ends with the message that passes this size.
    """

    def __init__(self, file: IO[bytes], profile: str, chunk_bytes: int) -> None:
        self._file, self._chunk_bytes = file, chunk_bytes
        self._checksum = 0
        self._chunk = _Chunk()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_indices: list[ChunkIndex] = []
        self._metadata_indices: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._write(MCAP0_MAGIC + _bytes(Header(profile, LIBRARY_IDENTIFIER)))

    def register_channel(
        self, name: str, schema_name: str, encoding: str, schema: bytes, metadata: dict[str, str]
    ) -> int:
        """Describe a channel and the schema of its messages, and return the channel's number."""
        number = len(self._channels) + 1
        self._schemas.append(Schema(id=number, data=schema, encoding=encoding, name=schema_name))
        self._channels.append(
            Channel(id=number, topic=name, message_encoding=encoding, schema_id=number, metadata=metadata)
        )
        self._chunk.content += _bytes(self._schemas[-1]) + _bytes(self._channels[-1])
        return number

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        record, offset = _bytes(Metadata(name=name, metadata=values)), self._file.tell()
        self._write(record)
        self._metadata_indices.append(MetadataIndex(offset=offset, length=len(record), name=name))

    def add_messages(
        self,
        channel: int,
        sequence: NDArray[np.uint64],
        times_ns: NDArray[np.uint64],
        messages: NDArray[np.uint8],
    ) -> None:
        """Add n messages of one length, shape (n, size), with numbers and times [ns], shape (n,) each."""
        records = _message_records(channel, sequence, times_ns, messages)
        size, start = records.itemsize, 0
        while start < len(records):
            content = self._chunk.content
            room = max(1, (self._chunk_bytes - len(content)) // size + 1)
            part = records[start : start + room]
            entries = np.empty(len(part), _INDEX_ENTRY)
            entries["time"] = part["log_time"]
            entries["offset"] = len(content) + size * np.arange(len(part))
            self._chunk.index.setdefault(channel, []).append(entries)
            content += part.tobytes()
            if len(content) > self._chunk_bytes:
                self.end_chunk()
            start += room
        if len(records):
            self._counts[channel] = self._counts.get(channel, 0) + len(records)

    def end_chunk(self) -> None:
        """Write the chunk in progress, if it holds a message, and its index."""
        chunk = self._chunk
        if not chunk.index:
            return
        self._chunk = _Chunk()
        content, (first, last) = bytes(chunk.content), chunk.times()
        packed: bytes = lz4.frame.compress(content)
        record = _bytes(
            Chunk(
                compression=_COMPRESSION,
                data=packed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(content),
                uncompressed_size=len(content),
            )
        )
        start = self._file.tell()
        indices, offsets = b"", {}
        for channel, parts in chunk.index.items():
            offsets[channel] = start + len(record) + len(indices)
            indices += _message_index(channel, parts)
        self._write(record + indices)
        self._chunk_indices.append(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=start,
                chunk_length=len(record),
                message_index_offsets=offsets,
                message_index_length=len(indices),
                compression=_COMPRESSION,
                compressed_size=len(packed),
                uncompressed_size=len(content),
            )
        )

    def finish(self) -> None:
        """Write the last chunk, and summary and index."""
        self.end_chunk()
        self._write(_bytes(DataEnd(self._checksum)))
        start = self._file.tell()
        summary, offsets = b"", b""
        for opcode, records in self._summary():
            group = b"".join(map(_bytes, records))
            offsets += _bytes(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
            )
            summary += group
        offset_start = start + len(summary)
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, _FOOTER_BYTES, start, offset_start)
        checksum = zlib.crc32(head, zlib.crc32(summary + offsets))
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=checksum)
        self._file.write(summary + offsets + _bytes(footer) + MCAP0_MAGIC)

    def _summary(self) -> Iterable[tuple[Opcode, Iterable[McapRecord]]]:
        """The groups of the summary, none of attachments included, as the library has it."""
        firsts = [index.message_start_time for index in self._chunk_indices]
        lasts = [index.message_end_time for index in self._chunk_indices]
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indices),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata_indices),
            message_start_time=min(firsts, default=0),
            message_end_time=max(lasts, default=0),
            schema_count=len(self._schemas),
        )
        return (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunk_indices),
            (Opcode.ATTACHMENT_INDEX, []),
            (Opcode.METADATA_INDEX, self._metadata_indices),
        )

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._checksum = zlib.crc32(data, self._checksum)


def _bytes(record: McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data


def _message_records(
    channel: int, sequence: NDArray[np.uint64], times_ns: NDArray[np.uint64], messages: NDArray[np.uint8]
) -> NDArray[np.void]:
    """Whole records, head and message each, shape (n,)."""
    size = messages.shape[1]
    head: list[Any] = [("opcode", "u1"), ("length", "<u8"), *_MESSAGE_HEAD, ("data", "u1", (size,))]
    records = np.empty(len(messages), head)
    records["opcode"] = Opcode.MESSAGE
    records["length"] = records.itemsize - _RECORD_HEAD_BYTES
    records["channel"] = channel
    records["sequence"] = sequence & 0xFFFFFFFF
    records["log_time"] = records["publish_time"] = times_ns
    records["data"] = messages
    return records


def _message_index(channel: int, parts: list[NDArray[np.void]]) -> bytes:
    """Time and place of a channel's messages in a chunk, as the record that follows it."""
    entries = np.concatenate(parts).tobytes()
    builder: Any = RecordBuilder()
    builder.start_record(Opcode.MESSAGE_INDEX)
    builder.write2(channel)
    builder.write4(len(entries))
    builder.write(entries)
    builder.finish_record()
    data: bytes = builder.end()
    return data
