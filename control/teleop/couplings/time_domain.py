"""Time-domain passivity: each side watches the energy of the link, and lets out no more than was put in.

Observer and controller: Hannaford and Ryu, "Time-domain passivity control of haptic interfaces", IEEE T-RA
18(1), 2002. With a delay no side sees both ends at once, so each sends what it has put in, and takes out at
most what it knows the other to have put in: Ryu, Artigas and Preusche, "A passive bilateral control scheme
for a teleoperator with time-varying communication delay", Mechatronics 20(7), 2010.

Each end of the link is a point that a spring joins to the device, and the controllers hold back that point's
motion. So the energy of a step is known before it is taken, where a controller that acts on the force of a
moving device corrects afterwards, and chatters on a light one (the leader's spring is our addition). In free
air no force comes back, and nothing would be put in for the follower to move with: the leader feels a drag,
whose energy goes to the link, as into the tank of Lee and Huang, IEEE T-RO 26(2), 2010.
"""

import math

from control.teleop.couplings.channel import Packet
from control.teleop.couplings.coupling import TRACKING, Coupling, Port, Side
from robot_io.clip import clip

DRAG_N_S_M = 10.0
RESERVE_J = 1e-3  # what each end may take at the very start, when nothing has been put in
_FASTEST_M_S = 0.5  # of a point of the link, after a gap in the packets above all


class Account:
    """Energy of one end of the link, as known there [J]."""

    def __init__(self) -> None:
        self.put_in_j = 0.0  # by this end
        self._taken_j = 0.0

    def book(self, work_j: float) -> None:
        """What this end did on the link in a step, negative if the link worked on it."""
        if work_j > 0.0:
            self.put_in_j += work_j
        else:
            self._taken_j -= work_j

    def share_allowed(self, taking_j: float, other_put_in_j: float) -> float:
        """The share 0 to 1 of a withdrawal that the other end is known to have covered."""
        left_j = max(0.0, RESERVE_J + other_put_in_j - self._taken_j)
        return 1.0 if taking_j <= left_j else left_j / taking_j


class TimeDomainLeader(Side):
    """Lets its point go where the spring has the force that comes, as far as the account covers it."""

    def __init__(self) -> None:
        self._account = Account()
        self._point_m = self._position_m = math.nan
        self._drag_n = 0.0

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if math.isnan(self._point_m):
            self._point_m = self._position_m = port.position_m
        force_n, other_put_in_j = newest or (0.0, 0.0)
        stiffness = TRACKING.stiffness_n_m
        ahead_m = port.position_m - self._point_m
        way_m = clip(ahead_m - force_n / stiffness, -_FASTEST_M_S * dt_s, _FASTEST_M_S * dt_s)
        way_m *= self._account.share_allowed(-stiffness * (ahead_m - way_m) * way_m, other_put_in_j)
        spring_n = stiffness * (ahead_m - way_m)  # after the step: less is put in, more taken, than really is
        self._account.book(spring_n * way_m)
        self._account.book(self._drag_n * (port.position_m - self._position_m))
        self._point_m += way_m
        self._position_m, self._drag_n = port.position_m, DRAG_N_S_M * port.velocity_m_s
        return -spring_n - self._drag_n, (port.position_m, self._account.put_in_j)


class TimeDomainFollower(Side):
    """Moves its point to where the leader is as far as the account covers it, and sends the tracking force.

    What was held back is made up for as soon as the account allows it, so positions do not drift apart.
    """

    def __init__(self) -> None:
        self._account = Account()
        self._wanted_m = math.nan

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        if math.isnan(self._wanted_m):
            self._wanted_m = port.position_m
        goal_m, other_put_in_j = newest or (self._wanted_m, 0.0)
        way_m = clip(goal_m - self._wanted_m, -_FASTEST_M_S * dt_s, _FASTEST_M_S * dt_s)
        way_m *= self._account.share_allowed(self._force_n(port, way_m, dt_s) * way_m, other_put_in_j)
        force_n = self._force_n(port, way_m, dt_s)  # smaller by more than the share, if that is below 1
        self._account.book(-force_n * way_m)
        self._wanted_m += way_m
        return force_n, (force_n, self._account.put_in_j)

    def _force_n(self, port: Port, way_m: float, dt_s: float) -> float:
        """Tracking force [N] after the wanted position has moved on by `way_m` [m]."""
        return TRACKING.force_n(self._wanted_m + way_m - port.position_m, way_m / dt_s - port.velocity_m_s)


TIME_DOMAIN = Coupling("time-domain passivity", TimeDomainLeader, TimeDomainFollower)
