"""A zero that differs from run to run."""

import numpy as np

from estimation.channel import ChannelData
from estimation.effect import Inner
from estimation.effects.run_variation import RunVariation
from estimation.kinds import Kind
from robot_io.types import FloatArray


class RunOffset(RunVariation):
    """reading = effort + b_r in run r, b_r Gaussian about zero; the run's first part tells it."""

    name = "run_offset"
    kind = Kind.RUN_DIFFERENCES
    physics = "The sensor was tared, mounted or charged anew before each run, each time a little differently."
    equation = "reading = effort + b_r, b_r ~ N(0, spread^2)"
    source = "C. R. Henderson, Biometrics 31 (1975): best linear unbiased prediction in mixed models"
    signature = "each run is off by one amount all along, another run by another"
    signals = ("offset", "recorded")
    confused_with = {
        "bias": "record more runs: a bias is the same in all",
        "drift": "record longer runs: a drift goes on within each",
        "contact_offset": "record free air: an offset of the sensor is there too",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        return np.ones((len(data), 1))
