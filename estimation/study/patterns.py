"""Patterns in an error: conditions in which it is large, and signals on which it depends."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from palpate.control.loop.task import Phase
from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.estimate import rounded, with_unit
from palpate.robot_io.types import BoolArray, FloatArray

_MIN_SHARE = 0.5  # least share of the error in the means of the parts for a pattern
_MIN_DIRECTION_SHARE = 0.3  # least share for a dependence on the direction alone
_GROWTH_RATIO = 2.0  # least ratio of the errors in the last and first parts for a growing error
_ONE_SIDED_SHARE = 0.7  # least share of the error in its mean for an error of one sign
_MIN_ADVANTAGE = 1.2  # least ratio by which another split must explain more
_MAX_PATTERNS = 2  # largest number of reported patterns

# Effort and phase depend on position and direction, so a pattern in these explains one in effort or phase.
_IMPLIED_BY = dict.fromkeys(("effort", "phase"), ("depth", "position", "direction"))


@dataclass(frozen=True)
class ErrorPart:
    """The error in one part of the data."""

    label: str  # such as "moving in" or "0.01 to 0.05 m/s"
    samples: int  # number of samples
    rmse: float  # root mean square of the residual
    mean: float  # mean of the residual; positive if the measurement is above the model
    energy: float  # share of the total squared error
    excess: float  # ratio of the rmse to the noise level


@dataclass(frozen=True)
class ErrorPattern:
    """A pattern in an error."""

    by: str  # split that shows the pattern
    words: str  # description, such as "changes with the direction of motion"
    share: float  # share of the error that follows the pattern

    @property
    def sentence(self) -> str:
        """The pattern as a sentence."""
        return f"The error {self.words}."


def patterns(parts: Mapping[str, Sequence[ErrorPart]], rmse: float) -> tuple[ErrorPattern, ...]:
    """Describe patterns in the parts of an error, the strongest first; empty without any.

    Args:
        parts: errors by kind of split, see `palpate.estimation.study.comparison`.
        rmse: total error [effort].
    """
    # Ratio of the mean residual to the total error; 0 if the error was not split.
    largest_split = max(parts.values(), key=lambda split: sum(part.samples for part in split), default=())
    residual_sum = sum(part.samples * part.mean for part in largest_split)
    samples = sum(part.samples for part in largest_split)
    one_sided = abs(residual_sum) / (rmse * samples) if largest_split and rmse > 0.0 else 0.0
    # Subtract the overall mean from the parts, and compute the correlation ratio of each split: root mean
    # square of the parts' means over the total error.
    centered_rmse = rmse * float(np.sqrt(1.0 - min(one_sided, 1.0) ** 2))
    varying, means = dict[str, list[ErrorPart]](), dict[str, float]()
    for by, split in parts.items():
        weights = [part.samples for part in split]
        mean = float(np.average([part.mean for part in split], weights=weights))
        sizes = [float(np.sqrt(max(part.rmse**2 + mean**2 - 2.0 * mean * part.mean, 0.0))) for part in split]
        centered = zip(split, sizes, strict=True)
        varying[by] = [replace(part, mean=part.mean - mean, rmse=size) for part, size in centered]
        deviations = np.array([part.mean for part in varying[by]])
        deviations -= np.average(deviations, weights=weights)
        spread = float(np.sqrt(np.average(deviations**2, weights=weights)))
        means[by] = spread / centered_rmse if centered_rmse > 0.0 else 0.0
    patterns = [
        ErrorPattern(by, words, share)
        for by, split in varying.items()
        if means[by]
        > _MIN_ADVANTAGE * max((means.get(name, 0.0) for name in _IMPLIED_BY.get(by, ())), default=-1.0)
        for words, share in _pattern_of_split(by, split, means[by])
    ]
    if one_sided > _ONE_SIDED_SHARE:
        patterns.append(ErrorPattern("all", "has one sign throughout", one_sided))
    return tuple(sorted(patterns, key=lambda pattern: -pattern.share)[:_MAX_PATTERNS])


def _pattern_of_split(by: str, parts: Sequence[ErrorPart], share: float) -> Iterator[tuple[str, float]]:
    """Yield description and strength of the patterns in one split."""
    match by:
        case "direction":
            moving = [part.mean for part in parts if part.label.startswith("moving")]
            if len(moving) == 2 and moving[0] * moving[1] < 0.0 and share > _MIN_DIRECTION_SHARE:
                yield "changes with the direction of motion", share
        case "speed":
            growth = parts[-1].rmse / parts[0].rmse if parts[0].rmse > 0.0 else np.inf
            if not 1.0 / _GROWTH_RATIO < growth < _GROWTH_RATIO:
                end = "high" if growth >= _GROWTH_RATIO else "low"
                yield f"is largest at {end} speed", _MIN_DIRECTION_SHARE
        case "run" if share > _MIN_SHARE:
            yield "differs from run to run", share
        case _ if share > _MIN_SHARE:
            known = by in {"depth", "position", "phase", "effort", "load"}
            yield f"varies with {'the ' if known else ''}{by}", share


_BINS = 4


def splits(data: ChannelData) -> dict[str, dict[str, BoolArray]]:
    """Split samples by phase, run, direction, speed, depth, effort, load and recorded columns.

    Args:
        data: the channel.

    Returns:
        Masks of samples, shape (n,), by label, for each split with at least two parts.
    """
    known = {int(phase): phase.name.lower().replace("_", " ") for phase in Phase}
    phases = {known[p]: data.phase == p for p in np.unique(data.phase).tolist() if p in known}
    slow = 0.02 * (float(np.quantile(np.abs(data.velocity), 0.95)) or 1.0)
    position_name, inwards, outwards = "position", "moving forwards", "moving backwards"
    if data.kind is ChannelKind.CONTACT:
        position_name, inwards, outwards = "depth", "moving in", "moving out"
    directions = {
        inwards: data.velocity > slow,
        outwards: data.velocity < -slow,
        "at rest": np.abs(data.velocity) <= slow,
    }
    unit, effort_unit, pressed = data.kind.position_unit, data.kind.effort_unit, data.engaged
    masks_by = {
        "phase": phases,
        "run": {f"run {run}": data.run == run for run in data.runs},
        "direction": directions,
        "speed": _bins(np.abs(data.velocity), f"{unit}/s", pressed),
        position_name: _bins(data.position, unit, pressed),
        "effort": _bins(data.effort, effort_unit, pressed),
    }
    if "load" in data.context:
        masks_by["load"] = _bins(np.abs(data.context["load"]), effort_unit, pressed)
    for name in sorted(data.recorded):
        by = f"recorded {name}" if name in masks_by else name
        masks_by[by] = _bins(data.context[name], "", pressed)
    for by, masks in masks_by.items():
        masks_by[by] = {name: mask for name, mask in masks.items() if mask.any()}
    return {by: masks for by, masks in masks_by.items() if len(masks) > 1}


def _bins(signal: FloatArray, unit: str, engaged: BoolArray) -> dict[str, BoolArray]:
    """Return masks of bins with equal width over all but the outermost samples, for engaged samples."""
    if not engaged.any():
        return {}
    low, high = np.quantile(signal[engaged], [0.005, 0.995])
    low = 0.0 if 0.0 < low < 0.02 * high else low
    if not high > low:
        return {}
    edges = np.linspace(low, high, _BINS + 1)
    bin_index = np.clip(np.digitize(signal, edges[1:-1]), 0, _BINS - 1)
    labels = [f"{rounded(low)} to {with_unit(high, unit)}".strip() for low, high in pairwise(edges)]
    return {label: (bin_index == i) & engaged for i, label in enumerate(labels)}
