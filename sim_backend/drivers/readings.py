"""Turns a simulated sample into what an interface hands out."""

import numpy as np

from robot_io.types import Reading, Status
from sim_backend.sensors import Sample


def reading_of(sample: Sample | None, part: slice, size: int) -> Reading:
    """A part of `sample`, or NaN of shape (`size`,) from minus infinity where none has arrived yet."""
    if sample is None:
        return Reading(np.full(size, np.nan), -np.inf, Status.STALE)
    return Reading(np.array(sample.value[part]), sample.sampled_at_s, sample.status)
