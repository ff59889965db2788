"""Torque that ripples with the angle."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from robot_io.types import FloatArray

_LEAST_WAVES = 1.5  # within the range of motion; less of a wave could be any curve


class TorqueRipple(AdditiveEffect):
    """effort = s sin(n q) + c cos(n q)."""

    name = "torque_ripple"
    physics = "Magnets, teeth and gear errors make effort rise and fall n times a turn."
    equation = "effort = s sin(n q) + c cos(n q)"
    source = "J. Holtz, L. Springob, IEEE Trans. Industrial Electronics 43 (1996)"
    signature = "a wave over position, the same at any speed and in either direction"
    signals = ("position",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (
        Parameter("sine", "{effort}", -10000.0, 10000.0, (0.001, 5.0)),
        Parameter("cosine", "{effort}", -10000.0, 10000.0, (0.001, 5.0)),
    )
    inner = (Parameter("cycles", "1/{position}", 0.5, 100000.0, (2.0, 100.0)),)
    confused_with: ClassVar[dict[str, str]] = {
        "joint_spring": "move over a wide range: a spring does not repeat",
        "gravity_tilt": "move over a wide range: gravity repeats once a turn",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 2)."""
        if inner["cycles"] * np.ptp(data.position) < _LEAST_WAVES * 2.0 * np.pi:
            return np.zeros((len(data), 2))
        angle = inner["cycles"] * data.position
        wave = np.empty((len(data), 2))
        np.sin(angle, out=wave[:, 0])
        np.cos(angle, out=wave[:, 1])
        return wave

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: so close together that no wave within the range is missed."""
        span = float(np.ptp(data.position)) or 1.0
        return tuple({"cycles": float(waves * 2.0 * np.pi / span)} for waves in np.arange(2.0, 40.0, 0.4))
