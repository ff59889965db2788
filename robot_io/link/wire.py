"""Frozen dataclasses as protobuf messages: the type is built from the fields at run time, no generated code.

float is a double, int an sfixed64, bool a bool, str a string, bytes are bytes, another dataclass is a message
of its own; a tuple of any of these is a repeated field. Fields are numbered from 1 in the order of the class.
"""

from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from robot_io.errors import ProtocolError
from robot_io.session.wire import PACKAGE, file_descriptor_set

_FIELD = descriptor_pb2.FieldDescriptorProto
_SCALARS = {
    float: _FIELD.TYPE_DOUBLE,
    int: _FIELD.TYPE_SFIXED64,
    bool: _FIELD.TYPE_BOOL,
    str: _FIELD.TYPE_STRING,
    bytes: _FIELD.TYPE_BYTES,
}
T = TypeVar("T")


class WireType(Generic[T]):
    """Encodes and decodes one dataclass; its own checks are made on whatever is decoded."""

    def __init__(self, kind: type[T]) -> None:
        self._kind = kind
        message = _describe(kind)
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(file_descriptor_set(message)).file:
            pool.Add(file)
        found = pool.FindMessageTypeByName(f"{PACKAGE}.{message.name}")
        self._message = message_factory.GetMessageClass(found)

    def encode(self, value: T) -> bytes:
        """The value as a protobuf message."""
        message = self._message()
        _fill(message, value)
        data: bytes = message.SerializeToString()
        return data

    def decode(self, data: bytes) -> T:
        """Read back what `encode` made.

        Raises:
            ProtocolError: the bytes are no such message, or a value is not valid.
        """
        try:
            return _read(self._message.FromString(data), self._kind)
        except (DecodeError, ValueError, TypeError) as error:
            raise ProtocolError(f"{self._kind.__name__}: {' '.join(str(error).split())[:200]}") from error


@cache
def _members(kind: Hashable) -> tuple[tuple[str, Any, bool, bool], ...]:
    """Name, type, and whether it is repeated and a message of its own, of each field."""
    hints = get_type_hints(kind)
    found = []
    for field in fields(kind):  # type: ignore[arg-type]
        hint = hints[field.name]
        repeated = get_origin(hint) is tuple
        member = get_args(hint)[0] if repeated else hint
        found.append((field.name, member, repeated, is_dataclass(member)))
    return tuple(found)


def _describe(kind: type) -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=kind.__name__)
    for number, (name, member, repeated, nested) in enumerate(_members(kind), start=1):
        field = message.field.add(name=name, json_name=name, number=number)
        field.label = _FIELD.LABEL_REPEATED if repeated else _FIELD.LABEL_OPTIONAL
        if nested:
            inner = _describe(member)
            message.nested_type.append(inner)
            field.type, field.type_name = _FIELD.TYPE_MESSAGE, inner.name
        else:
            field.type = _SCALARS[member]
    return message


def _fill(message: Any, value: object) -> None:  # noqa: ANN401, built at run time
    for name, _, repeated, nested in _members(type(value)):  # type: ignore[arg-type]
        content = getattr(value, name)
        if not nested:
            if repeated:
                getattr(message, name).extend(content)
            else:
                setattr(message, name, content)
        elif repeated:
            for one in content:
                _fill(getattr(message, name).add(), one)
        else:
            _fill(getattr(message, name), content)


def _read(message: Any, kind: type[T]) -> T:  # noqa: ANN401, built at run time
    values: dict[str, object] = {}
    for name, member, repeated, nested in _members(kind):  # type: ignore[arg-type]
        content = getattr(message, name)
        if nested:
            read = tuple(_read(one, member) for one in (content if repeated else (content,)))
            values[name] = read if repeated else read[0]
        else:
            values[name] = tuple(content) if repeated else content
    return kind(**values)
