"""The sensor follows slowly."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from estimation.signals.exponential_memory import low_pass
from estimation.signals.runwise import sample_time
from robot_io.types import FloatArray


class Lag(SensorEffect):
    """reading' = (effort - reading) / tau."""

    name = "lag"
    kind = Kind.SENSOR_DYNAMICS
    physics = "A filter in the sensor smooths and delays."
    equation = "reading' = (effort - reading)/tau"
    source = "E. O. Doebelin, Measurement Systems (2003), ch. 3: first-order instrument"
    signature = "readings come late and rounded, the more the faster the effort changes"
    signals = ("past effort",)
    channels = frozenset(ChannelKind)
    inner = (Parameter("tau", "s", 1e-05, 1.0, (0.001, 0.2), log=True),)
    confused_with = {
        "delay": "make a sharp touch: a lag rounds it, a delay only shifts it",
        "damping": "hold and probe at two speeds",
        "inertia": "move at two frequencies",
    }
    linear = True

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        return low_pass(effort, data.time_s, data.run, inner["tau"])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a fraction of a sample to 400 samples."""
        step = sample_time(data.time_s, data.run)
        return tuple({"tau": float(step * n)} for n in np.geomspace(0.2, 400.0, 14))
