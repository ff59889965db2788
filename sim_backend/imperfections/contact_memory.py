"""A contact that remembers how it was pressed before."""

from math import exp
from typing import Generic, Self, TypeVar

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Number, Positive
from sim_backend.hooks import ContactEffect, ContactState, Effects, MaterialEffect
from sim_backend.imperfection import ContactImperfection, parameter
from sim_backend.noise_scale import NoiseScale

T = TypeVar("T")


class _Memory(ContactEffect, Generic[T]):
    """Keeps what the last step that held left behind (`kept`), and what the last call would (`tried`)."""

    def __init__(self, at_first: T) -> None:
        self.kept = self.tried = at_first

    def settle(self) -> None:
        self.kept = self.tried


class Adhesion(ContactImperfection):
    """F -= A from touch on, also above the surface, where the neck of the bond thins out until it tears.

    Above the surface the pull falls linearly from A to nothing at the neck's length. On approach nothing
    pulls before touch. A is the pull-off force of Derjaguin, Muller and Toporov, J. Colloid Interface Sci. 53
    (1975): a constant attraction on top of the elastic contact.
    """

    name = "adhesion"
    pull_off_n: NotNegative = parameter("N", 0.05, 3.0, le=50.0)  # A [N]
    # Height at which the bond tears [m].
    neck_m: Positive = parameter("m", 1e-4, 5e-3, ge=1e-5, le=0.1, default=1e-3)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Bond(self),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(pull_off_n=strength * scale.contact_noise_n, neck_m=0.1 * scale.depth_m)


class _Bond(_Memory[bool]):
    """Remembers whether it holds."""

    def __init__(self, surface: Adhesion) -> None:
        super().__init__(False)
        self._surface = surface

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        left = 1.0 + state.depth_m / self._surface.neck_m
        self.tried = state.depth_m > 0.0 or (self.kept and left > 0.0)
        return force_n - self._surface.pull_off_n * min(left, 1.0) if self.tried else force_n


class DryFriction(ContactImperfection):
    """F += z, dz/abs(dx) = (f sign(dx) - z) / s: against the motion, full after a way of a few s.

    Dahl's model, "Solid friction damping of mechanical vibrations", AIAA J. 14 (1976): rate-independent
    hysteresis. It is integrated exactly over each step, so that no stiffness f / s can make it unstable.
    """

    name = "dry_friction"
    friction_n: NotNegative = parameter("N", 0.05, 3.0, le=50.0)  # f [N]
    # s, way in which the bristles give way [m].
    slip_m: Number = parameter("m", 2e-5, 1e-3, ge=1e-6, le=0.1, default=2e-4)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Bristles(self),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(friction_n=strength * scale.contact_noise_n / 0.5, slip_m=0.01 * scale.depth_m)


class _Bristles(_Memory[tuple[float, float]], MaterialEffect):
    """Remembers depth [m] and force [N]."""

    def __init__(self, friction: DryFriction) -> None:
        super().__init__((0.0, 0.0))
        self._friction = friction

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        before_m, before_n = self.kept
        depth_m = max(state.depth_m, 0.0)
        way_m = depth_m - before_m
        full_n = self._friction.friction_n if way_m > 0.0 else -self._friction.friction_n
        bent_n = full_n + (before_n - full_n) * exp(-abs(way_m) / self._friction.slip_m)
        self.tried = depth_m, bent_n if depth_m else 0.0
        return force_n + self.tried[1]


class StressRelaxation(ContactImperfection):
    """F += sum of F_i, dF_i/dt = k_i dx/dt - F_i / tau_i: one or two Maxwell branches beside the spring.

    The generalised Maxwell (Wiechert) solid; Ferry, "Viscoelastic Properties of Polymers", 1980, ch. 1. The
    object's own spring is what is left in the end. The branches go on relaxing when the tip has left.
    """

    name = "stress_relaxation"
    stiffness_n_m: Number = parameter("N/m", 20.0, 2000.0, ge=0, le=1e6)  # k_1 [N/m]
    time_s: Number = parameter("s", 0.02, 2.0, ge=1e-3, le=1e3)  # tau_1 [s]
    # k_2; zero for one branch only [N/m].
    second_stiffness_n_m: Number = parameter("N/m", 0.0, 2000.0, ge=0, le=1e6, default=0.0)
    second_time_s: Number = parameter("s", 0.02, 2.0, ge=1e-3, le=1e3, default=1.0)  # tau_2 [s]

    def effects(self, joint_count: int) -> Effects:
        branches = [_MaxwellBranch(self.stiffness_n_m, self.time_s)]
        if self.second_stiffness_n_m:
            branches.append(_MaxwellBranch(self.second_stiffness_n_m, self.second_time_s))
        return Effects(contact=tuple(branches))

    def values(self) -> dict[str, tuple[float, str]]:
        """See `Imperfection.values`; a second branch only where there is one."""
        return {
            name: value
            for name, value in super().values().items()
            if self.second_stiffness_n_m or not name.startswith("second_")
        }

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(
            stiffness_n_m=strength * scale.contact_noise_n / (0.08 * scale.depth_m),
            time_s=float(np.exp(generator.uniform(np.log(0.08), np.log(0.5)))),
        )


class _MaxwellBranch(_Memory[tuple[float, float]], MaterialEffect):
    """Remembers depth [m] and force [N]; exact where depth changes at a constant rate within the step."""

    def __init__(self, stiffness_n_m: float, time_s: float) -> None:
        super().__init__((0.0, 0.0))
        self._stiffness_n_m = stiffness_n_m
        self._time_s = time_s

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        before_m, before_n = self.kept
        depth_m = max(state.depth_m, 0.0)
        steps = state.step_s / self._time_s
        fade = exp(-steps)
        own_n = fade * before_n + self._stiffness_n_m * (depth_m - before_m) * (1.0 - fade) / steps
        self.tried = depth_m, own_n
        return force_n + own_n if depth_m else force_n


class PlasticSet(ContactImperfection):
    """The surface sinks with the deepest indentation: its dent is s max(x), and the object feels x - dent.

    Loading for the first time is softer by 1 - s than unloading and loading again, which begin at the dent.
    As unloading after plastic contact in Johnson, "Contact Mechanics", 1985, sec. 6.4. A foam
    recovers; with a recovery time the dent fades while nothing presses.
    """

    name = "plastic_set"
    needs_force_law = True
    share: Number = parameter("-", 0.01, 0.4, ge=0, le=0.9)  # s, dent over indentation [-]
    # Time in which a dent fades to 1/e; zero is never [s].
    recovery_s: NotNegative = parameter("s", 0.0, 60.0, default=0.0)

    def effects(self, joint_count: int) -> Effects:
        return Effects(contact=(_Dent(self),))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        return cls(share=min(strength * scale.contact_noise_n / (0.15 * scale.force_n), 0.6))


class _Dent(_Memory[float], MaterialEffect):
    """Remembers its depth [m]."""

    def __init__(self, surface: PlasticSet) -> None:
        super().__init__(0.0)
        self._surface = surface

    def felt(self, state: ContactState) -> ContactState:
        share, recovery_s = self._surface.share, self._surface.recovery_s
        dent_m, dent_rate_m_s = self.kept, 0.0
        if recovery_s:
            dent_m *= exp(-state.step_s / recovery_s)
            dent_rate_m_s = -dent_m / recovery_s
        if share * state.depth_m > dent_m:
            dent_m, dent_rate_m_s = share * state.depth_m, share * state.rate_m_s
        self.tried = dent_m
        return state._replace(depth_m=state.depth_m - dent_m, rate_m_s=state.rate_m_s - dent_rate_m_s)
