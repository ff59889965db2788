"""Spring and dashpot in parallel."""

from pydantic import Field

from robot_io.files.file_model import Number
from sim_backend.contact_law import ContactLaw


class KelvinVoigt(ContactLaw):
    """F = k x + c dx/dt, x the depth (paper, section V).

    The dashpot makes the force jump to c * v at touch, and would pull on retraction; a dry surface cannot
    pull, so the force is cut at zero unless the object is sticky.
    """

    name = "kelvin_voigt"

    stiffness_n_m: Number = Field(ge=0, le=1e6)  # spring constant k [N/m]
    damping_n_s_m: Number = Field(ge=0, le=1e4)  # viscous damping c [N s/m]
    sticky: bool = False  # whether the object may pull while the tip is below its surface

    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.stiffness_n_m * depth_m + self.damping_n_s_m * rate_m_s

    @property
    def can_pull(self) -> bool:
        return self.sticky
