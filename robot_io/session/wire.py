"""A stream's records as protobuf messages, many at once.

Every message holds all columns, in order, with types of fixed size only. All messages of a stream then have
the same length, with the same tag bytes at the same places: a numpy structured type with gaps for the tags
reads and writes them as whole arrays. If a message holds several records, each field has the values of all of
them, and only the last message may be shorter. Any protobuf library reads the messages with the descriptor
that is stored beside them.

Encoding: https://protobuf.dev/programming-guides/encoding/
"""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2
from numpy.typing import NDArray

from palpate.robot_io.errors import SessionError
from palpate.robot_io.session.stream import Column, RecordArray, Stream

PACKAGE = "palpate"

_DECODED_BYTES = 4 * 1024 * 1024  # messages that are decoded at once
_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5
_FIELD = descriptor_pb2.FieldDescriptorProto
_PROTOBUF_TYPE = {
    "float64": _FIELD.TYPE_DOUBLE,
    "float32": _FIELD.TYPE_FLOAT,
    "int64": _FIELD.TYPE_SFIXED64,
    "int32": _FIELD.TYPE_SFIXED32,
    "uint64": _FIELD.TYPE_FIXED64,
    "uint32": _FIELD.TYPE_FIXED32,
    "bool": _FIELD.TYPE_BOOL,
}
_WIRE_TYPE = {8: _FIXED64, 4: _FIXED32, 1: _VARINT}  # by size; a bool is a varint of one byte


class WireFormat:
    """Encodes and decodes the records of one stream."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Columns at their places in a message, shape (batch,) or (batch, width), with gaps for the tags."""
        offsets, end = [], 0
        for column, tag in zip(self.stream.columns, self._tags, strict=True):
            offsets.append(end + len(tag))
            end = offsets[-1] + self._value_bytes(column)
        return np.dtype(
            {
                "names": [c.name for c in self.stream.columns],
                "formats": [(c.scalar_dtype, (self.stream.batch, *c.shape)) for c in self.stream.columns],
                "offsets": offsets,
                "itemsize": end,
            }
        )

    @cached_property
    def _tags(self) -> list[bytes]:
        return [
            _varint(number << 3 | _LENGTH) + _varint(self._value_bytes(column))
            if self._is_packed(column)
            else _varint(number << 3 | _WIRE_TYPE[column.scalar_dtype.itemsize])
            for number, column in enumerate(self.stream.columns, start=1)
        ]

    def _value_bytes(self, column: Column) -> int:
        return self.stream.batch * column.width * column.scalar_dtype.itemsize

    def _is_packed(self, column: Column) -> bool:
        return self.stream.batch * column.width > 1

    @cached_property
    def _template(self) -> NDArray[np.uint8]:
        """A message with all values zero."""
        zeros = (bytes(self._value_bytes(c)) for c in self.stream.columns)
        parts = (tag + zero for tag, zero in zip(self._tags, zeros, strict=True))
        return np.frombuffer(b"".join(parts), np.uint8)

    @cached_property
    def _is_tag(self) -> NDArray[np.bool_]:
        parts = [
            np.arange(len(tag) + self._value_bytes(c)) < len(tag)
            for tag, c in zip(self._tags, self.stream.columns, strict=True)
        ]
        return np.concatenate(parts)

    def encode(self, records: RecordArray) -> list[bytes]:
        """Encode records as messages, of which only the last may hold less than a batch.

        Args:
            records: records of the stream's dtype, shape (n,).
        """
        size, whole_count = self.dtype.itemsize, len(records) // self.stream.batch
        messages = np.tile(self._template, whole_count).view(self.dtype)
        for column in self.stream.columns:
            values = records[column.name][: whole_count * self.stream.batch]
            messages[column.name] = values.reshape(-1, self.stream.batch, *column.shape)
        data, rest = messages.tobytes(), records[whole_count * self.stream.batch :]
        last = self._with_batch(len(rest)).encode(rest) if len(rest) else []
        return [data[start : start + size] for start in range(0, len(data), size)] + last

    def decode(self, messages: bytes) -> dict[str, NDArray[Any]]:
        """Decode messages to columns of shape (n,) or (n, width).

        Args:
            messages: messages made by `encode`, joined.

        Raises:
            SessionError: the bytes are not messages of this form.
        """
        whole_bytes = len(messages) // self.dtype.itemsize * self.dtype.itemsize
        parts = [self._view(memoryview(messages)[:whole_bytes])]
        if rest := memoryview(messages)[whole_bytes:]:
            shorter = map(self._with_batch, range(1, self.stream.batch))
            last = next((form for form in shorter if form.dtype.itemsize == len(rest)), None)
            if last is None:
                raise SessionError(
                    f"stream '{self.stream.name}': a message is not {self.dtype.itemsize} bytes long"
                )
            parts.append(last._view(rest))
        return {
            column.name: np.concatenate([part[column.name].reshape(-1, *column.shape) for part in parts])
            for column in self.stream.columns
        }

    def _with_batch(self, batch: int) -> "WireFormat":
        """Return the same stream's format with a number of records per message."""
        return WireFormat(replace(self.stream, batch=batch))

    def _view(self, messages: memoryview) -> RecordArray:
        """View whole messages as records of `dtype`; raise `SessionError` if a tag differs."""
        raw, tags = np.frombuffer(messages, np.uint8).reshape(-1, self.dtype.itemsize), self._is_tag
        if (raw[:, tags] != self._template[tags]).any():
            raise SessionError(f"stream '{self.stream.name}': a message's fields do not match its columns")
        return raw.reshape(-1).view(self.dtype)

    def descriptor_set(self) -> bytes:
        """Serialize the message type as a FileDescriptorSet, as MCAP needs it for protobuf."""
        message = descriptor_pb2.DescriptorProto(name=self.stream.name)
        for number, column in enumerate(self.stream.columns, start=1):
            message.field.add(
                name=column.name,
                json_name=column.name,
                number=number,
                type=_PROTOBUF_TYPE[str(column.dtype)],
                label=_FIELD.LABEL_REPEATED if self._is_packed(column) else _FIELD.LABEL_OPTIONAL,
            )
        return file_descriptor_set(message)


