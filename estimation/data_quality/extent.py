"""Checks of the extent of a channel: its samples, runs, depths and speeds."""

from itertools import pairwise

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.fit.blocks import PIECES, block_length
from palpate.estimation.signals.motion import has_constant_speed, has_constant_velocity, never_returns

MIN_SAMPLES = 60
SINGLE_RUN = "only one run"  # start of the reason if only the division into runs is missing
_MAX_BLOCKS = 300_000  # 25 minutes of blocks of 5 ms; limits the memory
_MIN_SHARED = 0.1  # share of a run's depths that another run must reach for a prediction
_MIN_TRAVEL = 3.0  # least path of a single recording of repeated motion, in ranges of position


def wrong_size(data: ChannelData) -> str | None:
    """Report too few samples, or more than can be searched; None otherwise."""
    if len(data) < MIN_SAMPLES:
        return f"only {len(data)} samples; record at least {MIN_SAMPLES}"
    lengths = np.unique(data.run, return_counts=True)[1]
    count = int(np.sum(lengths // block_length(data)))
    if count > _MAX_BLOCKS:
        excess = f"{count} blocks of data are more than the {_MAX_BLOCKS} that can be searched"
        advice = f"some of the {len(lengths)} runs with --where run=N,N ..."
        return f"{excess}; take {advice if len(lengths) > 1 else 'shorter recordings'}"
    return None


def no_shared_depth(data: ChannelData) -> str | None:
    """Report that no two runs of a contact have similar depths, so none can be held out; else None."""
    if data.kind is not ChannelKind.CONTACT or len(data.runs) == 1:
        return None
    depths = [data.position[data.engaged & (data.run == run)] for run in data.runs]
    ranges = sorted((float(depth.min()), float(depth.max())) for depth in depths if len(depth))
    if len(ranges) == 1:
        return f"{SINGLE_RUN} of {len(data.runs)} touches the object; record at least three that do"
    spans = [_MIN_SHARED * (high - low) for low, high in ranges]
    shared = (before[1] - after[0] for before, after in pairwise(ranges))
    if ranges and all(depth <= min(pair) for depth, pair in zip(shared, pairwise(spans), strict=True)):
        return (
            f"no two of {len(ranges)} runs have similar depths, so none can be predicted from the "
            "others; press repeatedly to the same depth"
        )
    return None


def never_repeated(data: ChannelData) -> str | None:
    """Report effects that cannot be distinguished because the motion does not return or repeat; else None."""
    if len(data.runs) > 1:
        if data.kind is not ChannelKind.CONTACT or not never_returns(data.position, data.run):
            return None
        if has_constant_velocity(data.time_s, data.position, data.run):
            return (
                "all runs go one way at one speed: relaxation, friction, damping and the range of the sensor "
                "cannot be distinguished from the elastic law; hold, return, or add runs at another speed"
            )
        return (
            "no run returns: friction cannot be distinguished from elastic shape; record a run that returns"
        )
    travel = sum(np.ptp(part) for part in np.array_split(data.position, PIECES))
    if travel >= _MIN_TRAVEL * np.ptp(data.position):
        return None
    return (
        f"{SINGLE_RUN}, which goes through its motion once: changes with time and with position "
        "cannot be separated; record at least three runs"
    )


def single_speed(data: ChannelData) -> str | None:
    """Report runs that return but have only one speed; None otherwise."""
    has_one_speed = data.kind is ChannelKind.CONTACT and has_constant_speed(data.velocity[data.engaged])
    if not has_one_speed or never_returns(data.position, data.run):
        return None
    return (
        "all motion is at one speed: dependence on the rate cannot be distinguished from friction; add "
        "runs at another speed"
    )
