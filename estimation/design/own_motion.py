"""Changes to a recorded motion that whoever made it can make: faster, slower, further."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from estimation.channel import ChannelData, ChannelKind

_OF_THE_ARM = {"joint_position": 0, "joint_velocity": 1, "joint_acceleration": 2}  # derivatives of position
_CHANGES = (  # how fast, how far, and words
    (3.0, 1.0, "repeat the motion three times as fast"),
    (1.0 / 3.0, 1.0, "repeat the motion at a third of its speed"),
    (1.0, 1.5, "go half as far again"),
    (1.0, 0.5, "go half as far"),
)


def changed_motions(data: ChannelData) -> Iterator[tuple[str, float, ChannelData]]:
    """Yield changed motions: the change in words, its duration [s], and the channel as it would move.

    Its effort means nothing. None is offered where signals of the context come from a whole arm's motion.

    Args:
        data: the channel.
    """
    if set(data.context) - set(_OF_THE_ARM) - data.recorded:
        return
    lasted_s = sum(float(np.ptp(data.time_s[data.run == run])) for run in data.runs)
    for speed, reach, words in _CHANGES:
        moved = _changed(data, speed, reach)
        yield f"{words} ({extent(moved)})", lasted_s / speed, moved


def extent(data: ChannelData) -> str:
    """Describe how far and fast a channel moves.

    Args:
        data: the channel.
    """
    if data.kind is ChannelKind.REVOLUTE:
        far, fast = f"{np.ptp(data.position):.3g} rad", f"{np.abs(data.velocity).max():.3g} rad/s"
    else:
        position = np.maximum(data.position, 0.0) if data.kind is ChannelKind.CONTACT else data.position
        far, fast = f"{1e3 * np.ptp(position):.3g} mm", f"{1e3 * np.abs(data.velocity).max():.3g} mm/s"
    deep = "to a depth of" if data.kind is ChannelKind.CONTACT else "over"
    return f"{deep} {far}, at up to {fast}"


def _changed(data: ChannelData, speed: float, reach: float) -> ChannelData:
    start_s = data.time_s[0]
    scales = (reach, reach * speed, reach * speed**2)
    middle = 0.0 if data.kind is ChannelKind.CONTACT else float(np.mean(data.position))
    context = dict(data.context)
    for name, order in _OF_THE_ARM.items():
        if name in context:
            centre = np.mean(context[name], axis=0) if order == 0 else 0.0
            context[name] = centre + scales[order] * (context[name] - centre)
    return replace(
        data,
        time_s=start_s + (data.time_s - start_s) / speed,
        position=middle + scales[0] * (data.position - middle),
        velocity=scales[1] * data.velocity,
        acceleration=scales[2] * data.acceleration,
        context=context,
        shared=None,
    )
