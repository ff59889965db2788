"""Frozen dataclasses as protobuf messages; the type is built from the fields at run time.

float is a double, int an sfixed64, bool a bool, str a string, bytes are bytes, another dataclass is a message
of its own; a tuple of any of these is a repeated field. Fields are numbered from 1 in the order of the class.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, Generic, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.message import DecodeError

from robot_io.errors import ProtocolError
from robot_io.session.wire import descriptor_of

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
    """Encodes and decodes one dataclass or named tuple; its own checks run on every decoded value.

    Args:
        kind: the class.
    """

    def __init__(self, kind: type[T]) -> None:
        self._codec = _Codec(kind, descriptor_of(_describe(kind)))
        self._name = kind.__name__

    def encode(self, value: T) -> bytes:
        """Encode a value.

        Args:
            value: of the class.

        Returns:
            A protobuf message.
        """
        data: bytes = self._codec.build(value).SerializeToString()
        return data

    def decode(self, data: bytes) -> T:
        """Decode what `encode` made.

        Args:
            data: a protobuf message.

        Returns:
            The value.

        Raises:
            ProtocolError: the bytes are no such message, or a value is invalid.
        """
        try:
            value: T = self._codec.read(self._codec.message.FromString(data))
        except (DecodeError, ValueError, TypeError) as error:
            raise ProtocolError(f"{self._name}: {' '.join(str(error).split())[:200]}") from error
        return value


class _Codec:
    """One class and its message type; what is nested has a codec of its own."""

    def __init__(self, kind: type, descriptor: Any) -> None:  # noqa: ANN401, built at run time
        members = _members(kind)
        self._kind, self.message = kind, message_factory.GetMessageClass(descriptor)
        self._names = tuple(member.name for member in members)
        self._values = attrgetter(*self._names)
        self._build: list[tuple[str, Callable[[Any], object]]] = []  # fields that are not taken as they are
        self._read: list[tuple[int, Callable[[Any], object]]] = []
        for place, member in enumerate(members):
            if member.kind not in _SCALARS:
                inner = _Codec(member.kind, descriptor.fields_by_name[member.name].message_type)
                each = member.repeated
                self._build.append((member.name, partial(_each, inner.build) if each else inner.build))
                self._read.append((place, partial(_each, inner.read) if each else inner.read))
            elif member.repeated:
                self._read.append((place, _as_tuple))

    def build(self, value: object) -> Any:  # noqa: ANN401, built at run time
        values = dict(zip(self._names, self._values(value), strict=False))
        for name, build in self._build:
            values[name] = build(values[name])
        return self.message(**values)

    def read(self, message: Any) -> Any:  # noqa: ANN401, built at run time
        values = list(self._values(message))
        for place, read in self._read:
            values[place] = read(values[place])
        return self._kind(*values)


def _each(convert: Callable[[Any], Any], values: Iterable[Any]) -> tuple[Any, ...]:
    return tuple([convert(value) for value in values])  # faster than of a generator


def _as_tuple(values: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(values[:])  # twice as fast as one by one


class _Member(NamedTuple):
    """A field of a class."""

    name: str
    kind: type
    repeated: bool


def _members(kind: type) -> list[_Member]:
    members = []
    for name, hint in get_type_hints(kind).items():
        repeated = get_origin(hint) is tuple
        members.append(_Member(name, get_args(hint)[0] if repeated else hint, repeated))
    return members


def _describe(kind: type) -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=kind.__name__)
    for number, member in enumerate(_members(kind), start=1):
        field = message.field.add(name=member.name, json_name=member.name, number=number)
        field.label = _FIELD.LABEL_REPEATED if member.repeated else _FIELD.LABEL_OPTIONAL
        if member.kind in _SCALARS:
            field.type = _SCALARS[member.kind]
            continue
        inner = _describe(member.kind)
        message.nested_type.append(inner)
        field.type, field.type_name = _FIELD.TYPE_MESSAGE, inner.name
    return message
