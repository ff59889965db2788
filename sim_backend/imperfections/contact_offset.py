"""A surface that is not where it is said to be."""

from collections.abc import Sequence
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class ContactOffset(ContactImperfection):
    """The object feels x + d: its surface is higher than the scenario says by d.

    Seen only by those who take the surface as given; a probing run that finds it by touch does not.
    """

    name: ClassVar[str] = "contact_offset"
    shows_in: ClassVar[Sequence[str]] = ()
    needs_force_law: ClassVar[bool] = True
    offset_m: Number = parameter("m", -0.005, 0.005, ge=-0.5, le=0.5)  # d [m]

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Higher(self.offset_m),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here for a surface that is taken as given."""
        sign = generator.choice([-1.0, 1.0])
        return cls(offset_m=sign * strength * scale.contact_noise_n * scale.depth_m / scale.force_n)


class _Higher(MaterialEffect):
    def __init__(self, offset_m: float) -> None:
        self._offset_m = offset_m

    def felt(self, state: ContactState) -> ContactState:
        return state._replace(depth_m=state.depth_m + self._offset_m)
