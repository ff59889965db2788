"""Hidden effects in the contact: the material's law, its memory, and a compliant tool."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from math import exp
from typing import Generic, TypeVar

import numpy as np
from numpy.random import Generator

from palpate.robot_io.files.file_model import NotNegative, Number, Positive
from palpate.sim_backend.hooks import ContactEffect, ContactState, HiddenEffects, MaterialEffect, ToolEffect
from palpate.sim_backend.imperfection import ContactImperfection, Values, parameter
from palpate.sim_backend.noise_scale import NoiseScale


class _MaterialImperfection(ContactImperfection, MaterialEffect, ABC):
    """A force on top of the object's own law, below the surface; without a memory."""

    def effects(self, joint_count: int) -> HiddenEffects:
        return HiddenEffects(contact=(self,))

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """Add the force of the material below the surface, and nothing above it."""
        return force_n + self._added_n(state.depth_m, state.rate_m_s) if state.depth_m > 0.0 else force_n

    @abstractmethod
    def _added_n(self, depth_m: float, rate_m_s: float) -> float:
        """Compute the force on the tip [N] at a depth above 0 [m] and a rate, positive inwards [m/s]."""


class HiddenCubicStiffness(_MaterialImperfection):
    """F += k3 x^3 at depth x (Duffing's spring; Nayfeh and Mook, "Nonlinear Oscillations", 1979, ch. 4)."""

    name = "cubic_stiffness"
    # k3, negative where the object softens [N/m^3].
    cubic_n_m3: Number = parameter("N/m^3", 1e4, 1e7, ge=-1e9, le=1e12)

    def _added_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.cubic_n_m3 * depth_m * depth_m * depth_m

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        depth_share = scale.depth_left(strength, 0.09)
        return {"cubic_n_m3": (1.0 - depth_share) * scale.force_n / (depth_share * scale.depth_m) ** 3}


class HiddenLayeredStiffness(_MaterialImperfection):
    """F += k2 (x - d) beyond depth d, where a second spring begins, like bone under tissue.

    Piecewise linear stiffness; Shaw and Holmes, J. Sound Vib. 90 (1983).
    """

    name = "layered_stiffness"
    # k2, stiffness of the second layer [N/m].
    stiffness_n_m: Number = parameter("N/m", 50.0, 5000.0, ge=0, le=1e6)
    depth_m: NotNegative = parameter("m", 0.001, 0.05, le=1.0)  # d, depth of the second layer [m]

    def _added_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.stiffness_n_m * max(depth_m - self.depth_m, 0.0)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        depth_share, share = scale.depth_left(strength, 0.06), generator.uniform(0.35, 0.6)
        reached_m = depth_share * scale.depth_m
        return {
            "stiffness_n_m": (1.0 - depth_share) * scale.force_n / ((1.0 - share) * reached_m),
            "depth_m": share * reached_m,
        }


class HiddenHuntCrossley(_MaterialImperfection):
    """F += (k + b dx/dt) x^n at depth x; the force is zero at first touch and grows with depth.

    Hunt and Crossley, J. Appl. Mech. 42 (1975), eq. 2. It adds to the object's own law.
    """

    name = "hunt_crossley"
    damping: Number = parameter("N s/m^(n+1)", 100.0, 1e4, ge=0, le=1e9, default=0.0)  # b [N s/m^(n+1)]
    stiffness: Number = parameter("N/m^n", 100.0, 1e4, ge=0, le=1e9, default=0.0)  # k [N/m^n]
    exponent: Number = parameter("-", 1.0, 2.5, ge=1, le=4, default=1.5)  # n [-]

    def _added_n(self, depth_m: float, rate_m_s: float) -> float:
        return (self.stiffness + self.damping * rate_m_s) * float(depth_m**self.exponent)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        unit = scale.contact_noise_n / (0.2 * scale.depth_m**1.5 * scale.speed_m_s)
        damping = 0.5 * strength * unit  # the other half is elastic, since in this law both grow together
        return {"damping": damping, "stiffness": damping * scale.speed_m_s, "exponent": 1.5}


class HiddenQuadraticDamping(_MaterialImperfection):
    """F += c2 v |v| below the surface, with the rate v of depth: fluid pressed out of pores.

    Turbulent drag; Forchheimer's term in Bear, "Dynamics of Fluids in Porous Media", 1972, sec. 5.11.
    """

    name = "quadratic_damping"
    damping_n_s2_m2: Number = parameter("N s^2/m^2", 10.0, 1000.0, ge=0, le=5000)  # c2 [N s^2/m^2]

    def _added_n(self, depth_m: float, rate_m_s: float) -> float:
        return self.damping_n_s2_m2 * rate_m_s * abs(rate_m_s)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"damping_n_s2_m2": strength * scale.contact_noise_n / (0.7 * scale.speed_m_s**2)}


