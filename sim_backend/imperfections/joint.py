"""Hidden effects in a joint: friction, springs, ripple and gain, and between a drive and its link."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from math import exp, inf, sin, tau

import numpy as np
from numpy.random import Generator

from palpate.robot_io.files.file_model import NotNegative, Number, Positive
from palpate.robot_io.types import FloatArray
from palpate.sim_backend import hooks
from palpate.sim_backend.imperfection import JointImperfection, Values, parameter
from palpate.sim_backend.noise_scale import CONTACT, LOADED, NoiseScale, channel_of


class _FrictionImperfection(JointImperfection, ABC):
    """A resistance against the motion of one joint; at rest it balances any smaller torque."""

    def _effects(self, index: int, joint_count: int) -> hooks.HiddenEffects:
        return hooks.HiddenEffects(friction=(hooks.JointFriction(index, self._resistance_nm),))

    @abstractmethod
    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        """Compute the largest resistance, 0 or more [N m]; see `JointFriction.resistance_nm`."""


class HiddenViscousFriction(_FrictionImperfection):
    """tau = b |dq/dt| against the motion, as in grease (Armstrong-Helouvry, Automatica 30 (1994), sec. 2)."""

    name = "viscous_friction"
    viscous_nms_rad: NotNegative = parameter("N m s/rad", 0.02, 5.0, le=100.0)  # b [N m s/rad]

    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        return self.viscous_nms_rad * speed_rad_s

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        return {"viscous_nms_rad": strength * scale.joint_noise_nm / scale.joint(channel).speed_rad_s}


class HiddenQuadraticFriction(_FrictionImperfection):
    """tau = b2 (dq/dt)^2 against the motion, as caused by churned oil or air.

    Drag at large Reynolds numbers; Batchelor, "An Introduction to Fluid Dynamics", 1967, sec. 5.11.
    """

    name = "quadratic_friction"
    quadratic_nms2_rad2: NotNegative = parameter("N m s^2/rad^2", 0.05, 20.0, le=1000.0)  # b2 [N m s^2/rad^2]

    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        return self.quadratic_nms2_rad2 * speed_rad_s * speed_rad_s

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        unit = scale.joint_noise_nm / (1.2 * scale.joint(channel).speed_rad_s ** 2)
        return {"quadratic_nms2_rad2": strength * unit}


class HiddenCoulombFriction(_FrictionImperfection):
    """tau = f against the motion; a joint at rest moves only if the torque on it exceeds f.

    Coulomb 1785; Armstrong-Helouvry et al., Automatica 30 (1994), sec. 2.
    """

    name = "coulomb_friction"
    coulomb_nm: NotNegative = parameter("N m", 0.02, 2.0, le=100.0)  # f [N m]

    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        return self.coulomb_nm

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; not too large for a controller that does not model it."""
        return {"coulomb_nm": min(strength * scale.joint_noise_nm, scale.joint(channel).controllable_nm)}


class HiddenAsymmetricFriction(_FrictionImperfection):
    """tau = f+ against positive and f- against negative motion, as caused by a seal, a cable or a worm gear.

    It equals Coulomb friction of (f+ + f-)/2 plus a constant torque of -(f+ - f-)/2, also at rest.
    Armstrong-Helouvry, "Control of Machines with Friction", 1991, sec. 2.
    """

    name = "asymmetric_friction"
    positive_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0)  # f+ [N m]
    negative_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0)  # f- [N m]

    def _effects(self, index: int, joint_count: int) -> hooks.HiddenEffects:
        constant_nm = -0.5 * (self.positive_nm - self.negative_nm)
        constant = hooks.AddedTorque(index, lambda _position, _drive: constant_nm)
        return super()._effects(index, joint_count) + hooks.HiddenEffects(joint=(constant,))

    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        return 0.5 * (self.positive_nm + self.negative_nm)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; not too large for a controller that does not model it."""
        large_nm = min(1.3 * strength * scale.joint_noise_nm, scale.joint(channel).controllable_nm)
        small_nm = generator.uniform(0.1, 0.5) * large_nm
        positive_nm, negative_nm = generator.permutation([large_nm, small_nm]).tolist()
        return {"positive_nm": positive_nm, "negative_nm": negative_nm}


class HiddenStribeckFriction(_FrictionImperfection):
    """tau = f + s exp(-(|dq/dt| / v_s)^2) against the motion; it falls as grease forms a film.

    Bo and Pavelescu, Wear 82 (1982), with the exponent 2; Armstrong-Helouvry et al., Automatica 30 (1994).
    """

    name = "stribeck_friction"
    # s, how much more at rest than sliding [N m].
    stiction_nm: NotNegative = parameter("N m", 0.02, 2.0, le=100.0)
    speed_rad_s: Positive = parameter("rad/s", 0.01, 0.5, ge=1e-4, le=10.0)  # v_s [rad/s]
    # f, friction at high speed [N m].
    coulomb_nm: NotNegative = parameter("N m", 0.0, 2.0, le=100.0, default=0.0)

    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        slowness = speed_rad_s / self.speed_rad_s
        return self.coulomb_nm + self.stiction_nm * exp(-slowness * slowness)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; not too large for a controller that does not model it."""
        joint = scale.joint(channel)
        return {
            "stiction_nm": min(strength * scale.joint_noise_nm / 0.4, joint.controllable_nm),
            "speed_rad_s": generator.uniform(0.2, 0.6) * joint.speed_rad_s,
        }


