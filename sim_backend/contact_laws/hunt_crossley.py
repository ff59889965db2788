"""Nonlinear spring whose damping grows with depth."""

from pydantic import Field

from robot_io.files.file_model import Number
from sim_backend.contact_law import ContactLaw


class HuntCrossley(ContactLaw):
    """F = (k + b dx/dt) x^n, x the depth (Hunt and Crossley, J. Appl. Mech. 42, 1975, eq. 2).

    The force starts at zero whatever the speed, unlike Kelvin-Voigt's, and is cut at zero on fast retraction.
    """

    name = "hunt_crossley"

    stiffness: Number = Field(ge=0, le=1e9)  # k [N/m^n]
    damping: Number = Field(ge=0, le=1e9)  # b [N s/m^(n+1)]
    exponent: Number = Field(ge=1.0, le=4.0)  # n [-]; 1.5 for a sphere on an elastic half space

    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        return (self.stiffness + self.damping * rate_m_s) * float(depth_m**self.exponent)
