"""Messages between leader and follower: frozen dataclasses that are mapped to protobuf messages at run time.

The types map as follows: float to double, int to sfixed64, bool to bool, str to string, bytes to bytes, a
dataclass to a nested message, and a tuple of any of these to a repeated field. Fields are numbered from 1 in
the order of the class.

Every message holds the whole state of its sender, so the next one replaces a lost one.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from operator import attrgetter
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.message import DecodeError

from palpate.robot_io.errors import InputError, ProtocolError
from palpate.robot_io.session.wire import descriptor_of

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
        descriptor: type of its message if it is a field of another class; None to make a type.
    """

    def __init__(self, kind: type[T], descriptor: Any = None) -> None:  # noqa: ANN401, built at run time
        members, descriptor = _members(kind), descriptor or descriptor_of(_describe(kind))
        self._kind, self._message = kind, message_factory.GetMessageClass(descriptor)
        self._names = tuple(name for name, _, _ in members)
        self._values = attrgetter(*self._names)
        self._build: list[tuple[str, Callable[[Any], object]]] = []  # fields that need a conversion
        self._read: list[tuple[int, Callable[[Any], object]]] = []
        for index, (name, field_kind, is_repeated) in enumerate(members):
            if field_kind not in _SCALARS:
                inner: WireType[Any] = WireType(field_kind, descriptor.fields_by_name[name].message_type)
                build, read = inner._message_of, inner._value_of
                self._build.append((name, partial(_convert_each, build) if is_repeated else build))
                self._read.append((index, partial(_convert_each, read) if is_repeated else read))
            elif is_repeated:
                # Copied as a slice: twice as fast as one by one.
                self._read.append((index, lambda values: tuple(values[:])))

    def encode(self, value: T) -> bytes:
        """Encode a value.

        Args:
            value: value of the class.
        """
        data: bytes = self._message_of(value).SerializeToString()
        return data

    def decode(self, data: bytes) -> T:
        """Decode what `encode` made; raise `ProtocolError` if it is another message, or a value is invalid.

        Args:
            data: a protobuf message.
        """
        try:
            return self._value_of(self._message.FromString(data))
        except (DecodeError, ValueError, TypeError) as error:
            text = " ".join(str(error).split())[:200]
            raise ProtocolError(f"{self._kind.__name__}: {text}") from error

    def _message_of(self, value: T) -> Any:  # noqa: ANN401, built at run time
        values = dict(zip(self._names, self._values(value), strict=False))
        for name, build in self._build:
            values[name] = build(values[name])
        return self._message(**values)

    def _value_of(self, message: Any) -> T:  # noqa: ANN401, built at run time
        values = list(self._values(message))
        for index, read in self._read:
            values[index] = read(values[index])
        return self._kind(*values)


def _convert_each(convert: Callable[[Any], Any], values: Iterable[Any]) -> tuple[Any, ...]:
    return tuple([convert(value) for value in values])  # faster than of a generator


def _members(kind: type) -> list[tuple[str, type, bool]]:
    """Return name and type of each field of a class, and whether it is repeated."""
    hints = [(name, hint, get_origin(hint) is tuple) for name, hint in get_type_hints(kind).items()]
    return [(name, get_args(hint)[0] if repeated else hint, repeated) for name, hint, repeated in hints]


def _describe(kind: type) -> descriptor_pb2.DescriptorProto:
    message = descriptor_pb2.DescriptorProto(name=kind.__name__)
    for number, (name, field_kind, is_repeated) in enumerate(_members(kind), start=1):
        field = message.field.add(name=name, json_name=name, number=number)
        field.label = _FIELD.LABEL_REPEATED if is_repeated else _FIELD.LABEL_OPTIONAL
        if field_kind in _SCALARS:
            field.type = _SCALARS[field_kind]
            continue
        inner = _describe(field_kind)
        message.nested_type.append(inner)
        field.type, field.type_name = _FIELD.TYPE_MESSAGE, inner.name
    return message


