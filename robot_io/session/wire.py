"""A stream's records as protobuf messages, many at once.

Every column is written in every message, in order, and only with types of fixed size. All messages of a
stream then have the same length, with the same tag bytes at the same places, and a numpy structured type with
gaps for the tags reads and writes them as whole arrays. Any protobuf library reads the messages with the
descriptor that is stored beside them.

Encoding: https://protobuf.dev/programming-guides/encoding/
"""

from functools import cached_property

import numpy as np
from google.protobuf import descriptor_pb2
from numpy.typing import NDArray

from robot_io.errors import SessionError
from robot_io.session.stream import Column, RecordArray, Stream

PACKAGE = "palpate"

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
        """The stream's columns at their places in a message, with gaps where the tags are."""
        offsets, end = [], 0
        for column, tag in zip(self.stream.columns, self._tags, strict=True):
            offsets.append(end + len(tag))
            end = offsets[-1] + column.width * column.scalar_dtype.itemsize
        return np.dtype(
            {
                "names": [c.name for c in self.stream.columns],
                "formats": [(c.scalar_dtype, c.shape) for c in self.stream.columns],
                "offsets": offsets,
                "itemsize": end,
            }
        )

    @cached_property
    def _tags(self) -> list[bytes]:
        return [_tag(number, column) for number, column in enumerate(self.stream.columns, start=1)]

    @cached_property
    def _template(self) -> NDArray[np.uint8]:
        """A message with all values zero."""
        zeros = (bytes(c.width * c.scalar_dtype.itemsize) for c in self.stream.columns)
        parts = (tag + zero for tag, zero in zip(self._tags, zeros, strict=True))
        return np.frombuffer(b"".join(parts), np.uint8)

    @cached_property
    def _is_tag(self) -> NDArray[np.bool_]:
        parts = [
            np.arange(len(tag) + c.width * c.scalar_dtype.itemsize) < len(tag)
            for tag, c in zip(self._tags, self.stream.columns, strict=True)
        ]
        return np.concatenate(parts)

    def encode(self, records: RecordArray) -> NDArray[np.uint8]:
        """One message for each record of the stream's dtype, (n,): shape (n, bytes of a message)."""
        messages = np.tile(self._template, len(records)).view(self.dtype)
        for name in self.stream.dtype.names or ():
            messages[name] = records[name]
        return messages.view(np.uint8).reshape(len(records), self.dtype.itemsize)

    def decode(self, messages: bytes) -> RecordArray:
        """Records, shape (n,), from n messages one after the other; a view with the gaps of `dtype`.

        SessionError: the bytes are not messages of this form.
        """
        where, size, tags = f"stream '{self.stream.name}'", self.dtype.itemsize, self._is_tag
        if len(messages) % size:
            raise SessionError(f"{where}: a message is not {size} bytes long")
        raw = np.frombuffer(messages, np.uint8).reshape(-1, size)
        if (raw[:, tags] != self._template[tags]).any():
            raise SessionError(f"{where}: a message's fields are not those of its columns")
        return raw.reshape(-1).view(self.dtype)

    def descriptor_set(self) -> bytes:
        """The message type as a serialised FileDescriptorSet, as MCAP wants it for protobuf."""
        message = descriptor_pb2.DescriptorProto(name=self.stream.name)
        for number, column in enumerate(self.stream.columns, start=1):
            message.field.add(
                name=column.name,
                json_name=column.name,
                number=number,
                type=_PROTOBUF_TYPE[str(column.dtype)],
                label=_FIELD.LABEL_OPTIONAL if column.width == 1 else _FIELD.LABEL_REPEATED,
            )
        return file_descriptor_set(message)


def file_descriptor_set(message: descriptor_pb2.DescriptorProto) -> bytes:
    """Wrap one message type into a serialised proto3 FileDescriptorSet."""
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{PACKAGE}/{message.name}.proto", package=PACKAGE, syntax="proto3", message_type=[message]
    )
    data: bytes = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    return data


def _tag(number: int, column: Column) -> bytes:
    size = column.scalar_dtype.itemsize
    if column.width == 1:
        return _varint(number << 3 | _WIRE_TYPE[size])
    return _varint(number << 3 | _LENGTH) + _varint(column.width * size)


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
