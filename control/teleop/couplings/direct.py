"""Direct position-force coupling: the follower goes where the leader was, the leader feels what it measured.

Sheridan, "Space teleoperation through time delay", IEEE T-RA 9(5), 1993. Exact without delay; with delay it
produces energy, and is unstable on stiff objects.
"""

from control.teleop.couplings.channel import Packet
from control.teleop.couplings.coupling import TRACKING, Coupling, Port, Side


class DirectLeader(Side):
    """Sends position and velocity, renders the force that comes."""

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        return -newest[0] if newest else 0.0, (port.position_m, port.velocity_m_s)


class DirectFollower(Side):
    """Tracks position and velocity that come, sends the measured force."""

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        wanted_m, wanted_m_s = newest or (port.position_m, 0.0)
        force_n = TRACKING.force_n(wanted_m - port.position_m, wanted_m_s - port.velocity_m_s)
        return force_n, (port.force_n,)


DIRECT = Coupling("direct", DirectLeader, DirectFollower)
