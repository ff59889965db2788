"""Hidden effects between a drive, whose side the encoder sees, and its link."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import exp, inf
from typing import Self

import numpy as np
from numpy.random import Generator

from robot_io.files.file_model import NotNegative, Positive
from robot_io.types import FloatArray
from sim_backend.hooks import HiddenEffects, JointEffect, JointStepState, SensorHook
from sim_backend.imperfection import JointImperfection, parameter
from sim_backend.noise_scale import CONTACT, LOADED, NoiseScale, channel_of, joint_of


class _Transmission(JointImperfection, ABC):
    """The encoder is ahead of the link by u; the whole torque passes through.

    The drive has no inertia of its own here: the rotor's is part of the link's, as in the URDF.
    """

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the tip is not where the encoders say."""
        return (channel_of(self.joint), CONTACT)

    def effects(self, joint_count: int) -> HiddenEffects:
        ahead = _Ahead(self.index_in(joint_count), self)
        return HiddenEffects(joint=(ahead,), encoder=(ahead,))

    @abstractmethod
    def ahead_rad(self, before_rad: float, step_s: float, torque_nm: float) -> float:
        """How far the encoder is ahead after a step with this torque, given how far it was before [rad]."""


class _Ahead(JointEffect, SensorHook):
    def __init__(self, index: int, transmission: _Transmission) -> None:
        self._index = index
        self._transmission = transmission
        self.restart()

    def restart(self) -> None:
        self._ahead_rad = 0.0

    def joint_torque_nm(self, state: JointStepState, torque_nm: Sequence[float]) -> Sequence[float]:
        self._ahead_rad = self._transmission.ahead_rad(self._ahead_rad, state.step_s, torque_nm[self._index])
        return torque_nm

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        changed = list(value)
        changed[self._index] += self._ahead_rad
        return changed


class HiddenBacklash(_Transmission):
    """The encoder, on the drive's side, is ahead of the link by u within +- gap/2, on the side that pushes.

    The drive crosses the gap when the torque changes sign, du/dt = tau / d, held up by the grease: the
    physical model of Nordin and Gutman, Automatica 38 (2002), with a shaft that only damps.
    """

    name = "backlash"
    shows_in = ()  # in probing, weight keeps the play on one side
    gap_rad: NotNegative = parameter("rad", 2e-4, 0.01, le=0.2)  # from one flank to the other [rad]
    # d, of the grease in the gap [N m s/rad].
    film_nms_rad: Positive = parameter("N m s/rad", 1.0, 100.0, ge=0.1, le=1e4, default=10.0)

    def ahead_rad(self, before_rad: float, step_s: float, torque_nm: float) -> float:
        reach_rad = 0.5 * self.gap_rad
        return max(-reach_rad, min(reach_rad, before_rad + step_s * torque_nm / self.film_nms_rad))

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; here of what a controller does about the gap that it sees."""
        stiffness_nm_rad = 3600.0 * scale.joint(channel).inertia_kg_m2
        gap_rad = strength * scale.joint_noise_nm / stiffness_nm_rad
        return cls(joint=joint_of(channel), gap_rad=min(gap_rad, 0.02))


class HiddenJointElasticity(_Transmission):
    """The encoder, on the drive's side, is ahead of the link by the twist u of a spring that carries tau.

    T du/dt = C tau - u: spring and dashpot in parallel. It is the slow part of Spong's model (J. Dyn. Sys.
    Meas. Control 109, 1987).
    """

    name = "joint_elasticity"
    shows_in = ()  # in probing, the twist is mostly that of the steady weight
    # C, one over the stiffness; zero is rigid [rad/(N m)].
    compliance_rad_nm: NotNegative = parameter("rad/(N m)", 5e-5, 2e-3, le=0.05)
    # T, damping over stiffness [s].
    retardation_s: NotNegative = parameter("s", 0.005, 0.1, le=10.0, default=0.02)

    def ahead_rad(self, before_rad: float, step_s: float, torque_nm: float) -> float:
        left = exp(-step_s / self.retardation_s) if self.retardation_s else 0.0
        settled_rad = self.compliance_rad_nm * torque_nm
        return settled_rad + left * (before_rad - settled_rad)

    @classmethod
    def at_strength(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Self:
        """See `Imperfection.at_strength`; as soft as can still be controlled by the encoder at most."""
        compliance_rad_nm = strength * scale.joint_noise_nm / (25.0 * scale.joint(channel).load_nm)
        return cls(joint=joint_of(channel), compliance_rad_nm=min(compliance_rad_nm, 2e-3))


_REFRESH_S = 4e-3  # the arm's inertia changes by 1 % in it


class HiddenArmature(JointImperfection):
    """tau = J d^2q/dt^2 is what the rotor takes of the drive's torque; the link gets the rest.

    J is the rotor's own inertia times the square of the gear ratio. With a high ratio the rotor turns so much
    faster than the links that it feels the own joint's acceleration only: J stands on the diagonal of the
    joint-space inertia, as in Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 9.
    """

    name = "armature"
    shows_in = LOADED  # the last joint's controller becomes unstable before it shows
    inertia_kg_m2: NotNegative = parameter("kg m^2", 0.001, 0.5, le=10.0)  # J [kg m^2]

    def effects(self, joint_count: int) -> HiddenEffects:
        inertia_kg_m2 = np.zeros(joint_count)
        inertia_kg_m2[self.index_in(joint_count)] = self.inertia_kg_m2
        return (
            HiddenEffects(joint=(Rotors(inertia_kg_m2.tolist()),)) if self.inertia_kg_m2 else HiddenEffects()
        )

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

    def joint_torque_nm(self, state: JointStepState, torque_nm: Sequence[float]) -> Sequence[float]:
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
