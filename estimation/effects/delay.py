"""The sensor reports late."""

from collections.abc import Mapping

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Errors, Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from estimation.signals.runwise import sample_time, shift
from robot_io.types import FloatArray


class Delay(SensorEffect):
    """reading(t) = effort(t - T), also by a part of a sample, such as between converters that take turns.

    T < 0, the motion later than the effort, by no more than a sample: beyond, it only bends the effort.
    """

    name = "delay"
    kind = Kind.SENSOR_DYNAMICS
    physics = "Conversion, bus and buffers hold every reading back by the same time."
    equation = "reading(t) = effort(t - T)"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 3: dead time"
    signature = "readings keep their shape and come late against the motion"
    signals = ("past effort",)
    channels = frozenset(ChannelKind)
    inner = (Parameter("time", "s", -0.5, 2.0, (0.001, 0.1)),)
    confused_with = {
        "lag": "make a sharp touch: a lag rounds it, a delay only shifts it",
        "damping": "hold and probe at two speeds",
        "viscous_friction": "move at two speeds with the same acceleration",
    }
    linear = True

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return shift(effort, data.time_s, data.run, inner["time"])

    def is_misnamed(
        self, data: ChannelData, parameters: Mapping[str, float], errors: Errors, noise: float
    ) -> bool:
        """See `Effect.is_misnamed`: the effort comes ahead of the motion by more than a sample."""
        return parameters[f"{self.name}.time"] < -sample_time(data.time_s, data.run)

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a quarter of a sample to 150 samples, and to one the other way."""
        step = sample_time(data.time_s, data.run)
        late = np.geomspace(0.25, 150.0, 13)
        return tuple({"time": float(step * n)} for n in (*-late[late < 1.0][::-1], 0.0, *late))