class HiddenContactOffset(ContactImperfection, MaterialEffect):
    """F = F(x + d): the surface is higher by d than the scenario states.

    The effect is visible only if the surface is assumed to be known. A probing run finds it by touch.
    """

    name = "contact_offset"
    shows_in = ()
    needs_force_law = True
    offset_m: Number = parameter("m", -0.005, 0.005, ge=-0.5, le=0.5)  # d [m]

    def effects(self, joint_count: int) -> HiddenEffects:
        return HiddenEffects(contact=(self,))

    def transform_state(self, state: ContactState) -> ContactState:
        """Raise the surface by d."""
        return state._replace(depth_m=state.depth_m + self.offset_m)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; here for a surface that is taken as given."""
        sign = generator.choice([-1.0, 1.0])
        return {"offset_m": sign * strength * scale.contact_noise_n * scale.depth_m / scale.force_n}


Hidden = TypeVar("Hidden")
T = TypeVar("T")


class _StatefulContact(ContactEffect, Generic[Hidden, T]):
    """Memory of a hidden effect after the last completed step (`confirmed`), and the last call (`tried`)."""

    def __init__(self, hidden: Hidden, initial: T) -> None:
        self._hidden = hidden
        self.confirmed = self.tried = initial

    def commit_state(self) -> None:
        self.confirmed = self.tried


class HiddenAdhesion(ContactImperfection):
    """F -= A after touch, and above the surface until the neck of the bond tears.

    Above the surface the pull falls linearly from A to zero at the neck's length. Before touch there is
    no pull. A is the pull-off force of Derjaguin, Muller and Toporov, J. Colloid Interface Sci. 53
    (1975): a constant attraction on top of the elastic contact.
    """

    name = "adhesion"
    pull_off_n: NotNegative = parameter("N", 0.05, 3.0, le=50.0)  # A [N]
    # Height at which the bond tears [m].
    neck_m: Positive = parameter("m", 1e-4, 5e-3, ge=1e-5, le=0.1, default=1e-3)

    def effects(self, joint_count: int) -> HiddenEffects:
        return HiddenEffects(contact=(_AdhesiveBond(self, False),))

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"pull_off_n": strength * scale.contact_noise_n, "neck_m": 0.1 * scale.depth_m}


class _AdhesiveBond(_StatefulContact[HiddenAdhesion, bool]):
    """State of the adhesive bond: whether it holds."""

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """Subtract the pull of the bond: A below the surface, A (1 + x / neck) above it until it tears."""
        bond_share = 1.0 + state.depth_m / self._hidden.neck_m
        self.tried = state.depth_m > 0.0 or (self.confirmed and bond_share > 0.0)
        return force_n - self._hidden.pull_off_n * min(bond_share, 1.0) if self.tried else force_n


class HiddenDryFriction(ContactImperfection):
    """F += z, dz/abs(dx) = (f sign(dx) - z) / s: opposes the motion, and saturates after a path of a few s.

    Dahl's model, "Solid friction damping of mechanical vibrations", AIAA J. 14 (1976): rate-independent
    hysteresis. It is integrated exactly over each step, so that no stiffness f / s can make it unstable.
    """

    name = "dry_friction"
    friction_n: NotNegative = parameter("N", 0.05, 3.0, le=50.0)  # f [N]
    # s, path over which the friction builds up [m].
    slip_m: Number = parameter("m", 2e-5, 1e-3, ge=1e-6, le=0.1, default=2e-4)

    def effects(self, joint_count: int) -> HiddenEffects:
        return HiddenEffects(contact=(_BristleFriction(self, (0.0, 0.0)),))

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"friction_n": strength * scale.contact_noise_n / 0.5, "slip_m": 0.01 * scale.depth_m}


class _BristleFriction(_StatefulContact[HiddenDryFriction, tuple[float, float]], MaterialEffect):
    """State of the friction: depth [m] and force [N]."""

    acts_on_tip = True

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """Add z = f + (z0 - f) exp(-abs(dx) / s) in contact.

        f is the friction in the direction of the step dx, z0 the force before it, and s the slip distance.
        """
        before_m, before_n = self.confirmed
        depth_m = max(state.depth_m, 0.0)
        step_m = depth_m - before_m
        sliding_n = self._hidden.friction_n if step_m > 0.0 else -self._hidden.friction_n
        bristle_n = sliding_n + (before_n - sliding_n) * exp(-abs(step_m) / self._hidden.slip_m)
        self.tried = depth_m, bristle_n if depth_m else 0.0
        return force_n + self.tried[1]


class HiddenStressRelaxation(ContactImperfection):
    """F += sum of F_i, dF_i/dt = k_i dx/dt - F_i / tau_i: one or two Maxwell branches parallel to the spring.

    The generalized Maxwell (Wiechert) solid; Ferry, "Viscoelastic Properties of Polymers", 1980, ch. 1. Only
    the object's own spring remains in the end. After the tip has left, the surface recovers without force,
    with the time constant tau_1 / (1 - f) for one branch with the share f of the stiffness.
    """

    name = "stress_relaxation"
    stiffness_n_m: Number = parameter("N/m", 20.0, 2000.0, ge=0, le=1e6)  # k_1 [N/m]
    time_s: Number = parameter("s", 0.02, 2.0, ge=1e-3, le=1e3)  # tau_1 [s]
    # k_2; zero for one branch only [N/m].
    second_stiffness_n_m: Number = parameter("N/m", 0.0, 2000.0, ge=0, le=1e6, default=0.0)
    second_time_s: Number = parameter("s", 0.02, 2.0, ge=1e-3, le=1e3, default=1.0)  # tau_2 [s]

    def effects(self, joint_count: int) -> HiddenEffects:
        second = self.second_stiffness_n_m, self.second_time_s
        branches = [(self.stiffness_n_m, self.time_s), *([second] if self.second_stiffness_n_m else [])]
        return HiddenEffects(contact=tuple(_MaxwellBranch(branch, (0.0, 0.0)) for branch in branches))

    def values(self) -> dict[str, tuple[float, str]]:
        """See `Imperfection.values`; a second branch only where there is one."""
        return {
            name: value
            for name, value in super().values().items()
            if self.second_stiffness_n_m or not name.startswith("second_")
        }

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {
            "stiffness_n_m": strength * scale.contact_noise_n / (0.08 * scale.depth_m),
            "time_s": float(np.exp(generator.uniform(np.log(0.08), np.log(0.5)))),
        }


class _MaxwellBranch(_StatefulContact[tuple[float, float], tuple[float, float]], MaterialEffect):
    """State of one branch: depth [m] and force [N]; exact if the depth rate is constant within a step."""

    def contact_force_n(self, state: ContactState, force_n: float) -> float:
        """Add F = F0 exp(-h / tau) + k dx (1 - exp(-h / tau)) tau / h in contact, with h the step."""
        (stiffness_n_m, time_s), (before_m, before_n) = self._hidden, self.confirmed
        depth_m, steps = max(state.depth_m, 0.0), state.step_s / time_s
        fade = exp(-steps)
        own_n = fade * before_n + stiffness_n_m * (depth_m - before_m) * (1.0 - fade) / steps
        self.tried = depth_m, own_n
        return force_n + own_n if depth_m else force_n


class HiddenPlasticSet(ContactImperfection):
    """The surface sinks with the deepest indentation: the dent is s max(x), and F = F(x - dent).

    Loading for the first time is softer by 1 - s than unloading and loading again, which begin at the dent.
    Source: unloading after plastic contact, Johnson, "Contact Mechanics", 1985, sec. 6.4. With a
    recovery time, as for a foam, the dent fades while nothing presses.
    """

    name = "plastic_set"
    needs_force_law = True
    share: Number = parameter("-", 0.01, 0.4, ge=0, le=0.9)  # s, dent over indentation [-]
    # Time in which a dent fades to 1/e; zero is never [s].
    recovery_s: NotNegative = parameter("s", 0.0, 60.0, default=0.0)

    def effects(self, joint_count: int) -> HiddenEffects:
        return HiddenEffects(contact=(_PlasticIndentation(self, 0.0),))

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"share": min(strength * scale.contact_noise_n / (0.15 * scale.force_n), 0.6)}


class _PlasticIndentation(_StatefulContact[HiddenPlasticSet, float], MaterialEffect):
    """State of the dent: its depth [m]."""

    def transform_state(self, state: ContactState) -> ContactState:
        """Lower the surface to the dent, which deepens to s x and fades while nothing presses."""
        share, recovery_s = self._hidden.share, self._hidden.recovery_s
        dent_m, dent_rate_m_s = self.confirmed, 0.0
        if recovery_s:
            dent_m *= exp(-state.step_s / recovery_s)
            dent_rate_m_s = -dent_m / recovery_s
        if share * state.depth_m > dent_m:
            dent_m, dent_rate_m_s = share * state.depth_m, share * state.rate_m_s
        self.tried = dent_m
        return state._replace(depth_m=state.depth_m - dent_m, rate_m_s=state.rate_m_s - dent_rate_m_s)


_EXACT_N, _EXACT_M = 1e-9, 1e-15  # accuracy of the root: excess of force, and width of its bracket
_MOST_TRIES = 60
_RIGID_M_N = 1e-12  # compliance below which a tool is rigid


class HiddenToolCompliance(ContactImperfection):
    """A spring in series: the tool is compressed by u = C F, and the object by x - u.

    Both springs carry the same force, which is solved for at each physics step.
    """

    name = "tool_compliance"
    shows_in = ()  # alone it acts like a softer object
    needs_force_law = True
    # C, one over the tool's stiffness; zero is rigid [m/N].
    compliance_m_n: NotNegative = parameter("m/N", 1e-5, 1e-3, le=0.01)

    def effects(self, joint_count: int) -> HiddenEffects:
        is_rigid = self.compliance_m_n <= _RIGID_M_N
        return HiddenEffects() if is_rigid else HiddenEffects(tool=(_SeriesSpring(self.compliance_m_n),))

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; here for the force that a softer object would have as well."""
        compression_m = strength * scale.contact_noise_n * scale.depth_m / scale.force_n
        return {"compliance_m_n": compression_m / scale.force_n}