class HiddenLoadDependentFriction(_FrictionImperfection):
    """tau = mu |tau_load| against the motion, as caused by teeth that are pressed together.

    A gear's load-dependent loss; Hamon, Gautier and Garrec, IEEE/RSJ IROS 2010, "Dynamic identification of
    robots with a dry friction model depending on load and velocity". The load is the torque that the gear
    transmits to the link: the drive's torque minus the friction.
    """

    name = "load_dependent_friction"
    shows_in = LOADED  # a vertical tool does not load its joint
    load_share: Number = parameter("-", 0.005, 0.3, ge=0, le=0.9)  # mu [-]

    def _resistance_nm(self, speed_rad_s: float, transmitted_nm: float) -> float:
        """Compute the friction, which loads a drive that pushes and relieves a drive that brakes."""
        side = 1.0 if transmitted_nm >= 0.0 else -1.0
        return self.load_share * abs(transmitted_nm) / (1.0 + side * self.load_share)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        share = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        return {"load_share": min(share, 0.9)}


class _TorqueImperfection(JointImperfection, ABC):
    """A torque added to that of one drive."""

    def _effects(self, index: int, joint_count: int) -> hooks.HiddenEffects:
        return hooks.HiddenEffects(joint=(hooks.AddedTorque(index, self._torque_nm),))

    @abstractmethod
    def _torque_nm(self, position_rad: float, drive_nm: float) -> float:
        """Compute the torque on the link along the joint's axis [N m]; see `AddedTorque.torque_nm`."""


class HiddenJointSpring(_TorqueImperfection):
    """tau += -k (q - q0) on the link, as caused by a bent cable or hose or a balancing spring (Hooke)."""

    name = "joint_spring"
    stiffness_nm_rad: NotNegative = parameter("N m/rad", 0.05, 20.0, le=500.0)  # k [N m/rad]
    rest_rad: Number = parameter("rad", -3.1416, 3.1416, ge=-100.0, le=100.0, default=0.0)  # q0 [rad]

    def _torque_nm(self, position_rad: float, drive_nm: float) -> float:
        return -self.stiffness_nm_rad * (position_rad - self.rest_rad)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; at rest near the middle, and weaker than the controller."""
        joint = scale.joint(channel)
        stiffness_nm_rad = strength * scale.joint_noise_nm / (0.8 * joint.swing_rad)
        return {
            "stiffness_nm_rad": min(stiffness_nm_rad, 1000.0 * joint.inertia_kg_m2),
            "rest_rad": joint.middle_rad + joint.swing_rad * generator.uniform(-1.0, 1.0),
        }


class HiddenTorqueRipple(_TorqueImperfection):
    """tau += A sin(N q + phi) on the link, as caused by the motor's magnets (cogging) or the gear's teeth.

    Jahns and Soong, IEEE Trans. Industrial Electronics 43 (1996), "Pulsating torque minimization techniques".
    """

    name = "torque_ripple"
    amplitude_nm: NotNegative = parameter("N m", 0.02, 1.0, le=100.0)  # A [N m]
    cycles: Number = parameter("-", 6.0, 300.0, gt=0, le=1e4)  # N, in one turn of the joint [-]
    phase_rad: Number = parameter("rad", -3.1416, 3.1416, ge=-tau, le=tau, default=0.0)  # phi [rad]

    def _torque_nm(self, position_rad: float, drive_nm: float) -> float:
        return self.amplitude_nm * sin(self.cycles * position_rad + self.phase_rad)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; cycles within the swing, and small enough for the controller."""
        joint = scale.joint(channel)
        cycles = np.exp(generator.uniform(np.log(6.0), np.log(18.0))) / joint.swing_rad
        return {
            "amplitude_nm": min(1.4 * strength * scale.joint_noise_nm, joint.controllable_nm),
            "cycles": float(np.round(cycles)),
            "phase_rad": generator.uniform(-np.pi, np.pi),
        }


