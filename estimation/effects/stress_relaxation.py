"""Force that fades while the object is held."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from estimation.signals.exponential_memory import relax
from robot_io.types import FloatArray


class StressRelaxation(AdditiveEffect):
    """A Maxwell branch beside the spring: F = k1 z with z' = x' - z / tau, z = 0 before the first run.

    A press soon after another meets an object that has not recovered yet: see `faded`.
    """

    name = "stress_relaxation"
    kind = Kind.TIME_MEMORY
    physics = "Part of the elastic force flows away with time, as in flesh, rubber and foam."
    equation = "F = k1 z, z' = x' - z/tau, x only while pressed"
    source = (
        "C. Zener, Elasticity and Anelasticity of Metals (1948): standard linear solid; Y. C. Fung, "
        "Biomechanics (1993), ch. 7"
    )
    signature = "force falls during a hold at constant depth, and is lower on the way out than on the way in"
    signals = ("past motion",)
    channels = frozenset({ChannelKind.CONTACT})
    gains = (Parameter("k1", "{effort}/{position}", 0.0, 1e12, (10.0, 10000.0)),)
    inner = (Parameter("tau", "s", 0.005, 300.0, (0.03, 30.0), log=True),)
    confused_with = {
        "power_law_relaxation": "hold a hundred times as long: a power law goes on, a branch ends",
        "relaxation_spectrum": "hold for longer, at two depths: one branch ends, a second goes on falling",
        "damping": "hold: damping stops with the motion, relaxation goes on",
        "plastic_set": "wait and press again: relaxation recovers, a set stays",
        "hysteresis": "hold: a hysteresis of the sensor does not change with time",
        "drift": "free air: drift goes on there, relaxation does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        pressed = np.where(data.engaged, data.position, 0.0)
        return relax(pressed, data.time_s, data.run, inner["tau"])[:, None]
