"""The reconfigurable compliance object: a flat surface whose law can change while it is touched."""

from sim_backend.bullet import bullet
from sim_backend.contact_law import ContactLaw
from sim_backend.contact_laws import EngineContact

_HALF_WIDTH_M = 2.0
_HALF_HEIGHT_M = 0.5


class ComplianceObject:
    """A horizontal surface, frictionless, that answers depth and rate with an upward force.

    Args:
        client: PyBullet client of the world it is in.
        law: its contact law.
        surface_height_m: world height of the undeformed surface [m].
    """

    def __init__(self, client: int, law: ContactLaw, surface_height_m: float) -> None:
        self._client = client
        self._surface_height_m = surface_height_m
        self._box: int | None = None
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
    def box(self) -> int | None:
        """PyBullet's number of the box, where the law is the engine's own contact."""
        return self._box

    def set_law(self, law: ContactLaw) -> None:
        """Change the law, from the next physics step on."""
        self._law = law
        self._rebuild_box()

    def move_surface(self, height_m: float) -> None:
        """Change the world height of the undeformed surface [m], from the next physics step on."""
        self._surface_height_m = height_m
        self._rebuild_box()

    def _rebuild_box(self) -> None:
        if self._box is not None:
            bullet.removeBody(self._box, self._client)
            self._box = None
        if not isinstance(self._law, EngineContact):
            return
        half_extents = [_HALF_WIDTH_M, _HALF_WIDTH_M, _HALF_HEIGHT_M]
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=half_extents, physicsClientId=self._client
        )
        centre = [0.0, 0.0, self._surface_height_m - _HALF_HEIGHT_M]
        self._box = bullet.createMultiBody(0.0, shape, basePosition=centre, physicsClientId=self._client)
        bullet.changeDynamics(
            self._box,
            -1,
            contactStiffness=self._law.stiffness_n_m,
            contactDamping=self._law.damping_n_s_m,
            lateralFriction=0.0,
            restitution=0.0,
            physicsClientId=self._client,
        )
