"""Inertia of a joint, its rotor and a coupled neighbor."""

import numpy as np

from palpate.estimation.channel import JOINTS, ChannelData
from palpate.estimation.effect import AdditiveEffect, Errors, Inner, Parameter, Parameters, start_grid
from palpate.estimation.effects.friction import TRANSITION
from palpate.estimation.kinds import Kind
from palpate.robot_io.types import FloatArray


class Inertia(AdditiveEffect):
    name = "inertia"
    kind = Kind.INERTIA
    physics = "Mass resists acceleration."
    equation = "effort = m a"
    source = "I. Newton, Principia (1687)"
    signature = "effort follows acceleration at any position and speed"
    signals = ("acceleration",)
    one_sided = False
    gains = (Parameter("m", "{inertia}", 0.0, 1e12, (0.0001, 200.0)),)
    confused_with = {
        "armature": "one channel cannot separate them, because it shows only the sum of both",
        "lag": "move at two frequencies: inertia grows with the square of the frequency, a lag linearly",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.acceleration[:, None]


class Armature(AdditiveEffect):
    name = "armature"
    kind = Kind.INERTIA
    physics = "The motor's rotor accelerates too; its inertia is multiplied by the square of the gear ratio."
    equation = "effort = Ja a"
    source = "R. Featherstone, Rigid Body Dynamics Algorithms (2008), sec. 9.6"
    signature = "effort follows the joint's own acceleration, in any posture"
    signals = ("acceleration",)
    channels = JOINTS
    gains = (Parameter("inertia", "{inertia}", 0.0, 1e12, (0.001, 5.0)),)
    confused_with = {
        "lag": "move at two frequencies",
        "payload": "hold still in several postures: rotor inertia has no effect at rest",
        "inertia": "one channel cannot separate them, because it shows only the sum of both",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.acceleration[:, None]


_FELT = 0.2  # least rms speed that the neighbor adds, relative to the joint's own


class JointCoupling(AdditiveEffect):
    """Coupling of joint i to its neighbor j.

    In a wrist with a coupled gear train, the motor of joint i turns by the sum of two joint angles. Its rotor
    inertia and its friction follow that sum. Without motion of joint j, the effect is the same as `armature`,
    `viscous_friction` and `coulomb_friction`.

    Args:
        neighbor: index of joint j, from 0; `suited_to` determines it.
    """

    name = "joint_coupling"
    kind = Kind.INERTIA
    physics = "The motor of this joint also turns when the neighboring joint moves, as in many wrists."
    equation = "effort = J (a_i + r a_j) + d (v_i + r v_j) + f tanh((v_i + r v_j)/transition), j beside i"
    source = "M. Gautier, A. Janot, P. O. Vandanjon, IEEE Trans. Control Systems Tech. 21 (2013): TX40 arm"
    signature = "effort appears while this joint rests and the neighboring joint moves, in any posture"
    signals = ("other joints", "velocity", "direction", "acceleration")
    channels = JOINTS
    gains = (
        Parameter("inertia", "{inertia}", 0.0, 1e12, (0.001, 5.0)),
        Parameter("viscous", "{effort} s/{position}", 0.0, 1e12, (0.001, 50.0)),
        Parameter("coulomb", "{effort}", 0.0, 1e12, (0.001, 50.0)),
    )
    inner = (Parameter("ratio", "1", -5.0, 5.0, (-1.0, 1.0)), TRANSITION)
    needs = ("joint_velocity", "joint_acceleration")
    confused_with = {
        "coulomb_friction": "hold this joint still and move its neighbor",
        "viscous_friction": "hold this joint still and move its neighbor",
        "rigid_body_fitted": (
            "move slowly: friction of the coupling remains, but inertia of the links does not"
        ),
    }

    def __init__(self, neighbor: int = 0) -> None:
        self._neighbor = neighbor

    def suited_to(self, data: ChannelData) -> "JointCoupling":
        velocity = data.context["joint_velocity"]
        joint = int(np.argmin(np.sum((velocity - data.velocity[:, None]) ** 2, axis=0)))
        neighbors = [j for j in (joint + 1, joint - 1) if 0 <= j < velocity.shape[1]]
        if not neighbors:
            return self
        return JointCoupling(min(neighbors, key=lambda j: _residual_sse(data, joint, j)))

    def applies_to(self, data: ChannelData) -> bool:
        if not super().applies_to(data):
            return False
        velocity = data.context["joint_velocity"]
        return velocity.ndim == 2 and velocity.shape[1] > 1

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        v = data.velocity + inner["ratio"] * data.context["joint_velocity"][:, self._neighbor]
        a = data.acceleration + inner["ratio"] * data.context["joint_acceleration"][:, self._neighbor]
        return np.column_stack([a, v, np.tanh(v / inner["transition"])])

    def is_misnamed(self, data: ChannelData, parameters: Parameters, errors: Errors, noise: float) -> bool:
        """See `Effect.is_misnamed`: if the neighbor hardly turns this motor, the effect is plain friction."""
        turned = parameters[f"{self.name}.ratio"] * data.context["joint_velocity"][:, self._neighbor]
        return float(np.mean(turned**2)) < _FELT**2 * float(np.mean(data.velocity**2))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        transition = np.minimum(np.array((0.01, 0.05)) * data.rms_speed, 1.0)
        return start_grid(ratio=(1.0, -1.0, 0.4, -0.4), transition=transition)


def _residual_sse(data: ChannelData, own: int, neighbor: int) -> float:
    """Return the squared error of the effort after a fit to the motion of two joints."""
    v, a = (data.context[f"joint_{what}"][:, [own, neighbor]] for what in ("velocity", "acceleration"))
    columns = np.column_stack([v, a, np.sign(v), np.sign(v[:, 0] + v[:, 1]), np.ones(len(data))])
    gains = np.linalg.lstsq(columns, data.effort, rcond=None)[0]
    return float(np.sum((data.effort - columns @ gains) ** 2))
