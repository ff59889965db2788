"""The sensor's zero is off."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from robot_io.types import FloatArray


class Bias(AdditiveEffect):
    """reading = effort + b."""

    name = "bias"
    kind = Kind.SENSOR_STATICS
    physics = "The sensor shows something when nothing acts."
    equation = "reading = effort + b"
    source = "JCGM 200:2012 (VIM), 4.20: instrumental bias"
    signature = "all readings are off by one amount, in free air too"
    signals = ("offset",)
    channels = frozenset(ChannelKind)
    one_sided = False
    gains = (Parameter("offset", "{effort}", -1e12, 1e12, (-1.0, 1.0)),)
    confused_with = {
        "run_offset": "record more runs: a bias is the same in all",
        "contact_offset": "record free air: a bias is there too",
        "gravity_tilt": "judge all joints together: a tilt is in all of them; or move over a wide range",
        "payload": "judge all joints together: a payload is in all of them; or change the posture",
        "drift": "wait: a bias stays",
        "asymmetric_friction": "let the joint rest: a bias stays",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.ones((len(data), 1))
