"""The tool or the arm yields under the force."""

from dataclasses import replace
from typing import ClassVar

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.signals.runwise import low_pass, rate, sample_time


class ToolCompliance(MotionEffect):
    """x_true = x - c F: the tip goes less deep than the encoders say."""

    name = "tool_compliance"
    physics = "Tool, sensor and links bend, so that the object sees less than the encoders report."
    equation = "x_true = x - c F, v_true = v - c dF/dt"
    source = "two springs in series; A. Albu-Schäffer et al., Int. J. Robotics Research 26 (2007)"
    signature = "the object seems softer the harder it is pressed, and less damped than it is"
    signals = ("position", "effort")
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("compliance", "{position}/{effort}", 0.0, 0.01, (1e-06, 0.001), log=True),)
    confused_with: ClassVar[dict[str, str]] = {
        "cubic_stiffness": "press a rigid block: what yields is the tool",
        "damping": "press a rigid block: what yields is the tool",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        force = low_pass(data.effort, data.time_s, data.run, 2.0 * sample_time(data.time_s, data.run))
        return replace(
            data,
            position=data.position - inner["compliance"] * force,
            velocity=data.velocity - inner["compliance"] * rate(force, data.time_s, data.run),
        )
