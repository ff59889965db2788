"""The inertia of a drive's rotor."""

from collections.abc import Sequence
from math import inf
from typing import ClassVar, Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from sim_backend.hooks import Effects, JointEffect, JointState
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import LOADED, NoiseScale, joint_of

_REFRESH_S = 4e-3  # the arm's inertia changes by 1 % in it


class Armature(JointImperfection):
    """tau = J d^2q/dt^2 is what the rotor takes of the drive's torque; the link gets the rest.

    J is the rotor's own inertia times the square of the gear ratio. With a high ratio the rotor turns so much
    faster than the links that it feels the own joint's acceleration only: J stands on the diagonal of the
    joint-space inertia, as in Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 9.
    """

    name: ClassVar[str] = "armature"
    shows_in: ClassVar[Sequence[str]] = LOADED  # the last joint's controller masters none that shows
    inertia_kg_m2: NotNegative = parameter("kg m^2", 0.001, 0.5, le=10.0)  # J [kg m^2]

    def effects(self, joint_count: int) -> Effects:
        index = self.index_in(joint_count)
        return Effects(joint=(_Rotor(index, self.inertia_kg_m2),)) if self.inertia_kg_m2 else Effects()

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller that knows the arm alone can master."""
        joint = scale.joint(channel)
        inertia_kg_m2 = strength * scale.joint_noise_nm / joint.acceleration_rad_s2
        return cls(joint=joint_of(channel), inertia_kg_m2=min(inertia_kg_m2, 6.0 * joint.inertia_kg_m2))


class _Rotor(JointEffect):
    """Solves (M + J e e^T) a = tau + r for the step, where the engine solves M a = tau - J a e + r.

    What the arm's weight, contact and friction do, r, is what the last step's motion leaves of the equation;
    the acceleration of the joint without the rotor is a0 = a_last + w (tau - tau_last) with w the joint's row
    of M^-1, and with it a = a0 / (1 + J w_i) (Sherman and Morrison). Taking J a_last instead, the obvious
    way, diverges as soon as the rotor is heavier than what the joint feels of the arm.
    """

    def __init__(self, index: int, inertia_kg_m2: float) -> None:
        self._index = index
        self._inertia_kg_m2 = inertia_kg_m2
        self.restart()

    def restart(self) -> None:
        self._last: tuple[float, Sequence[float]] | None = None
        self._refresh_s = -inf

    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        i, speed_rad_s = self._index, state.velocity_rad_s[self._index]
        changed = list(torque_nm)
        if state.time_s >= self._refresh_s:
            unit = np.eye(len(changed))[i]
            self._row: list[float] = np.linalg.solve(state.mass_matrix(), unit).tolist()
            self._refresh_s = state.time_s + _REFRESH_S
        if self._last is not None:
            last_speed_rad_s, last_nm = self._last
            without = (speed_rad_s - last_speed_rad_s) / state.step_s
            for share, now, then in zip(self._row, changed, last_nm, strict=True):
                without += share * (now - then)
            changed[i] -= self._inertia_kg_m2 * without / (1.0 + self._inertia_kg_m2 * self._row[i])
        self._last = speed_rad_s, changed
        return changed
