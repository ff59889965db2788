"""Contact laws, found by name: the force that an object returns at a depth and a rate of depth."""

from abc import ABC, abstractmethod
from typing import ClassVar

from palpate.robot_io.files.file_model import FileModel, member
from palpate.robot_io.registry import Registry


class ObjectLaw(FileModel, ABC):
    """A memoryless law F(depth, rate); its fields are its parameters, validated on construction.

    Memory (relaxation, plastic set ...) is added by a `ContactEffect`.
    """

    name: ClassVar[str]  # name in a scenario

    @abstractmethod
    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        """Compute the force of the material below the surface [N]; negative where it would have to pull.

        Args:
            depth_m: depth of the tip below the undeformed surface, positive [m].
            rate_m_s: rate of the depth, positive while pressing in [m/s].
        """

    def force_n(self, depth_m: float, rate_m_s: float) -> float:
        """Compute the force of the object on the tip along the outward surface normal [N].

        Args:
            depth_m: of the tip below the undeformed surface [m]; zero or less is no contact.
            rate_m_s: of the depth, positive while pressing in [m/s].
        """
        if not depth_m > 0.0:
            return 0.0
        force_n = self.material_force_n(depth_m, rate_m_s)
        return force_n if force_n > 0.0 or self.can_pull else 0.0

    @property
    def can_pull(self) -> bool:
        """Whether the object may pull while the tip is below its surface."""
        return False

    def describe(self) -> dict[str, object]:
        """Return what `parse_contact_law` reads: name and parameters."""
        return {"name": self.name, **self.model_dump()}


CONTACT_LAWS: Registry[ObjectLaw] = Registry("contact law", ObjectLaw, "palpate.sim_backend.contact_laws")  # type: ignore[type-abstract]


def parse_contact_law(value: object) -> ObjectLaw:
    """Make a law from a scenario's `{name: ..., parameter: ...}`; see `member`.

    Args:
        value: a mapping, or a law.
    """
    return member(value, CONTACT_LAWS, "name")