MOST_TARGETS = 64
MOST_PARAMETERS = 64
MOST_TEXT = 500  # characters
_UNIT = 1e-6  # tolerance of the length of a unit vector
_LEADERS, _NUMBERS = 2**31, 2**16  # distinct leaders; targets that each may give
_MOST_COUNT = _LEADERS * _NUMBERS  # a double holds all of them


def target_number(leader: int, count: int) -> int:
    """Make a target's number, practically unique among leaders; raise `InputError` for too many targets.

    Args:
        leader: random number of the leading program, of which 31 bits count.
        count: number of targets that it has given so far.
    """
    if not 0 <= count < _NUMBERS:
        raise InputError(f"target {count}: a leader may choose at most {_NUMBERS} targets")
    return leader % _LEADERS * _NUMBERS + count


def short_number(number: int) -> int:
    """Return the short number of a target, its position in the leader's sequence, which users see.

    Args:
        number: number of the target, which includes the leader's random bits.
    """
    return number % _NUMBERS


class TargetState(IntEnum):
    """State of a target. The numbers are transmitted: add new ones at the end."""

    QUEUED = 0
    PROBING = 1
    DONE = 2
    REFUSED = 3  # out of reach, or against the follower's own limits
    CANCELLED = 4
    FAILED = 5  # tried without obtaining data

    @property
    def is_over(self) -> bool:
        """Whether the target needs no further work."""
        return self not in {TargetState.QUEUED, TargetState.PROBING}


_STATES = frozenset(TargetState)


@dataclass(frozen=True, slots=True)
class Target:
    """A place to probe. Speed and force are the follower's own plan, not the network's."""

    number: int  # assigned by the leader, see `target_number`; unique among all leaders
    position_world_m: tuple[float, ...]  # shape (3,), a point near the surface [m]
    direction_world: tuple[float, ...]  # shape (3,), unit vector into the object

    def __post_init__(self) -> None:
        _check_count("target number", self.number)
        _check_vector("target position", self.position_world_m, 100.0)
        _check_vector("target direction", self.direction_world, 1.0 + _UNIT)
        if abs(math.hypot(*self.direction_world) - 1.0) > _UNIT:
            raise InputError(f"target direction {self.direction_world}: is not a unit vector")


@dataclass(frozen=True, slots=True)
class Intent:
    """The operator's intent; leader to follower."""

    targets: tuple[Target, ...]  # targets in the order of probing
    cancelled: tuple[int, ...]  # numbers of canceled targets
    seen: tuple[int, ...]  # revision of the newest estimate that has arrived, of each target
    ended: bool  # whether the operator has finished: finish the queue, then end

    def __post_init__(self) -> None:
        _check_length("targets", self.targets, MOST_TARGETS)
        _check_length("cancelled", self.cancelled, MOST_TARGETS)
        _check_length("seen", self.seen, MOST_TARGETS)
        numbers = [target.number for target in self.targets]
        if len(set(numbers)) < len(numbers):
            raise InputError(f"targets {numbers}: a number appears twice")


@dataclass(frozen=True, slots=True)
class Report:
    """Present state of the follower; follower to leader."""

    phase: int  # number of `palpate.control.loop.task.Phase`
    target: int  # number of the target that is being probed, -1 for none
    tip_world_m: tuple[float, ...]  # shape (3,) [m]
    speed_m_s: float  # of the tip along the press direction [m/s]
    direction_world: tuple[float, ...]  # shape (3,), press direction
    force_n: float  # measured minus the reading in free air, positive in compression [N]
    targets: tuple[int, ...]  # numbers of all targets that are known
    states: tuple[int, ...]  # `TargetState` of each of them
    remark: str  # reason of the newest refusal, failure or stop; empty if there was none
    ended: bool  # the follower is at rest without torque, and ends

    def __post_init__(self) -> None:
        _check_vector("tip position", self.tip_world_m, 100.0)
        _check_vector("press direction", self.direction_world, 1.0 + _UNIT)
        _check_number("tip speed", self.speed_m_s, 100.0)
        _check_number("force", self.force_n, 1e6)
        _check_length("target states", self.targets, MOST_TARGETS)
        _check_text("remark", self.remark)
        if len(self.states) != len(self.targets) or not _STATES.issuperset(self.states):
            raise InputError(
                f"target states {self.states}: each target of {self.targets} needs exactly one valid state"
            )


