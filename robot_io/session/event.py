"""Something that happened once: a trip, a re-arm, a mark by the operator."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.message import DecodeError, Message

from robot_io.errors import SessionError
from robot_io.session.wire import descriptor_of, file_descriptor_set

EVENT_STREAM = "events"
MAX_EVENT_BYTES = 4000

_FIELD = descriptor_pb2.FieldDescriptorProto
_CUT = " [cut]"
_LOG, _UNCLOSED = "log", "the program ended without closing the session"


@dataclass(frozen=True)
class Event:
    """One event of a session."""

    time_s: float  # when, on the clock of the session's streams [s]
    kind: str  # a short word to filter by, such as "trip"
    text: str  # one line for people
    # Values for programs, as JSON can hold them; None if there are none.
    data: Mapping[str, Any] | None = None


def unclosed(time_s: float) -> Event:
    """The last event of a session whose program was killed [s]."""
    return Event(time_s, _LOG, _UNCLOSED)


def says_unclosed(event: Event) -> bool:
    """Whether it is that event."""
    return (event.kind, event.text) == (_LOG, _UNCLOSED)


def _event_type() -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=EVENT_STREAM)
    types = {"time_s": _FIELD.TYPE_DOUBLE} | dict.fromkeys(("kind", "text", "data_json"), _FIELD.TYPE_STRING)
    for number, (name, kind) in enumerate(types.items(), start=1):
        message.field.add(name=name, json_name=name, number=number, type=kind, label=_FIELD.LABEL_OPTIONAL)
    return message


_EventMessage: type[Message] = message_factory.GetMessageClass(descriptor_of(_event_type()))


def event_descriptor_set() -> bytes:
    """The events' message type as a serialised FileDescriptorSet."""
    return file_descriptor_set(_event_type())


def encode_event(event: Event) -> bytes:
    """The event as a protobuf message of at most `MAX_EVENT_BYTES`; what is too long is cut and says so.

    Numpy's numbers and arrays are kept as numbers and lists; what else JSON does not know, as its text.
    """
    keyed = {str(key): value for key, value in (event.data or {}).items()}
    data_json = "" if event.data is None else json.dumps(keyed, default=_plain)
    encoded = _serialised(event, event.text, data_json)
    if len(encoded) <= MAX_EVENT_BYTES:
        return encoded
    text = event.text.encode(errors="replace")[: MAX_EVENT_BYTES // 2].decode(errors="ignore")
    return _serialised(event, text + _CUT, "")


def _serialised(event: Event, text: str, data_json: str) -> bytes:
    kind, text = (word.encode(errors="replace").decode() for word in (event.kind[:64], text))
    message = _EventMessage(time_s=event.time_s, kind=kind, text=text, data_json=data_json)
    data: bytes = message.SerializeToString()
    return data


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def decode_event(data: bytes) -> Event:
    """Read back what `encode_event` made. SessionError: the bytes are no event."""
    try:
        message = _EventMessage.FromString(data)
        values = json.loads(message.data_json) if message.data_json else None
    except (DecodeError, ValueError, RecursionError) as error:
        raise SessionError(f"an event cannot be read: {error}") from error
    if not isinstance(values, dict | None):
        raise SessionError(f"an event's data is not a JSON object: {message.data_json[:80]}")
    return Event(message.time_s, message.kind, message.text, values)
