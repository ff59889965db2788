"""Channels recorded one after the other, as one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData


def joined_channels(parts: Sequence[ChannelData]) -> ChannelData:
    """The same channel from several recordings; the numbers of the runs go on, clocks stay as they are.

    Position counts from the same surface in all of them. Signals that one of them lacks are left out.
    """
    first = parts[0]
    runs, count = [], 0
    for part in parts:
        runs.append(np.unique(part.run, return_inverse=True)[1] + count)
        count = int(runs[-1].max(initial=count - 1)) + 1
    names = [name for name in first.context if all(name in part.context for part in parts)]

    def of_all(what: str) -> np.ndarray:
        return np.concatenate([getattr(part, what) for part in parts])

    touching = [
        np.zeros(len(part), dtype=np.bool_) if part.touching is None else part.touching for part in parts
    ]
    return replace(
        first,
        time_s=of_all("time_s"),
        position=of_all("position"),
        velocity=of_all("velocity"),
        acceleration=of_all("acceleration"),
        effort=of_all("effort"),
        phase=of_all("phase"),
        run=np.concatenate(runs),
        context={name: np.concatenate([part.context[name] for part in parts]) for name in names},
        recorded=frozenset(first.recorded & set(names)),
        position_step=max(part.position_step for part in parts),
        touching=None if all(part.touching is None for part in parts) else np.concatenate(touching),
        shared=None,
    )
