"""Propose the next experiment in words.

A probing arm can do more than repeat a motion in another way: its plan comes from
`palpate.planning.next_probe`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data_quality import SINGLE_RUN
from palpate.estimation.design import Experiment, Rivals, choose
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import FitResult

if TYPE_CHECKING:
    from palpate.control.probing.plan import ProbingPlan

LONGEST_S = 120.0  # longest experiment for a probing arm [s]
_OF_THE_ARM = {"joint_position": 0, "joint_velocity": 1, "joint_acceleration": 2}  # derivatives of position
_CHANGES = (  # speed factor, depth factor, and words
    (3.0, 1.0, "repeat the motion three times as fast"),
    (1.0 / 3.0, 1.0, "repeat the motion at a third of its speed"),
    (1.0, 1.5, "move over one and a half times the range"),
    (1.0, 0.5, "move over half the range"),
)


def changed_motions(data: ChannelData) -> Iterator[tuple[str, float, ChannelData]]:
    """Yield changed motions: the change in words, its duration [s], and the channel as it would move.

    The effort of the changed channel has no meaning. Nothing is yielded if signals of the context depend on
    the motion of a whole arm.

    Args:
        data: the channel.
    """
    if set(data.context) - set(_OF_THE_ARM) - data.recorded:
        return
    lasted_s = sum(float(np.ptp(data.time_s[data.run == run])) for run in data.runs)
    for speed, reach, words in _CHANGES:
        start_s = data.time_s[0]
        scales = (reach, reach * speed, reach * speed**2)
        middle = 0.0 if data.kind is ChannelKind.CONTACT else float(np.mean(data.position))
        context = dict(data.context)
        for name, order in _OF_THE_ARM.items():
            if name in context:
                centre = np.mean(context[name], axis=0) if order == 0 else 0.0
                context[name] = centre + scales[order] * (context[name] - centre)
        moved = replace(
            data,
            time_s=start_s + (data.time_s - start_s) / speed,
            position=middle + scales[0] * (data.position - middle),
            velocity=scales[1] * data.velocity,
            acceleration=scales[2] * data.acceleration,
            context=context,
            shared=None,
        )
        yield f"{words} ({extent(moved)})", lasted_s / speed, moved


def extent(data: ChannelData) -> str:
    """Describe how far and fast a channel moves.

    Args:
        data: the channel.
    """
    if data.kind.is_angle:
        far, fast = f"{np.ptp(data.position):.3g} rad", f"{np.abs(data.velocity).max():.3g} rad/s"
    else:
        position = np.maximum(data.position, 0.0) if data.kind is ChannelKind.CONTACT else data.position
        far, fast = f"{1e3 * np.ptp(position):.3g} mm", f"{1e3 * np.abs(data.velocity).max():.3g} mm/s"
    deep = "to a depth of" if data.kind is ChannelKind.CONTACT else "over"
    return f"{deep} {far}, at up to {fast}"


FEW_READINGS = "different readings"  # part of a reason: the resolution of the sensor is too coarse
_RUNS = (
    "repeat the motion at least three times, slowly and fast, each as a run of its own; in a data file, a "
    "column `run` numbers them"
)
_COARSE = "use a finer sensor, or a motion that takes more effort: harder, faster, or wider"
_FREE = "begin and end each run without load"
_WIDER = "move over a wider range, slowly and fast, in both directions"
_BY_SIGNAL: Mapping[str, str] = {
    "velocity": "move slower and faster",
    "past motion": "hold still for longer, then repeat the motion at once",
    "time": _FREE,
    "offset": _FREE,
    "run": "repeat the same motion, and see whether runs differ again",
    **dict.fromkeys(("position", "effort", "load"), "go further, slowly"),
    **dict.fromkeys(("direction", "acceleration", "joint position", "joint velocity"), _WIDER),
}


class NextExperiment(BaseModel):
    """The next experiment, in words."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    purpose: str  # what it would tell
    separates: list[str]  # the effects that it would tell apart
    instruction: str  # in words
    # Settings for `palpate probe --experiment`, by name.
    probe: dict[str, float | int | str | list[float] | list[list[float]] | dict[str, float | str]]


@dataclass(frozen=True)
class NextProbe:
    """The next experiment as a command for the arm that made the recording."""

    plan: "ProbingPlan"  # what the arm does
    proposal: NextExperiment  # the same as a diagnosis states it
    reason: str  # why it was chosen
    channels: tuple[str, ...]  # channels that it informs


def separating(effect: Effect, fits: Mapping[str, FitResult], data: ChannelData) -> NextExperiment:
    """Choose the experiment that separates an effect from those it is confused with.

    Args:
        effect: effect that was accepted.
        fits: the model with it, and with each rival in its place, by name.
        data: the channel as it was recorded.
    """
    names = list(fits)
    rivals = Rivals.of(list(fits.values()))
    offered = [
        Experiment(words, lasts_s, (rivals.predicted_leads(moved),))
        for words, lasts_s, moved in changed_motions(data)
    ]
    choice = choose(offered)
    if choice is not None:
        words = choice.experiment.words
    else:
        hint = next((effect.confused_with[name] for name in names if name in effect.confused_with), _WIDER)
        words = f"{hint} ({_recorded(data)})"
    return NextExperiment(
        purpose=f"tell {effect.name} from {', '.join(name for name in names if name != effect.name)}",
        separates=names,
        instruction=words,
        probe={},
    )


def exploring(signals: Sequence[str], data: ChannelData) -> NextExperiment:
    """Propose the experiment that shows more of an effect without a name.

    Args:
        signals: names of signals that the remaining error depends on.
        data: the channel.
    """
    first = signals[0] if signals else "position"
    recorded = f"repeat the same motion at different values of {first}, each kept while it lasts"
    words = recorded if first in data.recorded else f"{_BY_SIGNAL.get(first, _WIDER)} ({_recorded(data)})"
    return NextExperiment(
        purpose="show what the remaining error depends on: " + (", ".join(signals) or "nothing found yet"),
        separates=[],
        instruction=words,
        probe={},
    )


def _recorded(data: ChannelData) -> str:
    """Description of the user's motion, from which to vary it."""
    return f"the motion recorded here goes {extent(data)}"


def sufficient(reason: str, kind: ChannelKind) -> NextExperiment:
    """Propose the experiment that provides what the data lack.

    Args:
        reason: why the channel cannot be judged.
        kind: kind of the channel.
    """
    remedy = reason.partition("; ")[2]
    words = remedy or (_FREE if kind is ChannelKind.CONTACT else _WIDER)
    if reason.startswith(SINGLE_RUN):
        words = _RUNS
    elif FEW_READINGS in reason:
        words = _COARSE
    elif remedy.endswith("?"):  # no other motion helps against a wrong unit or column
        words = "check units and columns of this recording"
    return NextExperiment(purpose="make a diagnosis possible", separates=[], instruction=words, probe={})
