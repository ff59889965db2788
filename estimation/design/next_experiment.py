"""Propose the next experiment in words.

The proposals here vary a recorded motion. For a probing arm, `palpate.planning.next_probe` plans new motions.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.data_quality import SINGLE_RUN
from palpate.estimation.design.discrimination import (
    Experiment,
    RivalModels,
    choose_experiment,
    separated_names,
)
from palpate.estimation.effect import Effect
from palpate.estimation.fit.fit_result import FitResult
from palpate.estimation.kinds import Kind, separating_experiment
from palpate.estimation.signals.motion import never_returns

if TYPE_CHECKING:
    from palpate.control.probing.plan import ProbingPlan

LONGEST_S = 120.0  # longest experiment for a probing arm [s]
_ARM_SIGNALS = {"joint_position": 0, "joint_velocity": 1, "joint_acceleration": 2}  # derivatives of position
_CHANGES = (  # factor on the speed, factor on the range, and instruction
    (3.0, 1.0, "repeat the motion three times as fast"),
    (1.0 / 3.0, 1.0, "repeat the motion at a third of its speed"),
    (1.0, 1.5, "move over one and a half times the range"),
    (1.0, 0.5, "move over half the range"),
)
_REVERSAL = (1.0, -1.0, "repeat the motion in the other direction")


def can_vary(data: ChannelData) -> bool:
    """Return whether all signals of a changed motion can be computed, unlike the regressor of an arm.

    Args:
        data: the recorded channel.
    """
    return not set(data.context) - set(_ARM_SIGNALS) - data.recorded


def _candidate_motions(data: ChannelData) -> Iterator[tuple[str, float, ChannelData]]:
    """Yield changed motions: instruction, duration [s], and the channel; its effort has no meaning."""
    if not can_vary(data):
        return
    duration_s = sum(float(np.ptp(data.time_s[data.run == run])) for run in data.runs)
    is_one_way = data.kind is not ChannelKind.CONTACT and never_returns(data.position, data.run)
    for speed_factor, range_factor, instruction in (*_CHANGES, _REVERSAL) if is_one_way else _CHANGES:
        start_s = data.time_s[0]
        scales = (range_factor, range_factor * speed_factor, range_factor * speed_factor**2)
        middle = 0.0 if data.kind is ChannelKind.CONTACT else float(np.mean(data.position))
        context = dict(data.context)
        for name, order in _ARM_SIGNALS.items():
            if name in context:
                center = np.mean(context[name], axis=0) if order == 0 else 0.0
                context[name] = center + scales[order] * (context[name] - center)
        changed = replace(
            data,
            time_s=start_s + (data.time_s - start_s) / speed_factor,
            position=middle + scales[0] * (data.position - middle),
            velocity=scales[1] * data.velocity,
            acceleration=scales[2] * data.acceleration,
            context=context,
            shared=None,
        )
        yield f"{instruction} ({extent(changed)})", duration_s / speed_factor, changed


def extent(data: ChannelData) -> str:
    """Describe how far and how fast a channel moves, such as "over 0.5 rad, at up to 2 rad/s".

    Args:
        data: the channel. Lengths are stated in mm; in a contact they count from the surface, unless
            `touching` states the samples in contact.
    """
    from_surface = data.kind is ChannelKind.CONTACT and data.touching is None
    if data.kind.is_angle:
        distance, speed = f"{np.ptp(data.position):.3g} rad", f"{np.abs(data.velocity).max():.3g} rad/s"
    else:
        position = np.maximum(data.position, 0.0) if from_surface else data.position
        distance, speed = f"{1e3 * np.ptp(position):.3g} mm", f"{1e3 * np.abs(data.velocity).max():.3g} mm/s"
    return f"{'to a displacement of' if from_surface else 'over'} {distance}, at up to {speed}"


FEW_READINGS = "different readings"  # part of the reason for a sensor whose resolution is too coarse
_REPEAT_RUNS = (
    "repeat the motion at least three times, slowly and fast, each as a run of its own; in a data file, "
    "number the runs in a column `run`"
)
_FINER_SENSOR = "use a finer sensor, or a motion with larger efforts: harder, faster, or wider"
NO_VARIED_MOTION = "no change of the recorded motion is expected to separate the explanations"
NO_PROBE = "no experiment of this arm is expected to separate the explanations"
_UNLOADED = "begin and end each run without load"
_WIDER = "move over a wider range, slowly and fast, in both directions"
_BY_SIGNAL: Mapping[str, str] = {
    "velocity": "move slower and faster",
    "past motion": "hold still for longer, then repeat the motion at once",
    "time": f"repeat the same motion after a pause; {_UNLOADED}",
    "offset": _UNLOADED,
    "rare events": (
        "repeat the motion, then repeat it at half the speed: impacts become weaker, but lost readings do not"
    ),
    "run": "repeat the same motion, and see whether runs differ again",
    **dict.fromkeys(("position", "effort", "load"), "move further, slowly"),
    **dict.fromkeys(("direction", "acceleration", "joint position", "joint velocity"), _WIDER),
}


class NextExperiment(BaseModel):
    """The next experiment, in words."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    purpose: str  # purpose of the experiment
    separates: list[str]  # effects that it would separate
    instruction: str  # instruction for the experimenter
    # Settings for `palpate probe --experiment`, by name.
    probe: dict[str, float | int | str | list[float] | list[list[float]] | dict[str, float | str]]


