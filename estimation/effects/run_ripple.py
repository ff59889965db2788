"""Ripple whose zero differs from run to run."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner
from estimation.effects.run_variation import RunVariation
from estimation.effects.torque_ripple import TorqueRipple
from estimation.kinds import Kind
from robot_io.types import FloatArray


class RunRipple(RunVariation):
    """reading = effort + s_r sin(n q) + c_r cos(n q) in run r; the run's first part tells s_r and c_r."""

    name = "run_ripple"
    kind = Kind.RUN_DIFFERENCES
    physics = "Magnets and teeth make effort ripple, and the encoder counts from where it was switched on."
    equation = "reading = effort + s_r sin(n q) + c_r cos(n q), s_r and c_r of each run"
    source = "J. Holtz, L. Springob, IEEE Trans. Industrial Electronics 43 (1996)"
    signature = "a wave over position of the same length in all runs, that begins elsewhere in each"
    signals = ("position", "recorded")
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (*RunVariation.inner, *TorqueRipple.inner)
    confused_with = {
        "torque_ripple": "go to one stop before each run: from there on the wave begins in one place",
        "run_offset": "move over a wide range within a run",
    }

    def basis(self, data: ChannelData, inner: Inner) -> FloatArray:
        angle = inner["cycles"] * data.position
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        return tuple({**start, "share": 0.9} for start in TorqueRipple().starts(data))
