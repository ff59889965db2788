"""A surface that stays dented."""

from math import exp
from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class PlasticSet(ContactImperfection):
    """The surface sinks with the deepest indentation: its dent is s max(x), and the object feels x - dent.

    Loading for the first time is softer by 1 - s than unloading and loading again, which begin at the dent.
    As unloading after plastic contact in Johnson, "Contact Mechanics", 1985, sec. 6.4. A foam
    recovers; with a recovery time the dent fades while nothing presses.
    """

    name: ClassVar[str] = "plastic_set"
    needs_force_law: ClassVar[bool] = True
    share: Number = parameter("-", 0.01, 0.4, ge=0, le=0.9)  # s, dent over indentation [-]
    # Time in which a dent fades to 1/e; zero is never [s].
    recovery_s: NotNegative = parameter("s", 0.0, 60.0, default=0.0)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Dent(self.share, self.recovery_s),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(share=min(strength * scale.contact_noise_n / (0.15 * scale.force_n), 0.6))


class _Dent(MaterialEffect):
    def __init__(self, share: float, recovery_s: float) -> None:
        self._share = share
        self._recovery_s = recovery_s
        self._dent_m = self._tried_dent_m = 0.0

    def felt(self, state: ContactState) -> ContactState:
        dent_m, dent_rate_m_s = self._dent_m, 0.0
        if self._recovery_s:
            dent_m *= exp(-state.step_s / self._recovery_s)
            dent_rate_m_s = -dent_m / self._recovery_s
        if self._share * state.depth_m > dent_m:
            dent_m, dent_rate_m_s = self._share * state.depth_m, self._share * state.rate_m_s
        self._tried_dent_m = dent_m
        return state._replace(depth_m=state.depth_m - dent_m, rate_m_s=state.rate_m_s - dent_rate_m_s)

    def settle(self) -> None:
        self._dent_m = self._tried_dent_m
