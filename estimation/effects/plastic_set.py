"""The object keeps a dent."""

from dataclasses import replace
from itertools import product

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, MotionEffect, Parameter
from estimation.kinds import Kind
from estimation.signals.blocks import runs_by_time
from robot_io.types import FloatArray

_TOUCHING = 1e-300  # depth that strains nothing


class PlasticSet(MotionEffect):
    """The surface sinks by a share of the deepest indentation so far: x_true = x - share * max(x so far).

    Of the dent that a run leaves, a part is still there when the next one presses. A surface that sinks lets
    go of the tool; what crushes within, such as foam, stays at the tool, and damps it in the dent too.
    """

    name = "plastic_set"
    kind = Kind.CONTACT_GEOMETRY
    physics = "Part of the indentation stays: on the way out the object is met later than on the way in."
    equation = (
        "x_true = x - dent, v_true = x_true', dent = share max_t(x); of it, kept is left for the next run"
    )
    source = "permanent set in indentation; K. L. Johnson, Contact Mechanics (1985), ch. 6"
    signature = (
        "force reaches zero at a depth above zero on the way out, and the next press on the spot begins there"
    )
    signals = ("position", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    inner = (
        Parameter("share", "1", 1e-4, 0.9, (0.02, 0.5), log=True),
        Parameter("kept", "1", 0.0, 1.0, (0.0, 1.0)),
    )
    confused_with = {
        "stress_relaxation": "wait and press again: a set stays, relaxation recovers",
        "adhesion": "press twice on one spot: a set moves the second touch",
        "hysteresis": "press twice on one spot: the sensor has no memory of the depth",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        deepest = _deepest(data, inner["kept"])
        deeper = (data.position >= deepest) & (data.velocity > 0.0) & data.engaged
        return replace(
            data,
            position=data.position - inner["share"] * deepest,
            velocity=data.velocity * (1.0 - inner["share"] * deeper),
        )

    def forms(self) -> tuple["PlasticSet", ...]:
        """See `Effect.forms`: a surface that sinks, or one that stays at the tool."""
        return self, _AtTheTool()

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: dents that are gone by the next run, and dents that stay."""
        share, kept = self.inner
        values = product(share.spread(10), kept.spread(2))
        return tuple({"share": float(part), "kept": float(rest)} for part, rest in values)


class _AtTheTool(PlasticSet):
    form = 1

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        left = data.position - inner["share"] * _deepest(data, inner["kept"])
        return replace(data, position=np.where(data.engaged, np.maximum(left, _TOUCHING), left))


def _deepest(data: ChannelData, kept: float) -> FloatArray:
    """The deepest indentation that each sample's surface remembers, shape (n,).

    A run that begins before the last one's end was recorded by itself, and met no dent.
    """
    deepest, left, ended_s = np.zeros(len(data)), 0.0, np.inf
    for rows in runs_by_time(data.time_s, data.run):
        if data.time_s[rows.start] < ended_s:
            left = 0.0
        deepest[rows] = np.maximum(np.maximum.accumulate(data.position[rows]), left)
        left, ended_s = kept * float(deepest[rows][-1]), float(data.time_s[rows.stop - 1])
    return deepest
