"""A sticky surface that holds the tip back."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Positive
from sim_backend.hooks import ContactEffect, ContactState, Effects
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class Adhesion(ContactImperfection):
    """F -= A from touch on, also above the surface, where the neck of the bond thins out until it tears.

    Above the surface the pull falls linearly from A to nothing at the neck's length. On approach nothing
    pulls before touch. A is the pull-off force of Derjaguin, Muller and Toporov, J. Colloid Interface Sci. 53
    (1975): a constant attraction on top of the elastic contact.
    """

    name: ClassVar[str] = "adhesion"
    pull_off_n: NotNegative = parameter("N", 0.05, 3.0, le=50.0)  # A [N]
    # Height at which the bond tears [m].
    neck_m: Positive = parameter("m", 1e-4, 5e-3, ge=1e-5, le=0.1, default=1e-3)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Bond(self.pull_off_n, self.neck_m),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(pull_off_n=strength * scale.contact_noise_n, neck_m=0.1 * scale.depth_m)


class _Bond(ContactEffect):
    def __init__(self, pull_off_n: float, neck_m: float) -> None:
        self._pull_off_n = pull_off_n
        self._neck_m = neck_m
        self._holds = self._tried_holds = False

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        left = 1.0 + state.depth_m / self._neck_m
        self._tried_holds = state.depth_m > 0.0 or (self._holds and left > 0.0)
        return force_n - self._pull_off_n * min(left, 1.0) if self._tried_holds else force_n

    def settle(self) -> None:
        self._holds = self._tried_holds