class HiddenTorqueGain(_TorqueImperfection):
    """tau_link = g tau_drive: the drive sets and measures current with a wrong torque constant.

    The measured torque follows the command, but the torque on the link does not.
    """

    name = "torque_gain"
    shows_in = LOADED  # a vertical tool does not load its joint
    # g, true over assumed motor constant; 1 is right [-].
    gain: Number = parameter("-", 0.8, 1.2, ge=0.2, le=3.0)

    def _torque_nm(self, position_rad: float, drive_nm: float) -> float:
        return (self.gain - 1.0) * drive_nm

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        excess = strength * scale.joint_noise_nm / scale.joint(channel).load_nm
        return {"gain": float(np.clip(1.0 + generator.choice([-1.0, 1.0]) * excess, 0.5, 2.0))}


class _TransmissionImperfection(JointImperfection, ABC):
    """The encoder is ahead of the link by u; the whole torque passes through.

    The drive has no separate inertia: the rotor's inertia is part of the link's, as in the URDF.
    """

    @property
    def channels(self) -> tuple[str, ...]:
        """See `Imperfection.channels`; the tip is not where the encoders say."""
        return (channel_of(self.joint), CONTACT)

    def _effects(self, index: int, joint_count: int) -> hooks.HiddenEffects:
        offset = _LinkOffset(index, self._next_offset_rad)
        return hooks.HiddenEffects(joint=(offset,), encoder=(offset,))

    @abstractmethod
    def _next_offset_rad(self, offset_rad: float, step_s: float, torque_nm: float) -> float:
        """Compute by how much the encoder leads the link after a step [rad].

        Args:
            offset_rad: lead before the step [rad].
            step_s: duration of the step [s].
            torque_nm: torque from the drive to the link, along the joint axis [N m].
        """


class _LinkOffset(hooks.JointEffect, hooks.SensorHook):
    def __init__(self, index: int, next_offset_rad: Callable[[float, float, float], float]) -> None:
        self._index = index
        self._next_offset_rad = next_offset_rad
        self.restart()

    def restart(self) -> None:
        self._offset_rad = 0.0

    def joint_torque_nm(self, state: hooks.JointStepState, torque_nm: Sequence[float]) -> Sequence[float]:
        """Move the encoder ahead of the link for this step; the torque passes through unchanged."""
        self._offset_rad = self._next_offset_rad(self._offset_rad, state.step_s, torque_nm[self._index])
        return torque_nm

    def measure(self, time_s: float, value: Sequence[float]) -> Sequence[float]:
        """Add to one position how far its encoder is ahead of the link."""
        changed = list(value)
        changed[self._index] += self._offset_rad
        return changed


