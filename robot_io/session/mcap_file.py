"""Writes records and events into one MCAP file; the live writer process and `write_session` both use it.

MCAP: https://mcap.dev/spec
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from robot_io.files.utf8 import as_utf8
from robot_io.session.event import EVENT_STREAM, MAX_EVENT_BYTES, event_descriptor_set
from robot_io.session.metadata import SessionMetadata
from robot_io.session.stream import TIME_COLUMN, RecordArray, Stream, streams_to_json
from robot_io.session.wire import PACKAGE, WireFormat

PROFILE = "palpate"
FORMAT_VERSIONS = ("1", "2")  # the second with messages that hold several records of a stream
HEADER_RECORD = "palpate.session"
EXTRA_RECORD = "palpate.extra"
END_RECORD = "palpate.end"
CHUNK_BYTES = 64 * 1024

_MESSAGE_HEADER_BYTES = 31


class McapFile:
    """A session being written to a binary file at its start, which the caller closes.

    Every method may raise OSError if the file cannot be written; what is in it up to then can be read.
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
            self._mcap.add_metadata(record, {as_utf8(key): as_utf8(text) for key, text in texts.items()})
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
        """Add records, shape (n,), with their sequence numbers, shape (n,); a message has its first one's."""
        wire = self._formats[stream_name]
        first = slice(None, None, wire.stream.batch)
        times_ns, numbers = _nanoseconds(records[TIME_COLUMN][first]), sequence[first].tolist()
        for message, number, time_ns in zip(wire.encode(records), numbers, times_ns, strict=True):
            self._write(stream_name, number, time_ns, message)

    def write_events(
        self, sequence: Iterable[int], times_s: Sequence[float], events: Iterable[bytes]
    ) -> None:
        """Add events that are encoded already, with their sequence numbers and times [s]."""
        times_ns = _nanoseconds(np.asarray(times_s, np.float64))
        for event, number, time_ns in zip(events, sequence, times_ns, strict=True):
            self._write(EVENT_STREAM, number, time_ns, event)

    def _write(self, stream_name: str, number: int, time_ns: int, data: bytes) -> None:
        channel = self._channels[stream_name]
        self._mcap.add_message(channel, time_ns, data, publish_time=time_ns, sequence=number & 0xFFFFFFFF)

    def flush(self) -> None:
        """Hand the whole chunks to the operating system, which keeps them if this process is killed."""
        self._file.flush()

    def end_chunk(self) -> None:
        """End the chunk in progress too, and hand it over."""
        self._mcap.flush()

    def finish(self, offered: Mapping[str, int]) -> None:
        """Write how many records were offered to each stream, then summary and index."""
        self._mcap.flush()
        self._mcap.add_metadata(END_RECORD, {name: str(count) for name, count in offered.items()})
        self._mcap.finish()
        self._file.flush()


def _nanoseconds(time_s: NDArray[np.float64]) -> list[int]:
    """Times for MCAP, which knows no negative ones; the exact time stays in the record."""
    clipped = np.clip(np.nan_to_num(time_s, nan=0.0), 0.0, 9e9)
    nanoseconds: list[Any] = np.rint(clipped * 1e9).astype(np.uint64).tolist()
    return nanoseconds
