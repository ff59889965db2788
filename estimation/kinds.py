"""Kinds of effects: what the missing physics has to do with, before its form is known."""

from enum import StrEnum


class Kind(StrEnum):
    """The kind that an effect belongs to; each has a flexible law of its own signals."""

    ELASTIC_SHAPE = "elastic_shape"
    RATE_DEPENDENCE = "rate_dependence"
    FRICTION = "friction"
    TIME_MEMORY = "time_memory"
    INERTIA = "inertia"
    PERIODIC = "periodic"
    GRAVITY_LOAD = "gravity_load"
    CONTACT_GEOMETRY = "contact_geometry"
    SENSOR_DYNAMICS = "sensor_dynamics"
    SENSOR_STATICS = "sensor_statics"
    DRIFT = "drift"
    RUN_DIFFERENCES = "run_differences"
    RECORDED_CONTEXT = "recorded_context"
    OTHER = "other"  # user-defined effects without a kind; there is no flexible law for them

    @property
    def description(self) -> str:
        """What the kind is called in a sentence."""
        return _DESCRIPTIONS[self]

    @property
    def word(self) -> str:
        """Short name for bars and lists."""
        return _WORDS[self]


# In one pass at one speed these cannot be told from a law of the position: they need a return, a hold or
# another speed. The effort is a curve of the position there, and so is whatever a sensor makes of it.
UNSEEN_IN_ONE_PASS = frozenset(
    {
        Kind.RATE_DEPENDENCE,
        Kind.FRICTION,
        Kind.TIME_MEMORY,
        Kind.INERTIA,
        Kind.SENSOR_DYNAMICS,
        Kind.SENSOR_STATICS,
        Kind.DRIFT,
    }
)

_WORDS = {
    Kind.ELASTIC_SHAPE: "elastic shape",
    Kind.RATE_DEPENDENCE: "rate dependence",
    Kind.FRICTION: "friction",
    Kind.TIME_MEMORY: "relaxation",
    Kind.INERTIA: "inertia",
    Kind.PERIODIC: "ripple",
    Kind.GRAVITY_LOAD: "gravity and load",
    Kind.CONTACT_GEOMETRY: "set/adhesion/offset",
    Kind.SENSOR_DYNAMICS: "sensor delay/lag",
    Kind.SENSOR_STATICS: "sensor bias/range",
    Kind.DRIFT: "drift",
    Kind.RUN_DIFFERENCES: "differences between runs",
    Kind.RECORDED_CONTEXT: "recorded context",
    Kind.OTHER: "other effects",
}

_DESCRIPTIONS = {
    Kind.ELASTIC_SHAPE: "shape of the elastic law",
    Kind.RATE_DEPENDENCE: "dependence on the rate",
    Kind.FRICTION: "dry friction and memory of the path",
    Kind.TIME_MEMORY: "memory over time (relaxation, creep)",
    Kind.INERTIA: "inertia",
    Kind.PERIODIC: "ripple over the position",
    Kind.GRAVITY_LOAD: "gravity and load",
    Kind.CONTACT_GEOMETRY: "contact geometry (offset, adhesion, set)",
    Kind.SENSOR_DYNAMICS: "sensor dynamics (delay, lag)",
    Kind.SENSOR_STATICS: "sensor statics (bias, gain, saturation, dead band)",
    Kind.DRIFT: "drift with time",
    Kind.RUN_DIFFERENCES: "differences between runs",
    Kind.RECORDED_CONTEXT: "recorded context",
    Kind.OTHER: "other effects",
}

# Experiments that separate two kinds, if one of them can replace the other.
_SEPARATING = {
    frozenset({Kind.RATE_DEPENDENCE, Kind.SENSOR_DYNAMICS}): "move at two speeds that differ by a factor of "
    "five: the force of a damper grows with the speed, the delay of a reading does not change",
    frozenset({Kind.RATE_DEPENDENCE, Kind.TIME_MEMORY}): "hold the position for several times the longest "
    "move: what relaxes goes on falling, a damper's force ends with the motion",
    frozenset({Kind.RATE_DEPENDENCE, Kind.FRICTION}): "move at a tenth of the speed: dry friction stays, "
    "viscous forces fall to a tenth",
    frozenset({Kind.ELASTIC_SHAPE, Kind.SENSOR_STATICS}): "check the force sensor with known weights",
    frozenset({Kind.ELASTIC_SHAPE, Kind.TIME_MEMORY}): "press to one depth at two speeds, and hold there",
    frozenset(
        {Kind.ELASTIC_SHAPE, Kind.CONTACT_GEOMETRY}
    ): "press again on the same spot, and slowly through the first touch",
    frozenset(
        {Kind.ELASTIC_SHAPE, Kind.PERIODIC}
    ): "move over a wider range: a ripple repeats, a spring does not",
    frozenset(
        {Kind.FRICTION, Kind.TIME_MEMORY}
    ): "stop half way and hold: what relaxes changes at rest, friction does not",
    frozenset(
        {Kind.FRICTION, Kind.CONTACT_GEOMETRY}
    ): "press twice on the same spot: a set moves the second touch",
    frozenset(
        {Kind.DRIFT, Kind.TIME_MEMORY}
    ): "record the unloaded sensor for as long as a run: drift goes on, relaxation needs a load",
    frozenset({Kind.DRIFT, Kind.RUN_DIFFERENCES}): "repeat the first run at the end",
    frozenset(
        {Kind.CONTACT_GEOMETRY, Kind.TIME_MEMORY}
    ): "press again after a long rest: a set stays, relaxation recovers",
    frozenset({Kind.GRAVITY_LOAD, Kind.ELASTIC_SHAPE}): "move over a wider range: gravity repeats "
    "once a turn",
    frozenset({Kind.INERTIA, Kind.SENSOR_DYNAMICS}): "repeat the motion at another acceleration",
}


def separating_experiment(first: Kind, second: Kind) -> str:
    """Return the experiment that separates two kinds; a general one where none is known.

    Args:
        first: kind of one effect.
        second: kind of the effect that it may be confused with.
    """
    known = _SEPARATING.get(frozenset({first, second}))
    return (
        known
        or "repeat the motion with other speeds, ranges and holds, so that the two act at different times"
    )
