"""Ways to split samples, so that one sees where a model fails."""

from itertools import pairwise

import numpy as np

from control.loop.task import Phase
from estimation.channel import ChannelData
from robot_io.types import BoolArray, FloatArray

_BINS = 4


def splits(data: ChannelData) -> dict[str, dict[str, BoolArray]]:
    """Split samples by phase, run, direction, speed, depth, effort, load and recorded columns.

    Args:
        data: the channel.

    Returns:
        Masks of samples, shape (n,), by label, for each split with at least two parts.
    """
    found = {
        "phase": _phases(data),
        "run": {f"run {run}": data.run == run for run in data.runs},
        "direction": _directions(data),
        "speed": _bins(np.abs(data.velocity), f"{data.kind.position_unit}/s", data.engaged),
        "depth" if data.kind.value == "contact" else "position": _bins(
            data.position, data.kind.position_unit, data.engaged
        ),
        "effort": _bins(data.effort, data.kind.effort_unit, data.engaged),
    }
    if "load" in data.context:
        found["load"] = _bins(np.abs(data.context["load"]), data.kind.effort_unit, data.engaged)
    for name in sorted(data.recorded):
        found[f"recorded {name}" if name in found else name] = _bins(data.context[name], "", data.engaged)
    occupied = {by: {name: one for name, one in masks.items() if one.any()} for by, masks in found.items()}
    return {by: masks for by, masks in occupied.items() if len(masks) > 1}


def _phases(data: ChannelData) -> dict[str, BoolArray]:
    known = {int(phase): phase.name.lower().replace("_", " ") for phase in Phase}
    return {known[p]: data.phase == p for p in np.unique(data.phase).tolist() if p in known}


def _directions(data: ChannelData) -> dict[str, BoolArray]:
    slow = 0.02 * (float(np.quantile(np.abs(data.velocity), 0.95)) or 1.0)
    inwards, outwards = (
        ("moving in", "moving out")
        if data.kind.value == "contact"
        else ("moving forwards", "moving backwards")
    )
    return {
        inwards: data.velocity > slow,
        outwards: data.velocity < -slow,
        "at rest": np.abs(data.velocity) <= slow,
    }


def _bins(signal: FloatArray, unit: str, engaged: BoolArray) -> dict[str, BoolArray]:
    """Bins of equal width over all but the outermost samples; a contact only while pressed."""
    if not engaged.any():
        return {}
    low, high = np.quantile(signal[engaged], [0.005, 0.995])
    low = 0.0 if 0.0 < low < 0.02 * high else low
    if not high > low:
        return {}
    edges = np.linspace(low, high, _BINS + 1)
    place = np.clip(np.digitize(signal, edges[1:-1]), 0, _BINS - 1)
    labels = [f"{low:.3g} to {high:.3g} {unit}".strip() for low, high in pairwise(edges)]
    return {label: (place == i) & engaged for i, label in enumerate(labels)}
