"""Interface of a hidden effect: name, place, parameters with unit and range, and effect on a world."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

from numpy.random import Generator
from pydantic import Field

from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import FileModel, matching, member
from palpate.robot_io.registry import Registry
from palpate.sim_backend.hooks import ChannelEffect, HiddenEffects, Transducer
from palpate.sim_backend.noise_scale import CONTACT, NoiseScale, channel_of, joint_of

CHANNEL_UNIT = "channel"
Values = dict[str, float]
"""Parameters of a hidden effect by field."""
_JOINTS = tuple(channel_of(joint) for joint in (1, 2, 3))


@dataclass(frozen=True, slots=True)
class ImperfectionParameter:
    """One parameter of a hidden effect."""

    name: str  # key in a scenario
    unit: str  # `CHANNEL_UNIT` stands for that of the sensor's signal
    low: float  # least typical value
    high: float  # largest typical value


def parameter(unit: str, low: float, high: float, **limits: Any) -> Any:  # noqa: ANN401, as pydantic's Field
    """Declare a field that is a parameter of a hidden effect, see `ImperfectionParameter`.

    Args:
        unit: unit of the value; `CHANNEL_UNIT` stands for that of the sensor's signal.
        low: least typical value.
        high: largest typical value.
        limits: what pydantic's `Field` takes, such as `ge`, `le` and `default`.
    """
    return Field(json_schema_extra={"parameter": [unit, low, high]}, **limits)


class Imperfection(FileModel, ABC):
    """One entry of a scenario's `hidden` section; its fields say where it is and how strong.

    The class docstring states physics, equation and source. `effects` creates the simulated effect for
    each world, with its own memory.
    """

    name: ClassVar[str]  # name in a scenario
    shows_in: ClassVar[Sequence[str]]  # channels in which a probing run of the shipped follower shows it
    needs_force_law: ClassVar[bool] = False  # whether it makes no sense with the engine's own contact

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Channels in which it shows: "contact", "joint_1", "joint_2" ..."""

    @abstractmethod
    def effects(self, joint_count: int) -> HiddenEffects:
        """Make the simulated effect, with its own memory.

        Args:
            joint_count: number of joints of the arm.

        Raises:
            InputError: the arm has no such joint.
        """

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """Make an effect that changes the channel's signal by a multiple of its noise floor (rms).

        Of a change that stiffness, damping and surface could absorb, only the remaining part counts. A
        strength of zero changes nothing.

        Args:
            strength: multiple of the noise floor.
            channel: the channel that shows it.
            scale: noise floors and motion.
            generator: draws properties that the strength does not determine, such as a sign.

        Raises:
            InputError: the effect cannot be in this channel.
        """
        return cls(**cls._location_fields(channel) | cls._size_fields(strength, channel, scale, generator))

    @classmethod
    def _location_fields(cls, channel: str) -> dict[str, Any]:
        """Return the fields that place the effect where `channel` shows it."""
        return {}

    @classmethod
    @abstractmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """Compute the other fields for `at_strength`, whose arguments these are."""

    def values(self) -> dict[str, tuple[float, str]]:
        """Return value and unit of each parameter."""
        return {about.name: (getattr(self, about.name), about.unit) for about in self.parameters()}

    def describe(self) -> dict[str, object]:
        """Return what `parse_imperfection` reads: name, place and parameters."""
        return {"effect": self.name, **self.model_dump()}

    @classmethod
    def parameters(cls) -> tuple[ImperfectionParameter, ...]:
        """Return the parameters that set the effect's size, without those that set its place."""
        extras = {name: field.json_schema_extra for name, field in cls.model_fields.items()}
        stated: dict[str, Any] = {name: extra for name, extra in extras.items() if isinstance(extra, dict)}
        return tuple(ImperfectionParameter(name, *extra["parameter"]) for name, extra in stated.items())


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

    @classmethod
    def _location_fields(cls, channel: str) -> dict[str, Any]:
        return {"joint": joint_of(channel)}

    def effects(self, joint_count: int) -> HiddenEffects:
        if self.joint > joint_count:
            problem = f"joint {self.joint} does not exist; the arm has {joint_count} joints"
            raise InputError(f"hidden effect '{self.name}': {problem}")
        return self._effects(self.joint - 1, joint_count)

    @abstractmethod
    def _effects(self, index: int, joint_count: int) -> HiddenEffects:
        """Make the simulated effect in the joint of this index (from 0), with its own memory."""


class SensorImperfection(Imperfection, ABC):
    """A hidden effect in a sensor."""

    shows_in: ClassVar[Sequence[str]] = (CONTACT, *_JOINTS)
    ahead_of_noise: ClassVar[bool] = False  # see `SensorHook`

    # "contact" for the force sensor, "joint_2" for the torque sensor of the second joint, "encoder_2" for its
    # encoder (whose velocity, if it is a tachometer's, is not affected).
    channel: Annotated[
        str,
        matching(
            r"contact|(joint|encoder)_[1-9][0-9]?", "contact, joint_N or encoder_N, with N counted from 1"
        ),
    ]

    @classmethod
    def _location_fields(cls, channel: str) -> dict[str, Any]:
        return {"channel": channel}

    @abstractmethod
    def transducer(self) -> Transducer:
        """Make a new transducer from (time [s], value) to the changed value."""

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; a wrong position shows in everything computed from it."""
        slot, _, number = self.channel.partition("_")
        return (CONTACT, channel_of(int(number))) if slot == "encoder" else (self.channel,)

    def values(self) -> dict[str, tuple[float, str]]:
        """See `Imperfection.values`; in the unit of the sensor's signal."""
        unit = {CONTACT: "N", "joint": "N m", "encoder": "rad"}[self.channel.partition("_")[0]]
        values = super().values().items()
        return {name: (value, text.replace(CHANNEL_UNIT, unit)) for name, (value, text) in values}

    def effects(self, joint_count: int) -> HiddenEffects:
        """See `Imperfection.effects`; it acts on one value of one kind of sensor."""
        slot, _, number = self.channel.partition("_")
        index = int(number or 1) - 1
        if number and index >= joint_count:
            problem = f"channel {self.channel} does not exist; the arm has {joint_count} joints"
            raise InputError(f"hidden effect '{self.name}': {problem}")
        changed = (ChannelEffect(index, self.transducer(), self.ahead_of_noise),)
        if slot == CONTACT:
            return HiddenEffects(force=changed)
        return HiddenEffects(torque=changed) if slot == "joint" else HiddenEffects(encoder=changed)


IMPERFECTIONS: Registry[Imperfection] = Registry(
    "hidden effect",
    Imperfection,  # type: ignore[type-abstract]
    "palpate.sim_backend.imperfections",
)


def parse_imperfection(value: object) -> Imperfection:
    """Make a hidden effect from a scenario's `{effect: ..., parameter: ...}`; see `member`.

    Args:
        value: a mapping, or a hidden effect.
    """
    return member(value, IMPERFECTIONS, "effect")
