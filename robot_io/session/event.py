"""Metadata and events of a session."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.message import DecodeError, Message

from palpate.robot_io.errors import InputError, SessionError
from palpate.robot_io.session.wire import PACKAGE, file_descriptor_set

# Keys of further texts of a session.
RUN_LABELS = "run_labels"  # names of the data file's runs, as JSON
NOT_WHOLE = "not_whole"  # incomplete sessions among those merged


@dataclass(frozen=True)
class SessionMetadata:
    """Origin of a session. Texts are whole files, not paths; missing ones are empty.

    Raises:
        InputError: a value of the wrong type, or an invalid date.
    """

    robot_file: str = ""  # text of the robot file
    urdf: str = ""  # text of the arm's URDF
    calibration: str = ""  # text of the calibration that was applied
    scenario: str = ""  # text of the simulated scenario
    software_version: str = ""  # version of palpate
    seed: int | None = None  # of every random number in the run; None if nothing was drawn
    created_utc: str = ""  # start of the session on the wall clock, ISO 8601
    command_line: str = ""  # how the program was started
    extra: Mapping[str, str] = field(default_factory=dict)  # further texts

    def __post_init__(self) -> None:
        texts = {name: getattr(self, name) for name in _TEXTS} | dict(self.extra)
        for name, value in texts.items():
            if not isinstance(name, str) or not isinstance(value, str):
                raise InputError(f"session metadata '{name}': {value!r} is not text")
        if self.seed is not None and not isinstance(self.seed, int):
            raise InputError(f"session metadata 'seed': {self.seed!r} is not a whole number")
        try:
            if self.created_utc:
                datetime.fromisoformat(self.created_utc)
        except ValueError as error:
            problem = f"{self.created_utc!r} is not ISO 8601"
            raise InputError(f"session metadata 'created_utc': {problem}") from error

    def to_strings(self) -> dict[str, str]:
        """Convert all fields except `extra` to text for the file's header."""
        seed = "" if self.seed is None else str(self.seed)
        return {name: getattr(self, name) for name in _TEXTS} | {"seed": seed}

    @classmethod
    def from_strings(cls, strings: Mapping[str, str], extra: Mapping[str, str]) -> "SessionMetadata":
        """Convert the header's text back; raise `SessionError` if a value is invalid.

        Args:
            strings: texts made by `to_strings`.
            extra: the other texts.
        """
        seed = strings.get("seed", "")
        try:
            texts = {name: strings.get(name, "") for name in _TEXTS}
            return cls(**texts, seed=int(seed) if seed else None, extra=dict(extra))
        except ValueError as error:
            raise SessionError(f"the session's metadata is not valid: {error}") from error


_TEXTS = tuple(f.name for f in fields(SessionMetadata) if f.name not in {"seed", "extra"})


EVENT_STREAM = "events"
MAX_EVENT_BYTES = 4000

_FIELD = descriptor_pb2.FieldDescriptorProto
_CUT = " [cut]"
# Kind and text of the last event of a session whose program was killed.
UNCLOSED = ("log", "the program ended without closing the session")


@dataclass(frozen=True)
class Event:
    """One event of a session, such as a trip or a mark of the operator."""

    time_s: float  # when, on the clock of the session's streams [s]
    kind: str  # a short word to filter by, such as "trip"
    text: str  # one line for people
    # Values for programs, as JSON can hold them; None if there are none.
    data: Mapping[str, Any] | None = None


def _event_type() -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=EVENT_STREAM)
    types = {"time_s": _FIELD.TYPE_DOUBLE} | dict.fromkeys(("kind", "text", "data_json"), _FIELD.TYPE_STRING)
    for number, (name, kind) in enumerate(types.items(), start=1):
        message.field.add(name=name, json_name=name, number=number, type=kind, label=_FIELD.LABEL_OPTIONAL)
    return message


def event_descriptor_set() -> bytes:
    """Serialize the events' message type as a FileDescriptorSet."""
    return file_descriptor_set(_event_type())


_FILES = descriptor_pb2.FileDescriptorSet.FromString(event_descriptor_set()).file
_EventMessage: type[Message] = message_factory.GetMessages(_FILES)[f"{PACKAGE}.{EVENT_STREAM}"]


def encode_event(event: Event) -> bytes:
    """Encode an event in protobuf with at most `MAX_EVENT_BYTES`; longer text is truncated and marked.

    Numpy's numbers and arrays are kept as numbers and lists; values that JSON cannot represent, as text.

    Args:
        event: to encode.
    """
    keyed = {str(key): value for key, value in (event.data or {}).items()}
    data_json = ""
    if event.data is not None:
        data_json = json.dumps(
            keyed, default=lambda v: v.tolist() if isinstance(v, np.ndarray | np.generic) else str(v)
        )
    encoded = _serialize_event(event, event.text, data_json)
    if len(encoded) <= MAX_EVENT_BYTES:
        return encoded
    text = event.text.encode(errors="replace")[: MAX_EVENT_BYTES // 2].decode(errors="ignore")
    return _serialize_event(event, text + _CUT, "")


def _serialize_event(event: Event, text: str, data_json: str) -> bytes:
    kind, text = (word.encode(errors="replace").decode() for word in (event.kind[:64], text))
    message = _EventMessage(time_s=event.time_s, kind=kind, text=text, data_json=data_json)
    data: bytes = message.SerializeToString()
    return data


def decode_event(data: bytes) -> Event:
    """Decode what `encode_event` made; raise `SessionError` if it is not an event.

    Args:
        data: a message.
    """
    try:
        message = _EventMessage.FromString(data)
        values = json.loads(message.data_json) if message.data_json else None
    except (DecodeError, ValueError, RecursionError) as error:
        raise SessionError(f"an event cannot be read: {error}") from error
    if not isinstance(values, dict | None):
        raise SessionError(f"an event's data is not a JSON object: {message.data_json[:80]}")
    return Event(message.time_s, message.kind, message.text, values)
