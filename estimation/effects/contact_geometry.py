"""Contact geometry: position of the surface, adhesion and permanent set."""

from dataclasses import replace

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effect import AdditiveEffect, Inner, MotionEffect, Parameter, start_grid
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.blocks import runs_by_time
from palpate.estimation.signals.runwise import running_max
from palpate.robot_io.types import FloatArray


class ContactOffset(MotionEffect):
    """Shift of the surface; the offset is positive if the surface lies deeper than assumed."""

    name = "contact_offset"
    kind = Kind.CONTACT_GEOMETRY
    physics = "The object's surface lies deeper or higher than assumed, or the object is preloaded."
    equation = "x_true = x - offset"
    source = "geometry of the probe and the object"
    signature = "all force-depth curves are shifted along the depth, and the force in free air is zero"
    signals = ("position",)
    channels = frozenset({ChannelKind.CONTACT})
    inner = (Parameter("offset", "{position}", -1.0, 1.0, (-1e-3, 1e-3)),)
    start_multiples = {"offset": ("deepest", (-0.5, -0.2, -0.08, -0.03, -0.01, 0.01, 0.03, 0.08, 0.2, 0.5))}
    confused_with = {
        "bias": "record free air: a sensor's bias also appears there, but an offset does not",
        "adhesion": "watch the force just before contact is lost: adhesion pulls the tool there",
    }

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        return replace(data, position=data.position - inner["offset"])


class Adhesion(AdditiveEffect):
    name = "adhesion"
    kind = Kind.CONTACT_GEOMETRY
    physics = "After the touch, the object attracts the tool until the tool has left the surface."
    equation = "F = -f s, s = 1 for x > 0, exp(x/reach) for x < 0 after contact, 0 before"
    source = "B. V. Derjaguin, V. M. Muller, Yu. P. Toporov, J. Colloid Interface Sci. 53 (1975)"
    signature = "when the tool leaves the object, the force falls below that in free air before it returns"
    signals = ("position", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    one_sided = False
    gains = (Parameter("force", "{effort}", 0.0, 1e12, (0.05, 5.0)),)
    inner = (Parameter("reach", "{position}", 1e-09, 10.0, (0.0001, 0.005), log=True),)
    start_multiples = {"reach": ("deepest", np.geomspace(0.003, 0.3, 9))}
    confused_with = {
        "contact_offset": "retract slowly beyond the surface: only adhesion pulls there",
        "bias": "record free air before the touch: a bias also appears there",
        "dry_friction": "retract slowly beyond the surface: friction ends with the contact",
    }

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`: not to an element attached at both ends, which has no surface."""
        is_held = data.touching is not None and bool(data.touching.all())
        return super().applies_to(data) and not is_held

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        touched = running_max(data.engaged.astype(np.float64), data.run)
        neck = np.exp(np.minimum(data.position, 0.0) / inner["reach"])
        return -(touched * neck)[:, None]


_TOUCHING = 1e-300  # depth of a contact without strain


class PlasticSet(MotionEffect):
    """Dent of a surface that sinks, so that the tool loses contact within the dent.

    A second form (`_AtTheTool`) describes a material that crushes inside, such as foam. It stays in contact
    with the tool, so that damping also acts within the dent.
    """

    name = "plastic_set"
    kind = Kind.CONTACT_GEOMETRY
    physics = "Part of the indentation is permanent: contact ends deeper than it began."
    equation = (
        "x_true = x - dent, v_true = x_true', dent = share max_t(x); the next run starts with kept * dent"
    )
    source = "permanent set in indentation; K. L. Johnson, Contact Mechanics (1985), ch. 6"
    signature = "force reaches zero at a positive depth on the way out; the next press begins there"
    signals = ("position", "past motion")
    channels = frozenset({ChannelKind.CONTACT})
    inner = (
        Parameter("share", "1", 1e-4, 0.9, (0.02, 0.5), log=True),
        Parameter("kept", "1", 0.0, 1.0, (0.0, 1.0)),
    )
    confused_with = {
        "stress_relaxation": "wait and press again: a permanent set remains, but relaxation recovers",
        "adhesion": "press twice on one spot: a permanent set moves the second touch",
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
        return PlasticSet(), _AtTheTool()

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        share, kept = self.inner
        return start_grid(share=share.spread(10), kept=kept.spread(2))


class _AtTheTool(PlasticSet):
    form = 1

    def move(self, data: ChannelData, inner: Inner) -> ChannelData:
        depth = data.position - inner["share"] * _deepest(data, inner["kept"])
        return replace(data, position=np.where(data.engaged, np.maximum(depth, _TOUCHING), depth))


def _deepest(data: ChannelData, kept: float) -> FloatArray:
    """Return the deepest indentation so far that affects the surface at each sample, shape (n,).

    If a run begins before the end of the previous run, it was recorded separately and meets no dent.
    """
    deepest, remaining, ended_s = np.zeros(len(data)), 0.0, np.inf
    for rows in runs_by_time(data.time_s, data.run):
        if data.time_s[rows.start] < ended_s:
            remaining = 0.0
        deepest[rows] = np.maximum(np.maximum.accumulate(data.position[rows]), remaining)
        remaining, ended_s = kept * float(deepest[rows][-1]), float(data.time_s[rows.stop - 1])
    return deepest
