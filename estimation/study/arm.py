"""The arm to which measured joints and contacts belong."""

import re
from dataclasses import dataclass

from palpate.estimation.base_model import LEVEL_GRAVITY_M_S2, ModelContext
from palpate.estimation.channel import ChannelData


@dataclass(frozen=True)
class Arm:
    """The arm that was measured."""

    urdf: str = ""  # text of its URDF, empty where it is not known
    tip_frame: str = ""  # the tip's frame in it
    origin: str = "URDF text"  # where the URDF comes from, for errors
    # Shape (3,), fall acceleration in the axes of its base [m/s^2].
    gravity_m_s2: tuple[float, float, float] = LEVEL_GRAVITY_M_S2
    # Shape (n,), what its drives' rotors add to the joints, or empty [kg m^2].
    rotor_inertia_kg_m2: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()  # sentences on it that the reader should see

    def context_of(self, channel: ChannelData) -> ModelContext:
        """Return what a base model may need to know about a channel beside its data.

        Args:
            channel: of a contact, or "joint_N" with N counted from 1.
        """
        joint = re.fullmatch(r"joint_(\d+)", channel.name)
        return ModelContext(
            joint=int(joint[1]) - 1 if joint else None,
            urdf=self.urdf,
            tip_frame=self.tip_frame,
            urdf_origin=self.origin,
            gravity_m_s2=self.gravity_m_s2,
            rotor_inertia_kg_m2=self.rotor_inertia_kg_m2,
            surface_found=channel.surface is not None,
        )


NO_ARM = Arm()
