"""Kinds of effects: categories of missing physics, which can be identified before its exact form."""

from enum import StrEnum


class Kind(StrEnum):
    """Category of an effect; each kind except OTHER has a flexible law of its own signals."""

    word: str  # short name for charts and lists
    description: str  # name of the kind within a sentence

    def __new__(cls, value: str, word: str, description: str) -> "Kind":
        """Make a kind from its name in JSON, its short name and its description."""
        member = str.__new__(cls, value)
        member._value_, member.word, member.description = value, word, description
        return member

    ELASTIC_SHAPE = "elastic_shape", "elastic shape", "shape of the elastic law"
    RATE_DEPENDENCE = "rate_dependence", "rate dependence", "dependence on the rate"
    FRICTION = "friction", "friction", "dry friction and memory of the path"
    TIME_MEMORY = "time_memory", "relaxation", "memory over time (relaxation, creep)"
    INERTIA = "inertia", "inertia", "inertia"
    PERIODIC = "periodic", "ripple", "ripple over the position"
    GRAVITY_LOAD = "gravity_load", "gravity and load", "gravity and load"
    CONTACT_GEOMETRY = "contact_geometry", "set/adhesion/offset", "contact geometry (offset, adhesion, set)"
    SENSOR_DYNAMICS = "sensor_dynamics", "sensor delay/lag", "sensor dynamics (delay, lag)"
    SENSOR_STATICS = (
        *("sensor_statics", "sensor bias/range"),
        "sensor statics (bias, gain, saturation, dead band)",
    )
    DRIFT = "drift", "drift", "drift with time"
    RUN_DIFFERENCES = "run_differences", "differences between runs", "differences between runs"
    RECORDED_CONTEXT = "recorded_context", "recorded context", "recorded context"
    # User-defined effects without a kind; there is no flexible law for them.
    OTHER = "other", "other effects", "other effects"


SENSOR_KINDS = frozenset({Kind.SENSOR_STATICS, Kind.SENSOR_DYNAMICS})
# Kinds of the object or the drive, and of recorded conditions.
PHYSICAL_KINDS = frozenset(Kind) - SENSOR_KINDS - {Kind.RUN_DIFFERENCES, Kind.DRIFT, Kind.OTHER}
# In a single pass at one speed, these kinds cannot be distinguished from a law of the position, where the
# effort and the sensor's reading are functions of the position. They need a reversal, a hold or a second
# speed.
UNSEEN_IN_ONE_PASS = SENSOR_KINDS | {
    Kind.RATE_DEPENDENCE,
    Kind.FRICTION,
    Kind.TIME_MEMORY,
    Kind.INERTIA,
    Kind.DRIFT,
}

# Experiments that separate two kinds, if one of them can replace the other.
_SEPARATING = {
    (Kind.RATE_DEPENDENCE, Kind.SENSOR_DYNAMICS): (
        "move at two speeds that differ by a factor of five: the force of a damper grows with the speed, "
        "but the delay of a reading does not change"
    ),
    (Kind.RATE_DEPENDENCE, Kind.TIME_MEMORY): (
        "hold the position several times as long as the longest move takes: relaxation continues, but a "
        "damper's force ends with the motion"
    ),
    (Kind.RATE_DEPENDENCE, Kind.FRICTION): (
        "move at a tenth of the speed: dry friction does not change, but viscous forces fall to a tenth"
    ),
    (Kind.ELASTIC_SHAPE, Kind.SENSOR_STATICS): "apply known loads: a sensor's error also appears there",
    (Kind.ELASTIC_SHAPE, Kind.TIME_MEMORY): "move to one position at two speeds, and hold there",
    (Kind.ELASTIC_SHAPE, Kind.CONTACT_GEOMETRY): "press again on the same spot, with a slow first touch",
    (Kind.ELASTIC_SHAPE, Kind.PERIODIC): "move over a wider range: a ripple repeats, but a spring does not",
    (Kind.FRICTION, Kind.TIME_MEMORY): (
        "stop halfway and hold: relaxation continues at rest, but friction does not change"
    ),
    (Kind.FRICTION, Kind.CONTACT_GEOMETRY): (
        "press twice on the same spot: a permanent set moves the second touch"
    ),
    (Kind.DRIFT, Kind.TIME_MEMORY): (
        "record the unloaded sensor for as long as a run: drift continues without a load, but relaxation "
        "does not"
    ),
    (Kind.DRIFT, Kind.RUN_DIFFERENCES): "repeat the first run at the end",
    (Kind.CONTACT_GEOMETRY, Kind.TIME_MEMORY): (
        "press again after a long rest: a permanent set remains, but relaxation recovers"
    ),
    (Kind.GRAVITY_LOAD, Kind.ELASTIC_SHAPE): "move over a wider range: only gravity repeats in each turn",
    (Kind.GRAVITY_LOAD, Kind.SENSOR_STATICS): (
        "hold the joint at two angles half a turn apart: the torque of a weight changes sign, but a bias "
        "does not"
    ),
    (Kind.CONTACT_GEOMETRY, Kind.SENSOR_STATICS): "check the force sensor with known weights",
    (Kind.FRICTION, Kind.SENSOR_STATICS): (
        "move slowly through the same positions in both directions: friction reverses, but the error of a "
        "sensor does not"
    ),
    (Kind.INERTIA, Kind.SENSOR_DYNAMICS): "repeat the motion at another acceleration",
}


def separating_experiment(first: Kind, second: Kind) -> str:
    """Describe an experiment that separates two kinds; a general one if no specific one is known.

    Args:
        first: kind of one effect.
        second: kind of the effect that may be confused with it.
    """
    general = "repeat the motion with other speeds, ranges and holds"
    return _SEPARATING.get((first, second)) or _SEPARATING.get((second, first), general)
