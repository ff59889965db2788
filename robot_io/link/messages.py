"""Messages between leader and follower: frozen dataclasses, which travel as JSON.

Their own checks run on every message that arrives. Every message holds the whole state of its sender, so the
next one replaces a lost one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, ClassVar, TypeVar

from pydantic import ConfigDict, FailFast, Field

from palpate.robot_io.errors import InputError

Int64 = Annotated[int, Field(ge=-(2**63), lt=2**63)]  # as records of a session hold it
T = TypeVar("T")
# Validation ends at the first invalid entry: ten thousand of them would hold up the control loop.
Entries = Annotated[tuple[T, ...], FailFast()]
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
    position_world_m: Entries[float]  # shape (3,), a point near the surface [m]
    direction_world: Entries[float]  # shape (3,), unit vector into the object

    def __post_init__(self) -> None:
        _check_count("target number", self.number)
        _check_vector("target position", self.position_world_m, 100.0)
        _check_vector("target direction", self.direction_world, 1.0 + _UNIT)
        if abs(math.hypot(*self.direction_world) - 1.0) > _UNIT:
            raise InputError(f"target direction {self.direction_world}: is not a unit vector")


@dataclass(frozen=True, slots=True)
class Intent:
    """The operator's intent; leader to follower."""

    targets: Entries[Target]  # targets in the order of probing
    cancelled: Entries[Int64]  # numbers of canceled targets
    seen: Entries[Int64]  # revision of the newest estimate that has arrived, of each target
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

    phase: Int64  # number of `palpate.control.loop.task.Phase`
    target: Int64  # number of the target that is being probed, -1 for none
    tip_world_m: Entries[float]  # shape (3,) [m]
    speed_m_s: float  # of the tip along the press direction [m/s]
    direction_world: Entries[float]  # shape (3,), press direction
    force_n: float  # measured minus the reading in free air, positive in compression [N]
    targets: Entries[Int64]  # numbers of all targets that are known
    states: Entries[Int64]  # `TargetState` of each of them
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
    keys: Entries[str]
    values: Entries[float]

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

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(ser_json_inf_nan="constants")

    revision: int  # counts up with every estimate
    target: Int64  # number of the target
    surface_world_m: Entries[float]  # shape (3,), position of the undeformed surface [m]
    direction_world: Entries[float]  # shape (3,), unit vector into the object
    model: Entries[ContactModel]  # the contact law, then established effects
    parameters: Entries[EstimatedParameter]  # with intervals, for people
    verdict: str  # of the diagnosis; empty before there is one
    words: str  # reason of the verdict, one line
    rmse_n: float  # of the model on the measured runs [N]
    noise_n: float  # error by the sensor's noise alone [N]; NaN if not known
    runs: Int64  # how many runs it rests on
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
