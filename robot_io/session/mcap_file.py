"""Writes records and events into one MCAP file; the live writer process and `write_session` both use it.

MCAP: https://mcap.dev/spec
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import IO

import numpy as np
from numpy.typing import NDArray

from robot_io.session.event import EVENT_STREAM, MAX_EVENT_BYTES, event_descriptor_set
from robot_io.session.mcap_writer import McapWriter
from robot_io.session.metadata import SessionMetadata
from robot_io.session.stream import TIME_COLUMN, RecordArray, Stream, streams_to_json
from robot_io.session.wire import PACKAGE, WireFormat

PROFILE = "palpate"
FORMAT_VERSION = "1"
HEADER_RECORD = "palpate.session"
EXTRA_RECORD = "palpate.extra"
END_RECORD = "palpate.end"
CHUNK_BYTES = 64 * 1024

_MESSAGE_HEADER_BYTES = 31


class McapFile:
    """A session being written.

    Args:
        file: binary, at its start, writable and able to tell its position; the caller closes it.
        streams: the streams that will come.
        metadata: where the session comes from.

    Every method may raise OSError if the file cannot be written; what is in it up to then can be read.
    """

    def __init__(self, file: IO[bytes], streams: Sequence[Stream], metadata: SessionMetadata) -> None:
        self._file = file
        self._formats = {stream.name: WireFormat(stream) for stream in streams}
        # A chunk ends with the message that passes its limit; that message must fit as well.
        longest = max([MAX_EVENT_BYTES, *(wire.dtype.itemsize for wire in self._formats.values())])
        self._mcap = McapWriter(file, PROFILE, CHUNK_BYTES - longest - _MESSAGE_HEADER_BYTES)
        header = {"format_version": FORMAT_VERSION, "streams": streams_to_json(tuple(streams))}
        self._mcap.add_metadata(HEADER_RECORD, header | metadata.to_strings())
        self._mcap.add_metadata(EXTRA_RECORD, dict(metadata.extra))
        self._channels = {EVENT_STREAM: self._register(EVENT_STREAM, event_descriptor_set(), {"time_s": "s"})}
        for name, wire in self._formats.items():
            units = {column.name: column.unit for column in wire.stream.columns}
            self._channels[name] = self._register(name, wire.descriptor_set(), units)
        self.flush()

    def _register(self, name: str, descriptor_set: bytes, units: dict[str, str]) -> int:
        return self._mcap.register_channel(name, f"{PACKAGE}.{name}", "protobuf", descriptor_set, units)

    def write_records(self, stream_name: str, sequence: NDArray[np.uint64], records: RecordArray) -> None:
        """Add records, shape (n,), with their sequence numbers, shape (n,)."""
        messages = self._formats[stream_name].encode(records)
        times_ns = _nanoseconds(records[TIME_COLUMN])
        self._mcap.add_messages(self._channels[stream_name], sequence, times_ns, messages)

    def write_events(
        self, sequence: Iterable[int], times_s: Sequence[float], events: Iterable[bytes]
    ) -> None:
        """Add events that are encoded already, with their sequence numbers and times [s]."""
        times_ns = _nanoseconds(np.asarray(times_s, np.float64))
        for row, (event, number) in enumerate(zip(events, sequence, strict=True)):
            message, numbers = np.frombuffer(event, np.uint8)[None], np.array([number], np.uint64)
            self._mcap.add_messages(self._channels[EVENT_STREAM], numbers, times_ns[row : row + 1], message)

    def flush(self) -> None:
        """Hand the whole chunks to the operating system, which keeps them if this process is killed."""
        self._file.flush()

    def end_chunk(self) -> None:
        """End the chunk in progress too, and hand it over."""
        self._mcap.end_chunk()
        self._file.flush()

    def finish(self, offered: Mapping[str, int]) -> None:
        """Write how many records were offered to each stream, then summary and index."""
        self._mcap.end_chunk()
        self._mcap.add_metadata(END_RECORD, {name: str(count) for name, count in offered.items()})
        self._mcap.finish()
        self._file.flush()


def _nanoseconds(time_s: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Times for MCAP, which knows no negative ones; the exact time stays in the record."""
    clipped = np.clip(np.nan_to_num(time_s, nan=0.0), 0.0, 9e9)
    return np.rint(clipped * 1e9).astype(np.uint64)
