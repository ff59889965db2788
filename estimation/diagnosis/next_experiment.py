"""What to record next, so that the data can say more."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.channel import ChannelKind
from estimation.diagnosis.result import NextExperiment
from estimation.effect import Effect
from estimation.gate.gate import SINGLE_RUN

FEW_READINGS = "different readings"  # what a reason counts where the reader's steps are too coarse
Settings = dict[str, float | int | str | list[float] | dict[str, float | str]]


@dataclass(frozen=True)
class Plan:
    """A way of probing.

    Attributes:
        words: what an experimenter does.
        settings: the same for `palpate probe --experiment`.
    """

    words: str
    settings: Settings = field(default_factory=dict)


_REVERSALS: dict[str, float | str] = {
    "quantity": "position",
    "amplitude_n": 3.0,
    "low_hz": 0.1,
    "high_hz": 0.5,
    "duration_s": 20.0,
}
_TWO_SPEEDS = Plan(
    "probe at a slow and a fast speed, with a long hold",
    {"speeds_m_s": [0.01, 0.05, 0.15], "hold_s": 3.0, "repeats": 3},
)
_LONG_HOLD = Plan(
    "hold the force for a long time, then press again on the same spot",
    {"speeds_m_s": [0.02, 0.1], "hold_s": 10.0, "repeats": 3},
)
_DEEP = Plan(
    "press twice as hard, slowly",
    {"speeds_m_s": [0.01, 0.03], "force_limit_n": 20.0, "hold_s": 1.0, "repeats": 3},
)
_FREE_AIR = Plan(
    "record free air before and after each press",
    {"speeds_m_s": [0.01, 0.05], "free_air_s": 3.0, "hold_s": 1.0, "repeats": 3},
)
_RUNS = Plan(
    "press at least three times, slowly and fast, each as a run of its own; in a data file, a column `run` "
    "numbers them",
    {"speeds_m_s": [0.01, 0.03, 0.1], "hold_s": 1.0, "repeats": 2},
)
_HARDER = Plan(
    "use a finer force sensor, or press twice as hard, so that the force crosses more of the sensor's steps",
    {"speeds_m_s": [0.01, 0.03, 0.1], "force_limit_n": 20.0, "hold_s": 1.0, "repeats": 2},
)
_HEAVIER = Plan(
    "use a finer sensor, or a motion that takes more effort: faster, wider, or with a known mass at the tip"
)
_REPEATS = Plan(
    "repeat one and the same press on one spot, and see whether a run differs again",
    {"speeds_m_s": [0.05], "hold_s": 1.0, "repeats": 6},
)
_SLOW_REVERSALS = Plan(
    "reverse slowly at several depths without leaving the object",
    {"speeds_m_s": [0.005, 0.01], "excitation": _REVERSALS, "hold_s": 1.0, "repeats": 3},
)
_JOINT = Plan(
    "move over a wider range in free air, slowly and fast, in both directions, in several postures, with and "
    "without a known mass at the tip",
    {
        "speeds_m_s": [0.05, 0.15],
        "repeats": 2,
        "hold_s": 0.5,
        "free_air_swing_m": 0.2,
        "free_air_swing_speeds_rad_s": [0.4, 3.0],
        "joint_acceleration_rad_s2": 8.0,
    },
)
_PLANS: Mapping[frozenset[str], Plan] = {
    frozenset({"delay", "damping"}): _TWO_SPEEDS,
    frozenset({"lag", "damping"}): _TWO_SPEEDS,
    frozenset({"lag", "delay"}): _TWO_SPEEDS,
    frozenset({"quadratic_damping", "dry_friction"}): _TWO_SPEEDS,
    frozenset({"stress_relaxation", "plastic_set"}): _LONG_HOLD,
    frozenset({"stress_relaxation", "hysteresis"}): _LONG_HOLD,
    frozenset({"stress_relaxation", "drift"}): _LONG_HOLD,
    frozenset({"bias", "contact_offset"}): _FREE_AIR,
    frozenset({"bias", "drift"}): _FREE_AIR,
    frozenset({"hysteresis", "dry_friction"}): _SLOW_REVERSALS,
}

_BY_SIGNAL: Mapping[str, Plan] = {
    **dict.fromkeys(("position", "effort", "direction", "acceleration", "load"), _DEEP),
    **dict.fromkeys(("joint position", "joint velocity"), _JOINT),
    "velocity": _TWO_SPEEDS,
    "past motion": _LONG_HOLD,
    "time": _FREE_AIR,
    "offset": _FREE_AIR,
    "run": _REPEATS,
}


def separating(effect: Effect, rivals: Sequence[str], kind: ChannelKind) -> NextExperiment:
    """The experiment that tells an effect from those it is confused with."""
    first = rivals[0]
    is_contact = kind is ChannelKind.CONTACT
    plan = _PLANS.get(frozenset({effect.name, first}), _DEEP) if is_contact else _JOINT
    hint = effect.confused_with.get(first)
    return NextExperiment(
        purpose=f"tell {effect.name} from {', '.join(rivals)}",
        separates=[effect.name, *rivals],
        instruction=hint or plan.words,
        probe=_settings(plan, kind),
    )


def exploring(signals: Sequence[str], kind: ChannelKind) -> NextExperiment:
    """The experiment that shows more of an effect that nobody has named."""
    first = signals[0] if signals else "position"
    if first not in _BY_SIGNAL:
        plan = Plan(f"repeat the same motion at different values of {first}, each kept while it lasts")
    else:
        plan = _BY_SIGNAL[first] if kind is ChannelKind.CONTACT else _JOINT
    return NextExperiment(
        purpose="show what the remaining error depends on: " + (", ".join(signals) or "nothing found yet"),
        separates=[],
        instruction=plan.words,
        probe=_settings(plan, kind),
    )


def sufficient(reason: str, kind: ChannelKind) -> NextExperiment:
    """The experiment that makes up for data that cannot say anything."""
    contact, joint = _FREE_AIR, _JOINT
    if reason.startswith(SINGLE_RUN):
        contact = _RUNS
    elif FEW_READINGS in reason:
        contact, joint = _HARDER, _HEAVIER
    plan = contact if kind is ChannelKind.CONTACT else joint
    return NextExperiment(
        purpose="make a diagnosis possible: " + reason,
        separates=[],
        instruction=plan.words,
        probe=_settings(plan, kind),
    )


def _settings(plan: Plan, kind: ChannelKind) -> Settings:
    """What a probing arm is told of a plan: all its joints are revolute."""
    return {} if kind is ChannelKind.PRISMATIC else plan.settings