@dataclass(frozen=True, slots=True)
class EstimatedParameter:
    """One parameter with its 95 % interval; unknown bounds are NaN."""

    name: str  # such as "stiffness.k"
    unit: str
    value: float
    lower: float
    upper: float

    def __post_init__(self) -> None:
        _check_text("parameter name", self.name)
        _check_text("unit", self.unit)
        _check_number(self.name, self.value, 1e30)
        for bound in (self.lower, self.upper):
            if not (math.isnan(bound) or abs(bound) < 1e30):
                raise InputError(f"{self.name}: bound {bound} is out of range")


@dataclass(frozen=True, slots=True)
class ContactModel:
    """One term of the object's model: a contact law or an effect, by the names that a scenario uses."""

    name: str  # such as "kelvin_voigt" or "cubic_stiffness"
    keys: tuple[str, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        for text in (self.name, *self.keys):
            _check_text("name", text)
        _check_length(f"parameters of {self.name}", self.keys, MOST_PARAMETERS)
        if len(self.keys) != len(self.values):
            raise InputError(f"{self.name}: {len(self.keys)} names for {len(self.values)} values")
        for key, value in zip(self.keys, self.values, strict=True):
            _check_number(f"{self.name}.{key}", value, 1e30)


@dataclass(frozen=True, slots=True)
class ObjectEstimate:
    """Estimated model of the object at one target; follower to leader."""

    revision: int  # counts up with every estimate
    target: int  # number of the target
    surface_world_m: tuple[float, ...]  # shape (3,), position of the undeformed surface [m]
    direction_world: tuple[float, ...]  # shape (3,), unit vector into the object
    model: tuple[ContactModel, ...]  # the contact law, then established effects
    parameters: tuple[EstimatedParameter, ...]  # with intervals, for people
    verdict: str  # of the diagnosis; empty before there is one
    words: str  # reason of the verdict, one line
    rmse_n: float  # of the model on the measured runs [N]
    noise_n: float  # error by the sensor's noise alone [N]; NaN if not known
    runs: int  # how many runs it rests on
    measured_s: float  # time of the last sample that went into it, on the follower's clock [s]

    def __post_init__(self) -> None:
        _check_count("estimate's revision", self.revision)
        _check_vector("surface position", self.surface_world_m, 100.0)
        _check_vector("press direction", self.direction_world, 1.0 + _UNIT)
        _check_length("terms", self.model, MOST_PARAMETERS)
        _check_length("parameters", self.parameters, MOST_PARAMETERS)
        _check_text("verdict", self.verdict)
        _check_text("words", self.words)
        _check_number("rmse", self.rmse_n, 1e6)
        _check_number("time of measurement", self.measured_s, 1e12)
        if not self.model:
            raise InputError("estimate without a contact law")


Message = Intent | Report | ObjectEstimate


def _check_count(what: str, value: int) -> None:
    if not 0 <= value < _MOST_COUNT:
        raise InputError(f"{what} {value}: must be at least 0 and below 2^47")


def _check_number(what: str, value: float, largest: float) -> None:
    if not -largest <= value <= largest:  # also NaN
        raise InputError(f"{what} {value}: must be a number up to {largest:g}")


def _check_vector(what: str, values: Sequence[float], largest: float) -> None:
    if len(values) != 3:
        raise InputError(f"{what} {values}: must have three numbers")
    x, y, z = values
    if not (-largest <= x <= largest and -largest <= y <= largest and -largest <= z <= largest):  # also NaN
        raise InputError(f"{what} {tuple(values)}: not three numbers up to {largest:g}")


def _check_length(what: str, values: Sequence[object], largest: int) -> None:
    if len(values) > largest:
        raise InputError(f"{len(values)} {what}: at most {largest}")


def _check_text(what: str, text: str) -> None:
    if len(text) > MOST_TEXT:
        raise InputError(f"{what}: {len(text)} characters, at most {MOST_TEXT}")