class Decoder:
    """Decodes the messages of one stream while they arrive, so that they need not be held beside the columns.

    Args:
        max_bytes: upper limit of the total length of all messages, for which address space is reserved.
    """

    def __init__(self, wire: WireFormat, max_bytes: int) -> None:
        self._wire, self._undecoded, self._rows = wire, bytearray(), 0
        self._error: SessionError | None = None  # raised once the whole file has been read
        capacity = (max_bytes // wire.dtype.itemsize + 1) * wire.stream.batch
        self._columns: dict[str, NDArray[Any]] = {
            c.name: np.empty((capacity, *c.shape), c.scalar_dtype) for c in wire.stream.columns
        }

    def add(self, message: bytes) -> None:
        """Take the next message.

        Args:
            message: message made by `WireFormat.encode`.
        """
        self._undecoded += message
        if len(self._undecoded) >= _DECODED_BYTES:
            self._decode()

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all columns, shape (n,) or (n, width); raise `SessionError` if a message is invalid."""
        self._decode()
        if self._error is not None:
            raise self._error
        return {name: column[: self._rows] for name, column in self._columns.items()}

    def _decode(self) -> None:
        messages = bytes(self._undecoded)
        self._undecoded.clear()
        try:
            columns, rows = self._wire.decode(messages), self._rows
        except SessionError as error:
            self._error = self._error or error
            return
        for name, values in columns.items():
            self._rows = rows + len(values)
            self._columns[name][rows : self._rows] = values


def file_descriptor_set(message: descriptor_pb2.DescriptorProto) -> bytes:
    """Wrap one message type into a serialized proto3 FileDescriptorSet."""
    name = f"{PACKAGE}/{message.name}.proto"
    file = descriptor_pb2.FileDescriptorProto(
        name=name, package=PACKAGE, syntax="proto3", message_type=[message]
    )
    data: bytes = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    return data


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
