"""The physics engine's own compliant contact."""

from pydantic import Field

from robot_io.files.file_model import Number
from sim_backend.contact_law import ContactLaw


class EngineContact(ContactLaw):
    """PyBullet's contactStiffness and contactDamping on a box, touched by a sphere at the tip.

    The engine turns both into a softened velocity constraint and integrates it implicitly, so that
    the force follows k x + c dx/dt closely at rest and only roughly while moving. The touching sphere rolls:
    with a tilted tool, the deepest point is not the tip frame any more.
    """

    name = "engine"

    stiffness_n_m: Number = Field(gt=0, le=1e6)  # contactStiffness [N/m]
    damping_n_s_m: Number = Field(ge=0, le=1e4)  # contactDamping [N s/m]

    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        """The force that the engine aims at [N]; it does not pull."""
        return max(self.stiffness_n_m * depth_m + self.damping_n_s_m * rate_m_s, 0.0)
