"""Gravity and load: rigid bodies, payload, and the arm's mounting."""

from typing import ClassVar

import numpy as np

from palpate.estimation.arm.inertial_parameters import BaseParameters, inertial_name, inertial_unit
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect, Errors, Inner, Parameter, Parameters, start_grid
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray


class KnownRigidBody(AdditiveEffect):
    """torque = ID(q, v, a) of the unchanged URDF (signal `rigid_body_torque`), plus J^T F at the tip."""

    name = "rigid_body"
    kind = Kind.GRAVITY_LOAD
    physics = "Inertia, Coriolis forces and weight of the links load the joint."
    equation = "tau = [M(q) a + C(q, v) v + g(q)]_j, j the joint"
    source = "R. Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 5: RNEA"
    signature = "torque follows posture and acceleration of all joints"
    signals = ("position", "velocity", "acceleration", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    needs = ("rigid_body_torque",)
    confused_with = {
        "payload": "weigh the tool: a payload acts on all joints",
        "torque_gain": "hold a known weight: a wrong gain also changes the torque of this weight",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.zeros((len(data), 0))

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context["rigid_body_torque"] + data.context.get("contact_torque", 0.0)


class RigidBodyFitted(AdditiveEffect):
    """torque = Y(q, v, a) pi (signal `rigid_body_regressor`), plus J^T F while the tip presses.

    The gains are base parameters of the whole arm. Gains with the same name in several joints are the same
    parameter.

    Args:
        chosen: columns of the regressor (`palpate.control.arm.rigid_body.RigidBody.regressor`, ten per link)
            for the base parameters that affect the joint (`palpate.estimation.arm.inertial_parameters`).
        arm: all base parameters of the arm; None if each joint is fitted separately.
        urdf: inertial parameters of the arm's URDF, shape (10 links,).
    """

    name = "rigid_body_fitted"
    kind = Kind.GRAVITY_LOAD
    physics = "Inertia, Coriolis forces and weight of the links load the joint; their parameters are fitted."
    equation = "tau = [Y(q, v, a) pi]_j, j the joint, pi the base parameters of the arm"
    source = (
        "C. G. Atkeson, C. H. An, J. M. Hollerbach, IJRR 5(3) (1986); M. Gautier, J. Robotic "
        "Systems 8 (1991): numerical calculation of the base inertial parameters"
    )
    signature = "torque follows posture and acceleration of all joints"
    signals = ("position", "velocity", "acceleration", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    needs = ("rigid_body_regressor",)
    confused_with = {
        "payload": "one recording cannot separate them, because a payload adds to the last link's parameters"
    }

    def __init__(
        self, chosen: tuple[int, ...] = (), arm: BaseParameters | None = None, urdf: FloatArray | None = None
    ) -> None:
        self.arm, self.urdf = arm, urdf
        self.gains = tuple(  # type: ignore[misc]  # how many there are depends on the arm
            Parameter(inertial_name(i), inertial_unit(i), -1e3, 1e3, (-5.0, 5.0)) for i in chosen
        )

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context["rigid_body_regressor"][:, : len(self.gains)]

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context.get("contact_torque", np.zeros(len(data)))


_STARTS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # start values of the tilt, with both signs [rad]
_OF_TILT = ("tilt_effort_per_rad", "weight_effort")
_OF_TURN = "weight_effort_turned"
_MAX_TILT = 0.35  # largest tilt of a base; a joint with a larger one has another center of mass [rad]
_OF_ARM = "payload_effort_per_kg"  # signal that all joints have if the arm's kinematics are known


class GravityTilt(AdditiveEffect):
    """effort = tilt * cos(q) in addition to a pendulum; its sin(q) absorbs the change of the weight.

    An arm of known weight g cannot absorb this change. If its base is turned by t about the axis of the first
    joint, effort = sin(t) dg/dt + (cos(t) - 1) g. Otherwise, the base has a pitch p about y
    after a roll r about x: effort = sin(p) g_p + cos(p) sin(r) g_r + (cos(p) cos(r) - 1) g, where g_p and g_r
    are the weight's efforts after a quarter turn.
    """

    name = "gravity_tilt"
    kind = Kind.GRAVITY_LOAD
    physics = "Gravity acts in a different direction than the model assumes."
    equation = "effort = sin(t) dg(q)/dtilt + (cos(t) - 1) g(q); for a pendulum t cos(q)"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 9"
    signature = "an error that depends only on posture, a quarter turn out of phase with gravity"
    signals = ("position", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE})
    gains: ClassVar[tuple[Parameter, ...]] = (Parameter("tilt", "{effort}", -1e12, 1e12, (0.001, 5.0)),)
    confused_with = {
        "bias": "move over a wide range: a bias is the same in every posture",
        "encoder_zero": "calibrate the zeros (palpate calibrate encoder): a tilt of the base remains",
        "joint_spring": "fit all joints together (a tilt affects all of them), or move over a wide range",
        "payload": "change the posture: the torques of weight and tilt are a quarter turn out of phase",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.cos(data.position)[:, None]

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: the joint of an arm is not a pendulum and needs the tilt signals."""
        known = _OF_ARM not in data.context or _OF_TURN in data.context or _is_known(data)
        return super().applies_to(data) and known

    def suited_to(self, data: ChannelData) -> "GravityTilt":
        if _OF_TURN in data.context:
            return _TiltOfTurningArm()
        return _TiltOfKnownArm() if _is_known(data) else self


class _TiltOfKnownArm(GravityTilt):
    needs: ClassVar[tuple[str, ...]] = _OF_TILT
    gains = ()
    inner: ClassVar[tuple[Parameter, ...]] = (Parameter("tilt", "rad", -np.pi, np.pi, (-0.3, 0.3)),)

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.zeros((len(data), 0))

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        across, along = (data.context[name] for name in _OF_TILT)
        turned: FloatArray = np.sin(inner["tilt"]) * across + (np.cos(inner["tilt"]) - 1.0) * along
        return turned

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({"tilt": side * start} for side in (-1.0, 1.0) for start in _STARTS)


class _TiltOfTurningArm(_TiltOfKnownArm):
    equation = "effort = sin(p) g_p(q) + cos(p) sin(r) g_r(q) + (cos(p) cos(r) - 1) g(q), p pitch, r roll"
    needs = (_OF_TURN,)
    # Within a quarter turn, since a vertical joint has the same torque in a base that is upside down.
    inner = tuple(Parameter(name, "rad", -np.pi / 2, np.pi / 2, (-0.3, 0.3)) for name in ("pitch", "roll"))

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        across, upright = np.sin([inner["pitch"], inner["roll"]]), np.cos([inner["pitch"], inner["roll"]])
        turn = np.array([across[0], upright[0] * across[1], upright.prod() - 1.0])
        turned: FloatArray = data.context[_OF_TURN] @ turn
        return turned

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: around the small angles that fit what the rigid bodies do not explain."""
        missing = data.effort - KnownRigidBody().known(data, {})
        angles = np.linalg.lstsq(data.context[_OF_TURN][:, :2], missing, rcond=1e-3)[0].clip(-1.0, 1.0)
        pitch, roll = angles[:, None] + 0.5 * np.abs(angles).max() * np.array([-1.0, 0.0, 1.0])
        return start_grid(pitch=pitch, roll=roll)

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: a joint alone may take another center of mass for a large tilt."""
        return max(abs(parameters[f"{self.name}.{angle.name}"]) for angle in self.inner) > _MAX_TILT


def _is_known(data: ChannelData) -> bool:
    """Return whether the signals of a tilt about the first axis exist; that axis is level."""
    return set(_OF_TILT) <= set(data.context)


_ZERO_SHARE = 1e-6  # share of the largest change per radian below which a joint's zero changes nothing


class EncoderZero(AdditiveEffect):
    """effort = f(q - b) - f(q) to second order in b, with the torque f of rigid bodies and contact force.

    Args:
        joints: joints of the arm, from 0, whose positions affect the effort.
    """

    name = "encoder_zero"
    kind = Kind.GRAVITY_LOAD
    physics = "Each encoder of the arm reads the angle of its joint plus a constant."
    equation = (
        "effort = -df/dq b + b^T d2f/dq2 b / 2, f torque of rigid bodies and contact force, q positions"
    )
    source = "B. W. Mooring, Z. S. Roth, M. R. Driels, Fundamentals of Manipulator Calibration (1991)"
    signature = "the errors of all joints match the weight of an arm in a slightly different posture"
    signals = ("position", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    needs = ("effort_by_positions", "effort_twice_by_positions")
    confused_with = {
        "gravity_tilt": "calibrate the zeros (palpate calibrate encoder): a tilt of the base remains",
        "payload": "calibrate the zeros (palpate calibrate encoder): a payload remains",
        "torque_gain": "calibrate the zeros (palpate calibrate encoder): a wrong gain remains",
    }

    def __init__(self, joints: tuple[int, ...] = (0,)) -> None:
        self.joints = joints
        self.inner = tuple(  # type: ignore[misc]  # how many there are depends on the arm
            Parameter(f"joint_{joint + 1}", "rad", -0.5, 0.5, (-0.2, 0.2)) for joint in joints
        )

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: the position of at least one joint changes the effort."""
        return super().applies_to(data) and bool(np.any(data.context["effort_by_positions"]))

    def suited_to(self, data: ChannelData) -> "EncoderZero":
        if not self.applies_to(data):
            return self
        size = np.abs(data.context["effort_by_positions"]).max(axis=0)
        return EncoderZero(tuple(np.flatnonzero(size > _ZERO_SHARE * size.max()).tolist()))

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.zeros((len(data), 0))

    def known(self, data: ChannelData, inner: Inner) -> FloatArray:
        once, twice = (data.context[name].reshape(len(data), -1) for name in self.needs)
        offset = np.zeros(once.shape[1])
        offset[list(self.joints)] = [inner[angle.name] for angle in self.inner]
        j, k = np.triu_indices(len(offset))
        products = np.where(j == k, 0.5, 1.0) * offset[j] * offset[k]
        effort: FloatArray = twice @ products - once @ offset
        return effort

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: small angles that fit what the rigid bodies do not explain."""
        missing = data.effort - KnownRigidBody().known(data, {})
        slopes = -data.context["effort_by_positions"].reshape(len(data), -1)[:, list(self.joints)]
        angles = np.linalg.lstsq(slopes, missing, rcond=1e-3)[0].clip(-0.4, 0.4)
        alone = (slopes.T @ missing / np.sum(slopes**2, axis=0)).clip(-0.4, 0.4)
        sets = [angles, *np.diag(alone)]
        return tuple(
            {angle.name: float(value) for angle, value in zip(self.inner, values, strict=True)}
            for values in sets
        )


class Payload(AdditiveEffect):
    name = "payload"
    kind = Kind.GRAVITY_LOAD
    physics = "The arm carries a load, whose weight and inertia act on every joint."
    equation = "effort_i = m J_i^T (a_tip - g)"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 12"
    signature = "the errors of all joints match one mass at the tip, largest with the arm stretched out"
    signals = ("position", "acceleration", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE})
    gains = (Parameter("mass", "kg", -50.0, 50.0, (0.01, 5.0)),)
    needs = ("payload_effort_per_kg",)
    confused_with = {
        "torque_gain": "change the posture: the torque of a payload depends on the posture",
        "gravity_tilt": "change the posture",
        "bias": "fit all joints together (a payload affects all of them), or change the posture",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context["payload_effort_per_kg"][:, None]

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: a negative mass means links lighter than their URDF, not a load."""
        return parameters[f"{self.name}.mass"] < 0.0


class Pendulum(AdditiveEffect):
    name = "pendulum"
    kind = Kind.GRAVITY_LOAD
    physics = "A body turns about a horizontal axis."
    equation = "torque = J a + g1 sin(q), q = 0 hanging straight down"
    source = "C. Huygens, Horologium Oscillatorium (1673)"
    signature = "torque follows the sine of the angle, whatever the speed"
    signals = ("position", "acceleration")
    channels = frozenset({ChannelKind.REVOLUTE})
    gains = (
        Parameter("inertia", "{inertia}", 0.0, 10000.0, (0.0001, 5.0)),
        Parameter("gravity", "{effort}", -1e12, 1e12, (0.05, 50.0)),
    )
    confused_with = {
        "gravity_tilt": "turn the base by a known angle",
        "joint_spring": "swing by more than 60 degrees: a sine flattens, but a spring stays linear",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([data.acceleration, np.sin(data.position)])


class Weight(AdditiveEffect):
    name = "weight"
    kind = Kind.GRAVITY_LOAD
    physics = "The joint's axis is not vertical, and the center of mass of its load is off the axis."
    equation = "torque = g1 sin(q) + g2 cos(q), with an arbitrary zero of the angle q"
    source = "C. Huygens, Horologium Oscillatorium (1673)"
    signature = "effort follows the sine of the angle, at any speed, and repeats once per turn"
    signals = ("position",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.SERVO})
    gains = (
        Parameter("g1", "{effort}", -1e12, 1e12, (-50.0, 50.0)),
        Parameter("g2", "{effort}", -1e12, 1e12, (-50.0, 50.0)),
    )
    confused_with = {
        "joint_spring": "swing by more than 60 degrees: a sine flattens, but a spring stays linear",
        "cubic_stiffness": "swing by more than 90 degrees: a sine falls again, but a cubic does not",
        "bias": "move over a wide range: a bias is the same everywhere",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.column_stack([np.sin(data.position), np.cos(data.position)])

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: not to the joint of an arm, whose kinematics give the weight."""
        return super().applies_to(data) and _OF_ARM not in data.context