@dataclass(frozen=True)
class NextProbe:
    """The next experiment as a command for the arm that made the recording."""

    plan: "ProbingPlan"  # motion of the arm
    proposal: NextExperiment  # the experiment in the form used by a diagnosis
    reason: str  # reason for the choice
    channels: tuple[str, ...]  # channels about which it gives information
    # Pairs of models that at least one experiment of the arm separates; None if they were not compared.
    separated: Collection[frozenset[str]] | None = None


def varied_motions(fits: Mapping[str, FitResult], data: ChannelData) -> list[Experiment]:
    """Return the changes of the recorded motion with the expected separation of rival models by each.

    Args:
        fits: fit of each rival model, by name of the effect in which they differ.
        data: the recorded channel.
    """
    rivals = RivalModels.of(list(fits.values()))
    return [
        Experiment(instruction, duration_s, (rivals.predicted_leads(changed),))
        for instruction, duration_s, changed in _candidate_motions(data)
    ]


def propose_varied_motion(fits: Mapping[str, FitResult], data: ChannelData) -> NextExperiment | None:
    """Choose the change of the recorded motion that separates rivals best; None if none is expected to.

    Args:
        fits: fit of each rival model, by name of the effect in which they differ; the accepted one first.
        data: the recorded channel.
    """
    choice = choose_experiment(varied_motions(fits, data))
    if choice is None:
        return None
    names = separated_names(list(fits), choice.experiment.leads[0])
    return NextExperiment(
        purpose=describe_separation(names),
        separates=names,
        instruction=choice.experiment.instruction,
        probe={},
    )


def propose_known_experiment(effect: Effect, names: Sequence[str], data: ChannelData) -> NextExperiment:
    """Propose the experiment that the library states for an effect and one of its rivals.

    Args:
        effect: effect that was accepted.
        names: names of the effect and of its rivals.
        data: the recorded channel.
    """
    hint = next((effect.confused_with[name] for name in names if name in effect.confused_with), _WIDER)
    return NextExperiment(
        purpose=describe_separation([effect.name, *(name for name in names if name != effect.name)]),
        separates=list(names),
        instruction=f"{hint} ({_describe_recorded(data)})",
        probe={},
    )


def describe_separation(names: Sequence[str]) -> str:
    """Describe the purpose of an experiment that separates the first of several rivals from the others.

    Args:
        names: names of the rivals.
    """
    return f"tell {names[0]} from {', '.join(names[1:])}"


def propose_kind_separating_experiment(effect: Effect, kind: Kind, data: ChannelData) -> NextExperiment:
    """Propose the experiment that separates an effect from an unknown law of another kind.

    Args:
        effect: effect that was accepted.
        kind: the other kind.
        data: the recorded channel.
    """
    return NextExperiment(
        purpose=f"tell {effect.name} from a law of {kind.word}",
        separates=[effect.name],
        instruction=f"{separating_experiment(effect.kind, kind)} ({_describe_recorded(data)})",
        probe={},
    )


def propose_exploring_experiment(signals: Sequence[str], data: ChannelData) -> NextExperiment:
    """Propose an experiment that shows more of an unidentified effect.

    Args:
        signals: names of signals on which the remaining error depends, the most important first.
        data: the channel.
    """
    signal = signals[0] if signals else "position"
    instruction = f"{_BY_SIGNAL.get(signal, _WIDER)} ({_describe_recorded(data)})"
    if signal in data.recorded:
        instruction = f"repeat the same motion at different values of {signal}, each held constant"
    purpose = "show what the remaining error depends on: " + (", ".join(signals) or "nothing found yet")
    return NextExperiment(purpose=purpose, separates=[], instruction=instruction, probe={})


def _describe_recorded(data: ChannelData) -> str:
    """Describe the recorded motion, so that the user can vary it."""
    return f"the motion recorded here goes {extent(data)}"


def propose_repetition(run: int, purpose: str) -> NextExperiment:
    """Propose to repeat a run whose motion no other run contains.

    Args:
        run: number of the run.
        purpose: purpose of the experiment.
    """
    return NextExperiment(
        purpose=purpose,
        separates=[],
        instruction=f"repeat the motion of run {run}, so that at least two runs contain it",
        probe={},
    )


def propose_remedial_experiment(reason: str, kind: ChannelKind) -> NextExperiment:
    """Propose the experiment that makes a rejected channel usable.

    Args:
        reason: why the channel cannot be diagnosed.
        kind: kind of the channel.
    """
    remedy = reason.partition("; ")[2]
    instruction = remedy or (_UNLOADED if kind is ChannelKind.CONTACT else _WIDER)
    if reason.startswith(SINGLE_RUN):
        instruction = _REPEAT_RUNS
    elif FEW_READINGS in reason:
        instruction = _FINER_SENSOR
    elif remedy.endswith("?"):  # no other motion helps against a wrong unit or column
        instruction = "check units and columns of this recording"
    purpose = "make a diagnosis possible"
    return NextExperiment(purpose=purpose, separates=[], instruction=instruction, probe={})
