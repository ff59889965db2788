"""A spring that yields: hysteresis of force over displacement."""

from itertools import product

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.kinds import Kind
from estimation.signals.blocks import number_stretches
from estimation.signals.bouc_wen import bouc_wen
from estimation.signals.runwise import smooth_jitter
from robot_io.types import FloatArray


class BoucWenHysteresis(AdditiveEffect):
    """effort = f w, with w in [-1, 1] the normalised state of Bouc and Wen; see `bouc_wen`.

    In a contact only while pressed, and each touch begins unstrained. With sharpness 1 and unloading 1 it is
    Dahl's law, with a high sharpness an elastic and perfectly plastic spring.
    """

    name = "bouc_wen_hysteresis"
    kind = Kind.FRICTION
    physics = "Inner friction of rubber, wire rope or structure makes a spring that yields."
    equation = (
        "effort = f w, dw/dx = (1 - |w|^n)/path while it grows, (1 + unloading |w|^n)/path on its return"
    )
    source = (
        "Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976); normalised as in F. Ikhouane, J. Rodellar, Systems "
        "with Hysteresis (2007), ch. 2"
    )
    signature = "loops of effort over position of the same height at any speed, small ones inside large ones"
    signals = ("direction", "past motion")
    channels = frozenset(ChannelKind)
    gains = (Parameter("force", "{effort}", 0.0, 1e12, (0.001, 50.0)),)
    inner = (
        Parameter("path", "{position}", 1e-9, 10.0, (1e-4, 0.1), log=True),
        Parameter("sharpness", "1", 0.5, 20.0, (1.0, 5.0), log=True),
        Parameter("unloading", "1", 0.0, 1.0, (0.0, 1.0)),
    )
    path = "path"
    confused_with = {
        "presliding_friction": "reverse half way: the curves of Dahl's friction are exponentials",
        "dry_friction": "reverse half way: the curves of Dahl's friction are exponentials",
        "hysteresis": "reverse slowly at several loads: a hysteresis of the sensor is one of effort",
        "stress_relaxation": "hold: relaxation goes on at rest, hysteresis does not",
        "damping": "probe at two speeds: hysteresis does not depend on speed",
    }

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        way = smooth_jitter(data.position, data.time_s, data.run)
        touch, pressed = number_stretches(data.engaged, data.run), np.flatnonzero(data.engaged)
        column = np.zeros((len(data), 1))
        shape = inner["path"], inner["sharpness"], inner["unloading"]
        column[pressed, 0] = bouc_wen(way[pressed], touch[pressed], *shape)
        return column

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: from a hundredth to half of the range of motion."""
        span = float(np.ptp(data.position)) or 1.0
        values = product(np.geomspace(0.01, 0.5, 5) * span, (1.0, 3.0), (0.0, 1.0))
        return tuple({"path": float(path), "sharpness": n, "unloading": back} for path, n, back in values)
