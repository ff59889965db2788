"""The tool or the arm yields under the force."""

from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.data.derivatives import Motion, differentiate
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.kinds import Kind
from estimation.signals.blocks import number_stretches
from estimation.signals.cache_by_array import cache_by_channel_arrays


class ToolCompliance(MotionEffect):
    """x_true = x - c F: the tip goes less deep than the encoders say."""

    name = "tool_compliance"
    kind = Kind.ELASTIC_SHAPE
    also = frozenset({Kind.TIME_MEMORY})  # in series with a damper it relaxes
    physics = "Tool, sensor and links bend, so that the object sees less than the encoders report."
    equation = "x_true = x - c F, v_true = v - c dF/dt"
    source = "two springs in series; A. Albu-Schäffer et al., Int. J. Robotics Research 26 (2007)"
    signature = "the object seems softer the harder it is pressed, and less damped than it is"
    signals = ("position", "effort")
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("compliance", "{position}/{effort}", 0.0, 1e9, (1e-06, 0.001), log=True),)
    confused_with = {
        "cubic_stiffness": "press a rigid block: what yields is the tool",
        "damping": "press a rigid block: what yields is the tool",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        force = _smooth_force(data)
        return replace(
            data,
            position=data.position - inner["compliance"] * force.position,
            velocity=data.velocity - inner["compliance"] * force.velocity,
        )

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: yielding by from a thousandth of the depth to as much as that."""
        yielding = float(np.ptp(data.position) / (np.ptp(data.effort) or 1.0))
        return tuple({"compliance": float(part * yielding)} for part in np.geomspace(1e-3, 1.0, 7))


@cache_by_channel_arrays("time_s", "run", "effort", "position", "touching")
def _smooth_force(data: ChannelData) -> Motion:
    """The force and its rate, by a window that its own noise calls for."""
    return differentiate(
        data.time_s, data.effort, number_stretches(data.engaged, data.run), rounding=0.0, calm=False
    )
