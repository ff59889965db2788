"""The inertia of a drive's rotor."""

from collections.abc import Sequence
from math import inf
from typing import Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import NotNegative
from robot_io.types import FloatArray
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

    name = "armature"
    shows_in = LOADED  # the last joint's controller masters none that shows
    inertia_kg_m2: NotNegative = parameter("kg m^2", 0.001, 0.5, le=10.0)  # J [kg m^2]

    def effects(self, joint_count: int) -> Effects:
        inertia_kg_m2 = np.zeros(joint_count)
        inertia_kg_m2[self.index_in(joint_count)] = self.inertia_kg_m2
        return Effects(joint=(Rotors(inertia_kg_m2.tolist()),)) if self.inertia_kg_m2 else Effects()

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; at most what a controller that knows the arm alone can master."""
        joint = scale.joint(channel)
        inertia_kg_m2 = strength * scale.joint_noise_nm / joint.acceleration_rad_s2
        return cls(joint=joint_of(channel), inertia_kg_m2=min(inertia_kg_m2, 6.0 * joint.inertia_kg_m2))


class Rotors(JointEffect):
    """Solves (M + J) a = tau + r for the step, J diagonal, where the engine solves M a = tau - J a + r.

    What the arm's weight, contact and friction do, r, is what the last step's motion leaves of the equation;
    the acceleration without the rotors is a0 = a_last + M^-1 (tau - tau_last), and with them it is
    a = (1 + M^-1 J)^-1 a0. Taking J a_last instead, the obvious way, diverges as soon as a rotor is heavier
    than what its joint feels of the arm. The inertia is that of all joints, shape (n,) [kg m^2].
    """

    def __init__(self, inertia_kg_m2: Sequence[float]) -> None:
        self._inertia_kg_m2 = np.array(inertia_kg_m2)
        self.restart()

    def restart(self) -> None:
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._refresh_s = -inf

    def joint_torque_nm(self, state: JointState, torque_nm: Sequence[float]) -> Sequence[float]:
        speed_rad_s, changed_nm = np.array(state.velocity_rad_s), np.array(torque_nm)
        if state.time_s >= self._refresh_s:
            self._inverse = np.linalg.inv(state.mass_matrix())
            self._share = np.linalg.inv(np.eye(len(changed_nm)) + self._inverse * self._inertia_kg_m2)
            self._refresh_s = state.time_s + _REFRESH_S
        if self._last is None:  # nothing has moved yet: the arm is in free air
            without = self._inverse.dot(changed_nm - state.bias_torque_nm())
        else:
            last_speed_rad_s, last_nm = self._last
            without = (speed_rad_s - last_speed_rad_s) / state.step_s
            without += self._inverse.dot(changed_nm - last_nm)
        changed_nm -= self._inertia_kg_m2 * self._share.dot(without)
        self._last = speed_rad_s, changed_nm
        values: list[float] = changed_nm.tolist()
        return values
