"""A mass at the tip that the model does not know."""

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Payload(AdditiveEffect):
    """effort = m * (effort per kilogram at the tip), from the arm's kinematics."""

    name = "payload"
    kind = Kind.GRAVITY_LOAD
    physics = "The arm carries something: its weight and inertia load every joint."
    equation = "effort_i = m J_i^T (a_tip - g)"
    source = "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002), ch. 12"
    signature = "all joints are off by what one mass at the tip would take, most with the arm stretched out"
    signals = ("position", "acceleration", "other joints")
    channels = frozenset({ChannelKind.REVOLUTE})
    gains = (Parameter("mass", "kg", -50.0, 50.0, (0.01, 5.0)),)
    needs = ("payload_effort_per_kg",)
    confused_with = {
        "torque_gain": "change the posture: a payload loads the joints by posture",
        "gravity_tilt": "change the posture",
        "bias": "judge all joints together: a payload is in all of them; or change the posture",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return data.context["payload_effort_per_kg"][:, None]
