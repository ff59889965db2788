"""Friction that grows with the load on the gear."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from robot_io.types import FloatArray


class LoadDependentFriction(AdditiveEffect):
    """effort = mu |load| tanh(v / transition), load the effort that the joint carries apart from friction."""

    name = "load_dependent_friction"
    physics = "Gear teeth and bearings rub in proportion to the load they carry."
    equation = "effort = mu |load| tanh(v/transition)"
    source = "A. C. Bittencourt, S. Gunnarsson, J. Dyn. Sys. Meas. Control 134 (2012)"
    signature = "the jump at reversal is larger where the joint carries more"
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    gains = (Parameter("mu", "1", 0.0, 2.0, (0.01, 0.5)),)
    inner = (Parameter("transition", "{position}/s", 1e-09, 1.0, (0.0001, 0.05), log=True),)
    needs = ("load",)
    confused_with: ClassVar[dict[str, str]] = {
        "coulomb_friction": "repeat with another load",
        "torque_gain": "lift and lower the same load: friction changes sign with the motion, a gain does not",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 1)."""
        sliding = np.tanh(data.velocity / inner["transition"])
        return (sliding * np.abs(data.context["load"]))[:, None]

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: smoothing at a small share of the usual speed."""
        speed = float(np.sqrt(np.mean(data.velocity**2))) or 1.0
        return tuple({"transition": float(part * speed)} for part in (0.003, 0.01, 0.03, 0.08))
