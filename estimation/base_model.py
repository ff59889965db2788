"""Base models: the simple models that a diagnosis starts from."""

import re
from dataclasses import dataclass
from typing import ClassVar

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import Effect
from palpate.estimation.effects.contact_geometry import ContactOffset
from palpate.estimation.model import Model

LEVEL_GRAVITY_M_S2 = (0.0, 0.0, -9.81)  # gravitational acceleration in the axes of a level base


@dataclass(frozen=True)
class Arm:
    """The arm that made the measurement."""

    urdf: str = ""  # text of its URDF, empty if unknown
    tip_frame: str = ""  # name of the tip's frame in the URDF
    origin: str = "URDF text"  # where the URDF comes from, for error messages
    # Gravitational acceleration in the axes of the base, shape (3,) [m/s^2].
    gravity_m_s2: tuple[float, float, float] = LEVEL_GRAVITY_M_S2
    # Rotor inertia that the drives add to each of the n joints, shape (n,) or empty [kg m^2].
    rotor_inertia_kg_m2: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()  # notes on the arm for the user
    joint_names: tuple[str, ...] = ()  # names of the n joints in the URDF, by which columns may be named

    def context_of(self, channel: ChannelData) -> "ModelContext":
        """Return the information that a base model may need about a channel besides its data.

        Args:
            channel: channel of a contact, or "joint_N" with N counted from 1.
        """
        joint = re.fullmatch(r"joint_(\d+)", channel.name)
        return ModelContext(int(joint[1]) - 1 if joint else None, self, channel.surface is not None)


NO_ARM = Arm()


@dataclass(frozen=True)
class ModelContext:
    """Information that a base model may need besides the data."""

    joint: int | None = None  # index of the channel's joint, from 0; None for a contact
    arm: Arm = NO_ARM  # the arm to which the joint belongs
    # Whether the contact's surface was estimated from the data and therefore has an error.
    surface_found: bool = False


class BaseModel:
    """A simple model that a diagnosis starts from."""

    name: ClassVar[str]  # snake_case
    channels: ClassVar[frozenset[ChannelKind]]  # kinds of channel that it describes
    effects: ClassVar[tuple[type[Effect], ...]] = ()  # its terms, if they do not depend on the context

    def build(self, context: ModelContext) -> Model:
        """Return the model for one channel.

        Args:
            context: further information that a model may need.

        Raises:
            InputError: the context lacks something that the model needs.
        """
        surface = (ContactOffset(),) if context.surface_found else ()
        return Model(self.name, (*(effect() for effect in self.effects), *surface))

    def prepare(self, data: ChannelData, context: ModelContext) -> ChannelData:
        """Return the channel with the signals that the model and its additional effects need.

        Args:
            data: the measured channel.
            context: further information that a model may need.

        Raises:
            InputError: the channel or the context lacks something that the model needs.
        """
        return data
