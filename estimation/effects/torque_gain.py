"""The torque scale is wrong."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from robot_io.types import FloatArray


class TorqueGain(SensorEffect):
    """reading = gain * effort."""

    name = "torque_gain"
    kind = Kind.SENSOR_STATICS
    physics = "The torque constant or the gear ratio in use is not the real one."
    equation = "reading = gain effort"
    source = (
        "M. Gautier, S. Briot, J. Dyn. Sys. Meas. Control 136 (2014): global identification of drive gains"
    )
    signature = "all of the effort is off by one factor; only a model with a known mass can show it"
    signals = ("effort",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (Parameter("gain", "1", 0.2, 5.0, (0.6, 1.6), log=True),)
    confused_with = {
        "run_gain": "record more runs: a wrong constant is the same in all",
        "payload": "change the posture",
        "load_dependent_friction": "lift and lower the same load",
        "bias": "lift two loads: a gain grows with the load",
    }
    linear = True
    pointwise = True

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: closer and closer to one, since few constants are far off."""
        off = np.array([0.003, 0.01, 0.03, 0.1, 0.25, 0.5])
        return tuple({"gain": float(gain)} for gain in np.exp([*-off[::-1], *off]))

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return inner["gain"] * effort
