"""Four-channel coupling: positions and forces go both ways, each side is told the other's force and motion.

Lawrence, "Stability and transparency in bilateral teleoperation", IEEE T-RA 9(5), 1993, with C2 = C3 = 1,
C1 and C4 the position controls of the sides (inertias are not fed forward: accelerations are not measured).
"""

from control.teleop.couplings.channel import Packet
from control.teleop.couplings.coupling import TRACKING, Coupling, Port, Side


class FourChannelSide(Side):
    """Tracks the other side, and adds the force measured there; `reflects` where that is a compression."""

    def __init__(self, *, reflects: bool) -> None:
        self._sign = -1.0 if reflects else 1.0

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        other_m, other_m_s, other_n = newest or (port.position_m, port.velocity_m_s, 0.0)
        tracking_n = TRACKING.force_n(other_m - port.position_m, other_m_s - port.velocity_m_s)
        return tracking_n + self._sign * other_n, tuple(port)


FOUR_CHANNEL = Coupling(
    "four-channel", lambda: FourChannelSide(reflects=True), lambda: FourChannelSide(reflects=False)
)
