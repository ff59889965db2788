"""One time axis for runs that may each begin at zero."""

import numpy as np

from estimation.channel import ChannelData
from palpate.views.plots.phase_strip import stretches
from robot_io.types import FloatArray

GAP_SHARE = 0.05  # of the mean run, left between two runs


def one_after_the_other(channel: ChannelData) -> FloatArray:
    """Time of each sample (n,) on one axis, with the runs behind each other: each may begin at zero [s]."""
    blocks = stretches(channel.run)
    lengths = [float(channel.time_s[past - 1] - channel.time_s[first]) for first, past in blocks]
    gap_s = GAP_SHARE * float(np.mean(lengths))
    time_s = np.empty(len(channel))
    start_s = 0.0
    for (first, past), length_s in zip(blocks, lengths, strict=True):
        time_s[first:past] = start_s + channel.time_s[first:past] - channel.time_s[first]
        start_s += length_s + gap_s
    return time_s
