"""Contact laws: Kelvin-Voigt, Hunt-Crossley, and the physics engine's own contact."""

from pydantic import Field

from palpate.robot_io.files.file_model import Number
from palpate.sim_backend.contact_laws import ObjectLaw


class EngineContact(ObjectLaw):
    """PyBullet's contactStiffness and contactDamping on a box, touched by a sphere at the tip.

    The engine turns both into a softened velocity constraint and integrates it implicitly, so that the force
    follows k x + c dx/dt closely at rest, but only roughly in motion. The touching sphere rolls: with a
    tilted tool, the deepest point is no longer the tip frame.
    """

    name = "engine"

    stiffness_n_m: Number = Field(gt=0, le=1e6)  # contactStiffness [N/m]
    damping_n_s_m: Number = Field(ge=0, le=1e4)  # contactDamping [N s/m]

    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        """Compute the nominal force of the engine's contact, which never pulls [N]."""
        return max(self.stiffness_n_m * depth_m + self.damping_n_s_m * rate_m_s, 0.0)


class HuntCrossleyLaw(ObjectLaw):
    """F = (k + b dx/dt) x^n, x the depth (Hunt and Crossley, J. Appl. Mech. 42, 1975, eq. 2).

    Unlike Kelvin-Voigt's, the force starts at zero at any speed. On fast retraction it is limited to zero.
    """

    name = "hunt_crossley"

    stiffness: Number = Field(ge=0, le=1e9)  # k [N/m^n]
    damping: Number = Field(ge=0, le=1e9)  # b [N s/m^(n+1)]
    exponent: Number = Field(ge=1.0, le=4.0)  # n [-]; 1.5 for a sphere on an elastic half space

    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        """Compute (k + b dx/dt) x^n [N]; negative on fast retraction, where dx/dt < -k / b."""
        return (self.stiffness + self.damping * rate_m_s) * float(depth_m**self.exponent)


class KelvinVoigtLaw(ObjectLaw):
    """F = k x + c dx/dt, x the depth (paper, section V).

    The dashpot makes the force jump to c * v at touch, and would pull on retraction; a dry surface cannot
    pull, so the force is clipped at zero unless the object is sticky.
    """

    name = "kelvin_voigt"

    stiffness_n_m: Number = Field(ge=0, le=1e6)  # spring constant k [N/m]
    damping_n_s_m: Number = Field(ge=0, le=1e4)  # viscous damping c [N s/m]
    sticky: bool = False  # whether the object may pull while the tip is below its surface

    def material_force_n(self, depth_m: float, rate_m_s: float) -> float:
        """Compute k x + c dx/dt [N]; negative on retraction, where dx/dt < -k x / c."""
        return self.stiffness_n_m * depth_m + self.damping_n_s_m * rate_m_s

    @property
    def can_pull(self) -> bool:
        return self.sticky
