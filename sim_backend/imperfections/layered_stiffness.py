"""A stiffer layer under the first one."""

from typing import ClassVar, Self

from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number
from sim_backend.hooks import ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale


class LayeredStiffness(ContactImperfection):
    """F += k2 (x - d) from depth d on: a second spring is reached there, as bone under tissue.

    Piecewise linear stiffness; Shaw and Holmes, J. Sound Vib. 90 (1983).
    """

    name: ClassVar[str] = "layered_stiffness"
    # k2, what the second layer adds [N/m].
    stiffness_n_m: Number = parameter("N/m", 50.0, 5000.0, ge=0, le=1e6)
    depth_m: NotNegative = parameter("m", 0.001, 0.05, le=1.0)  # d, where it is reached [m]

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_SecondLayer(self.stiffness_n_m, self.depth_m),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        left, share = scale.depth_left(strength, 0.06), generator.uniform(0.35, 0.6)
        reached_m = left * scale.depth_m
        return cls(
            stiffness_n_m=(1.0 - left) * scale.force_n / ((1.0 - share) * reached_m),
            depth_m=share * reached_m,
        )


class _SecondLayer(MaterialEffect):
    def __init__(self, stiffness_n_m: float, depth_m: float) -> None:
        self._stiffness_n_m = stiffness_n_m
        self._depth_m = depth_m

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        below_m = state.depth_m - self._depth_m
        return force_n + self._stiffness_n_m * below_m if below_m > 0.0 else force_n