class HiddenBacklash(_TransmissionImperfection):
    """The encoder, on the drive's side, leads the link by u, at most gap/2, towards the side that pushes.

    The drive crosses the gap when the torque changes sign, du/dt = tau / d, slowed by the grease: the
    physical model of Nordin and Gutman, Automatica 38 (2002), with a shaft that only damps.
    """

    name = "backlash"
    shows_in = ()  # in probing, weight keeps the play on one side
    gap_rad: NotNegative = parameter("rad", 2e-4, 0.01, le=0.2)  # from one flank to the other [rad]
    # d, of the grease in the gap [N m s/rad].
    film_nms_rad: Positive = parameter("N m s/rad", 1.0, 100.0, ge=0.1, le=1e4, default=10.0)

    def _next_offset_rad(self, offset_rad: float, step_s: float, torque_nm: float) -> float:
        reach_rad = 0.5 * self.gap_rad
        return max(-reach_rad, min(reach_rad, offset_rad + step_s * torque_nm / self.film_nms_rad))

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; here for the torque by which a controller reacts to the gap."""
        stiffness_nm_rad = 3600.0 * scale.joint(channel).inertia_kg_m2
        return {"gap_rad": min(strength * scale.joint_noise_nm / stiffness_nm_rad, 0.02)}


class HiddenJointElasticity(_TransmissionImperfection):
    """The encoder, on the drive's side, is ahead of the link by the twist u of a spring that carries tau.

    T du/dt = C tau - u: spring and dashpot in parallel. It is the slow part of Spong's model (J. Dyn. Sys.
    Meas. Control 109, 1987).
    """

    name = "joint_elasticity"
    shows_in = ()  # in probing, most of the twist comes from the constant weight
    # C, one over the stiffness; zero is rigid [rad/(N m)].
    compliance_rad_nm: NotNegative = parameter("rad/(N m)", 5e-5, 2e-3, le=0.05)
    # T, damping over stiffness [s].
    retardation_s: NotNegative = parameter("s", 0.005, 0.1, le=10.0, default=0.02)

    def _next_offset_rad(self, offset_rad: float, step_s: float, torque_nm: float) -> float:
        decay = exp(-step_s / self.retardation_s) if self.retardation_s else 0.0
        settled_rad = self.compliance_rad_nm * torque_nm
        return settled_rad + decay * (offset_rad - settled_rad)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; at most as soft as a controller with this encoder handles."""
        compliance_rad_nm = strength * scale.joint_noise_nm / (25.0 * scale.joint(channel).load_nm)
        return {"compliance_rad_nm": min(compliance_rad_nm, 2e-3)}


_REFRESH_S = 4e-3  # the arm's inertia changes by 1 % in it


class HiddenArmature(JointImperfection):
    """The rotor takes tau = J d^2q/dt^2 of the drive's torque; the link gets the rest.

    J is the rotor's own inertia times the square of the gear ratio. With a high ratio the rotor turns much
    faster than the links, so only its own joint's acceleration matters: J is on the diagonal of the
    joint-space inertia, as in Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 9.
    """

    name = "armature"
    shows_in = LOADED  # the last joint's controller becomes unstable before it shows
    inertia_kg_m2: NotNegative = parameter("kg m^2", 0.001, 0.5, le=10.0)  # J [kg m^2]

    def _effects(self, index: int, joint_count: int) -> hooks.HiddenEffects:
        inertia_kg_m2 = np.zeros(joint_count)
        inertia_kg_m2[index] = self.inertia_kg_m2
        rotors = (Rotors(inertia_kg_m2.tolist()),) if self.inertia_kg_m2 else ()
        return hooks.HiddenEffects(joint=rotors)

    @classmethod
    def _size_fields(cls, strength: float, channel: str, scale: NoiseScale, generator: Generator) -> Values:
        """See `Imperfection._size_fields`; at most what a controller of the arm alone can stabilize."""
        joint = scale.joint(channel)
        inertia_kg_m2 = strength * scale.joint_noise_nm / joint.acceleration_rad_s2
        return {"inertia_kg_m2": min(inertia_kg_m2, 6.0 * joint.inertia_kg_m2)}


class Rotors(hooks.JointEffect):
    """Solves (M + J) a = tau + r for the step, J diagonal, where the engine solves M a = tau - J a + r.

    The torque r of weight, contact and friction follows from the equation at the last step's motion;
    the acceleration without the rotors is a0 = a_last + M^-1 (tau - tau_last), and with them it is
    a = (1 + M^-1 J)^-1 a0. Using J a_last instead would diverge as soon as a rotor's inertia exceeds
    the arm's inertia at its joint. The inertia is that of all joints, shape (n,) [kg m^2].
    """

    def __init__(self, inertia_kg_m2: Sequence[float]) -> None:
        self._inertia_kg_m2 = np.array(inertia_kg_m2)
        self.restart()

    def restart(self) -> None:
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._refresh_s = -inf

    def joint_torque_nm(self, state: hooks.JointStepState, torque_nm: Sequence[float]) -> Sequence[float]:
        """Subtract J a, the torques that accelerate the rotors, with a as in the class."""
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