class _SeriesSpring(ToolEffect):
    """Solves u = C S(x - u, dx/dt - du/dt) for u, where S is the object's response.

    S grows with depth and rate, so that S(u) - u / C falls with u, and the root lies between zero and
    the object's response to a rigid tool. Regula falsi with the Illinois rule (Dowell and Jarratt, BIT 11,
    1971) cannot leave that bracket where S jumps; from the root of the last step's secant, it converges at
    once where S is linear.
    """

    def __init__(self, compliance_m_n: float) -> None:
        self._stiffness_n_m = 1.0 / compliance_m_n
        self._compression_m = self._tried_compression_m = 0.0
        self._slope_n_m = 0.0  # of S(u), by the last step's secant

    def contact_force_n(self, state: ContactState, surface_n: Callable[[ContactState], float]) -> float:
        """Solve for the compression u of the tool, and return u / C."""
        stiffness, before_m = self._stiffness_n_m, self._compression_m
        time_s, step_s, depth_m, rate_m_s = state

        def excess_n(compression_m: float) -> float:
            """Return by how much the object's force exceeds the tool's at a compression [N]."""
            rate = rate_m_s - (compression_m - before_m) / step_s
            answer_n = surface_n(ContactState(time_s, step_s, depth_m - compression_m, rate))
            return answer_n - stiffness * compression_m

        rigid_excess_n = excess_n(0.0)
        compression_m = self._root(excess_n, rigid_excess_n) if rigid_excess_n else 0.0
        self._tried_compression_m = compression_m
        return stiffness * compression_m

    def _root(self, excess_n: Callable[[float], float], rigid_excess_n: float) -> float:
        """Return the root of the balance `excess_n`, given its value without compression [m]."""
        near_m, near_n = 0.0, rigid_excess_n
        far_m = rigid_excess_n / (self._stiffness_n_m - self._slope_n_m)
        far_n = excess_n(far_m)
        if far_n * rigid_excess_n > 0.0:  # not far enough
            near_m, near_n, far_m = far_m, far_n, rigid_excess_n / self._stiffness_n_m
            far_n = excess_n(far_m)
        for _ in range(_MOST_TRIES):
            if abs(far_n) < _EXACT_N or abs(far_m - near_m) < _EXACT_M:
                break
            compression_m = (near_m * far_n - far_m * near_n) / (far_n - near_n)
            now_n = excess_n(compression_m)
            if now_n * far_n < 0.0:
                near_m, near_n = far_m, far_n
            else:
                near_n *= 0.5
            far_m, far_n = compression_m, now_n
        self._slope_n_m = min((far_n - rigid_excess_n) / far_m + self._stiffness_n_m, 0.0)
        return far_m

    def commit_state(self) -> None:
        self._compression_m = self._tried_compression_m
