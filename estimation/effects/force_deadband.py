"""The tip pushes harder than the force sensor says."""

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class ForceDeadband(AdditiveEffect):
    """effort = w J^T p while the tip touches, p the press direction: what the force sensor swallows.

    To the contact, a dead band of its sensor is a surface that lies deeper; the joints carry the difference.
    """

    name = "force_deadband"
    kind = Kind.SENSOR_STATICS
    physics = "The force sensor swallows the first part of any force; the joints carry it all the same."
    equation = "effort = w J^T p while touching"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 2: threshold; J^T F by virtual work"
    signature = (
        "in contact, all joints carry what one more force at the tip would take, however hard it pushes"
    )
    signals = ("load",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (Parameter("width", "N", 0.0, 1e12, (0.01, 10.0)),)
    needs = ("contact_torque_per_newton", "touching")
    confused_with = {
        "torque_gain": "press at several forces: a dead band takes the same from all",
        "force_sensor_error": "press at several forces: a dead band takes the same from all",
        "payload": "compare free air with contact: a payload is there in both",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return (data.context["contact_torque_per_newton"] * data.context["touching"])[:, None]
