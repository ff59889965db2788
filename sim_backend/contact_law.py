"""What a contact law is: the force that an object returns at a depth and a rate of depth."""

from abc import ABC, abstractmethod
from typing import ClassVar

from robot_io.files.file_model import FileModel, member
from robot_io.registry import Registry


class ContactLaw(FileModel, ABC):
    """A memoryless law F(depth, rate); its fields are its parameters, checked when it is made.

    Memory (relaxation, plastic set ...) comes on top of a law, as a `ContactEffect`.
    """

    name: ClassVar[str]  # what a scenario calls it

    @abstractmethod
    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        """What the material answers to a tip below the surface [N]; negative where it would have to pull."""

    def force_n(self, depth_m: float, rate_m_s: float) -> float:
        """Force of the object on the tip along the outward surface normal [N].

        The depth is how far the tip is below the undeformed surface [m]; zero or less is no contact. Its rate
        is positive while pressing in [m/s].
        """
        force_n = self.material_force_n(depth_m, rate_m_s) if depth_m > 0.0 else 0.0
        return force_n if force_n > 0.0 or self.can_pull else 0.0

    @property
    def can_pull(self) -> bool:
        """Whether the object may pull while the tip is below its surface."""
        return False


CONTACT_LAWS: Registry[ContactLaw] = Registry("contact law", ContactLaw, "sim_backend.contact_laws")  # type: ignore[type-abstract]


def parse_contact_law(value: object) -> ContactLaw:
    """Make a law from a scenario's `{name: ..., parameter: ...}`; see `member`."""
    return member(value, CONTACT_LAWS, "name")


def describe_contact_law(law: ContactLaw) -> dict[str, object]:
    """The inverse of `parse_contact_law`."""
    return {"name": law.name, **law.model_dump()}
