"""The reconfigurable compliance object: a flat surface whose law can change while it is touched."""

from sim_backend.contact_law import ContactLaw
from sim_backend.contact_laws import EngineContact
from sim_backend.engines import Engine


class ComplianceObject:
    """A horizontal surface, frictionless, that answers depth and rate with an upward force.

    Args:
        engine: of the world it is in.
        law: its contact law.
        surface_height_m: world height of the undeformed surface [m].

    Raises:
        InputError: the law is an engine's own contact, and this engine has none.
    """

    def __init__(self, engine: Engine, law: ContactLaw, surface_height_m: float) -> None:
        self._engine = engine
        self._surface_height_m = surface_height_m
        self.set_law(law)

    @property
    def law(self) -> ContactLaw:
        """The contact law in force."""
        return self._law

    @property
    def surface_height_m(self) -> float:
        """World height of the undeformed surface [m]."""
        return self._surface_height_m

    @property
    def is_engine_contact(self) -> bool:
        """Whether the engine itself exerts the force."""
        return isinstance(self._law, EngineContact)

    def set_law(self, law: ContactLaw) -> None:
        """Change the law, from the next physics step on. InputError: the engine has no such contact."""
        self._tell_engine(law, self._surface_height_m)
        self._law = law

    def move_surface(self, height_m: float) -> None:
        """Change the world height of the undeformed surface [m], from the next physics step on."""
        self._tell_engine(self._law, height_m)
        self._surface_height_m = height_m

    def _tell_engine(self, law: ContactLaw, height_m: float) -> None:
        self._engine.set_surface(law if isinstance(law, EngineContact) else None, height_m)
