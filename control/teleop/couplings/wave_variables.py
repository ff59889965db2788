"""Wave variables: velocity and force go as two waves, and a delayed wave carries no more energy than it had.

    u = (b v + F) / sqrt(2 b),   w = (b v - F) / sqrt(2 b),   F v = u^2 / 2 - w^2 / 2

Niemeyer and Slotine, "Stable adaptive teleoperation", IEEE J. Oceanic Eng. 16(1), 1991; integrals of the
waves against drift: "Telemanipulation with time delays", IJRR 23(9), 2004. A wave that is held
because nothing newer has come would produce energy (Berestesky, Chopra and Spong, ICRA 2004): each packet
tells how much energy was sent up to it, and no side lets out more.
"""

import math

from control.teleop.couplings.channel import Packet, Playout
from control.teleop.couplings.coupling import TRACKING, Coupling, Port, Side

IMPEDANCE_N_S_M = 30.0  # b: felt as drag in free air, and over a delay T as a spring b / T in contact
_CATCH_UP_1_S = 5.0  # how fast the integrals are brought together
_GAP_STEPS = 5.0  # energy is kept back to hold the wave for so long, before any is spent on catching up


class WaveEnd:
    """One end of the two lines: counts what goes out, and gives back what came in, never more than that."""

    def __init__(self) -> None:
        self._sent = self._sent_j = self._used = self._used_j = 0.0

    def send(self, wave: float, dt_s: float) -> Packet:
        """The packet for a wave [sqrt(W)]: itself, its integral, and the energy sent so far [J]."""
        self._sent += wave * dt_s
        self._sent_j += 0.5 * wave * wave * dt_s
        return wave, self._sent, self._sent_j

    def receive(self, newest: Packet | None, dt_s: float) -> float:
        """The wave to use in this step [sqrt(W)]."""
        if newest is None:
            return 0.0
        wave, sent, sent_j = newest
        left_j = max(0.0, sent_j - self._used_j)
        if left_j > _GAP_STEPS * 0.5 * wave * wave * dt_s:
            wave += _CATCH_UP_1_S * (sent - self._used)
        most = math.sqrt(2.0 * left_j / dt_s)
        wave = math.copysign(min(abs(wave), most), wave)
        self._used += wave * dt_s
        self._used_j += 0.5 * wave * wave * dt_s
        return wave


class WaveLeader(Side):
    """Turns its velocity and the wave that comes into a force and a wave that goes."""

    def __init__(self) -> None:
        self._end = WaveEnd()
        self._root = math.sqrt(2.0 * IMPEDANCE_N_S_M)

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        back = self._end.receive(newest, dt_s)
        force_n = IMPEDANCE_N_S_M * port.velocity_m_s - self._root * back
        return -force_n, self._end.send(self._root * port.velocity_m_s - back, dt_s)


class WaveFollower(Side):
    """Turns the wave that comes into a wanted velocity, and the tracking's force into a wave that goes.

    Wanted velocity and force depend on each other; solved for the end of the step (implicit), the spring of
    the tracking makes no energy.
    """

    def __init__(self) -> None:
        self._end = WaveEnd()
        self._root = math.sqrt(2.0 * IMPEDANCE_N_S_M)
        self._wanted_m = math.nan

    def _step(self, port: Port, newest: Packet | None, dt_s: float) -> tuple[float, Packet]:
        wave = self._end.receive(newest, dt_s)
        ahead_m = 0.0 if math.isnan(self._wanted_m) else self._wanted_m - port.position_m
        yielding_n_s_m = IMPEDANCE_N_S_M + TRACKING.stiffness_n_m * dt_s
        free_m_s = self._root * wave / IMPEDANCE_N_S_M  # wanted velocity if there were no force
        force_n = (TRACKING.stiffness_n_m * ahead_m + yielding_n_s_m * (free_m_s - port.velocity_m_s)) / (
            1.0 + yielding_n_s_m / IMPEDANCE_N_S_M
        )
        wanted_m_s = free_m_s - force_n / IMPEDANCE_N_S_M
        self._wanted_m = port.position_m + ahead_m + wanted_m_s * dt_s
        return force_n, self._end.send(wave - self._root * force_n / IMPEDANCE_N_S_M, dt_s)


WAVE_VARIABLES = Coupling("wave variables", WaveLeader, WaveFollower, Playout)
