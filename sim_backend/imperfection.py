"""What a hidden effect is: a name, a place, parameters with unit and range, and what it does to a world."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

from numpy.random import Generator
from pydantic import Field

from robot_io.errors import InputError
from robot_io.files.file_model import FileModel, matching, member
from robot_io.registry import Registry
from sim_backend.channel_effect import ChannelEffect, Transducer
from sim_backend.hooks import Effects
from sim_backend.noise_scale import CONTACT, NoiseScale, channel_of

CHANNEL_UNIT = "channel"
_JOINTS = tuple(channel_of(joint) for joint in (1, 2, 3))


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a hidden effect."""

    name: str  # key in a scenario
    unit: str  # `CHANNEL_UNIT` stands for that of the sensor's signal
    low: float  # least typical value
    high: float  # largest typical value


def parameter(unit: str, low: float, high: float, **limits: Any) -> Any:  # noqa: ANN401, as pydantic's Field
    """A field that is a parameter of a hidden effect, see `Parameter`.

    The limits are what pydantic's `Field` takes, such as `ge`, `le` and `default`.
    """
    return Field(json_schema_extra={"parameter": [unit, low, high]}, **limits)


class Imperfection(FileModel, ABC):
    """One entry of a scenario's `hidden` section; its fields say where it is and how strong.

    The class docstring states physics, equation and source. It is described in words and numbers here; what
    happens in the simulation is made afresh by `effects`, with its own memory, for each world.
    """

    name: ClassVar[str]  # what a scenario calls it
    shows_in: ClassVar[Sequence[str]]  # channels in which a probing run of the shipped follower shows it
    needs_force_law: ClassVar[bool] = False  # whether it makes no sense with the engine's own contact

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Where it shows: "contact", "joint_1", "joint_2" ..."""

    @abstractmethod
    def effects(self, joint_count: int) -> Effects:
        """What it does to a world whose arm has `joint_count` joints.

        InputError: the arm has no such joint.
        """

    @classmethod
    @abstractmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """One that changes the channel's signal by about `strength` times its noise floor (rms).

        Of a change that stiffness, damping and surface could take over, the part counts that they cannot. A
        strength of zero leaves everything as it is. The generator is for what it leaves open, such as a sign.
        """

    def values(self) -> dict[str, tuple[float, str]]:
        """Value and unit of each parameter."""
        return {about.name: (getattr(self, about.name), about.unit) for about in self.parameters()}

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters, without the place."""
        extras = {name: field.json_schema_extra for name, field in cls.model_fields.items()}
        stated: dict[str, Any] = {name: extra for name, extra in extras.items() if isinstance(extra, dict)}
        return tuple(Parameter(name, *extra["parameter"]) for name, extra in stated.items())


class ContactImperfection(Imperfection, ABC):
    """A hidden effect between tip and object."""

    shows_in: ClassVar[Sequence[str]] = (CONTACT,)

    @property
    def channels(self) -> tuple[str, ...]:
        return (CONTACT,)


class JointImperfection(Imperfection, ABC):
    """A hidden effect in one joint or its drive."""

    shows_in: ClassVar[Sequence[str]] = _JOINTS

    joint: int = Field(ge=1, le=100, strict=True)  # which joint, from 1 at the base

    @property
    def channels(self) -> tuple[str, ...]:
        return (channel_of(self.joint),)

    def index_in(self, joint_count: int) -> int:
        """The joint's index from 0. InputError: the arm has no such joint."""
        if self.joint > joint_count:
            raise InputError(
                f"hidden effect '{self.name}': joint {self.joint} of an arm with {joint_count} joints"
            )
        return self.joint - 1


class SensorImperfection(Imperfection, ABC):
    """A hidden effect in a sensor."""

    shows_in: ClassVar[Sequence[str]] = (CONTACT, *_JOINTS)
    ahead_of_noise: ClassVar[bool] = False  # see `SensorEffect`

    # "contact" for the force sensor, "joint_2" for the torque sensor of the second joint, "encoder_2" for its
    # encoder (whose velocity, if it is a tachometer's, is not affected).
    channel: Annotated[
        str,
        matching(
            r"contact|(joint|encoder)_[1-9][0-9]?", "contact, or joint_ or encoder_ with a number from 1 on"
        ),
    ]

    @abstractmethod
    def transducer(self) -> Transducer:
        """A fresh one, which makes (time [s], value) into the value that the sensor takes it for."""

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; a wrong position shows in all that is worked out from it."""
        slot, _, number = self.channel.partition("_")
        return (CONTACT, channel_of(int(number))) if slot == "encoder" else (self.channel,)

    def values(self) -> dict[str, tuple[float, str]]:
        """See `Imperfection.values`; in the unit of the sensor's signal."""
        unit = {CONTACT: "N", "joint": "N m", "encoder": "rad"}[self.channel.partition("_")[0]]
        found = super().values().items()
        return {name: (value, text.replace(CHANNEL_UNIT, unit)) for name, (value, text) in found}

    def effects(self, joint_count: int) -> Effects:
        slot, _, number = self.channel.partition("_")
        index = int(number or 1) - 1
        if number and index >= joint_count:
            raise InputError(
                f"hidden effect '{self.name}': channel {self.channel} of an arm with {joint_count} joints"
            )
        changed = (ChannelEffect(index, self.transducer(), self.ahead_of_noise),)
        if slot == CONTACT:
            return Effects(force=changed)
        return Effects(torque=changed) if slot == "joint" else Effects(encoder=changed)


IMPERFECTIONS: Registry[Imperfection] = Registry(
    "hidden effect",
    Imperfection,  # type: ignore[type-abstract]
    "sim_backend.imperfections",
)


def parse_imperfection(value: object) -> Imperfection:
    """Make a hidden effect from a scenario's `{effect: ..., parameter: ...}`; see `member`."""
    return member(value, IMPERFECTIONS, "effect")


def describe_imperfection(imperfection: Imperfection) -> dict[str, object]:
    """The inverse of `parse_imperfection`."""
    return {"effect": imperfection.name, **imperfection.model_dump()}
