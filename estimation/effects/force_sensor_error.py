"""The force at the tip is not what its sensor says."""

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class ForceSensorError(AdditiveEffect):
    """effort = share J^T p e, e the force beyond the reading that all other joints carry, see `arm_signals`.

    Whatever a force sensor does (it lags, it hangs behind, it is cut off), all joints carry the same
    difference to its reading. The contact's own diagnosis says what it is.
    """

    name = "force_sensor_error"
    kind = Kind.SENSOR_STATICS
    physics = "The force sensor is off; all joints carry the true force."
    equation = "effort = share J^T p e, e by the other joints"
    source = "J. J. Craig, Introduction to Robotics (2005), ch. 5.10: forces at the tip and torques of joints"
    signature = "in contact, all joints are off by what one and the same force at the tip takes"
    signals = ("load",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    # About one: noise of the other joints' torques lowers it.
    gains = (Parameter("share", "1", 0.5, 1.5, (0.9, 1.1)),)
    needs = ("contact_torque_per_newton", "force_beyond_reading")
    confused_with = {
        "force_deadband": "press at several forces: a dead band takes the same from all",
        "payload": "compare free air with contact: a payload is there in both",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return (data.context["contact_torque_per_newton"] * data.context["force_beyond_reading"])[:, None]
