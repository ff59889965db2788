"""Hysteresis of Bouc and Wen along a path: exact between turns, whatever the steps."""

from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimation.signals.blocks import places
from robot_io.types import FloatArray, IntArray

_DEEPEST = 36.0  # of -log(1 - w): beyond it w is 1 to the last digit
_GRID = 3000


def bouc_wen(
    position: FloatArray, run: IntArray, path: float, sharpness: float, unloading: float
) -> FloatArray:
    """State w in [-1, 1], shape (n,), from 0 at each run's start.

    Along the direction of motion dw/dx = (1 - w^n) / path while w grows away from zero, and
    (1 + unloading |w|^n) / path while it goes back. With n = 1 and unloading = 1 it is Dahl's friction.

    Args:
        position: shape (n,).
        run: run of each sample.
        path: over which w builds up, in the unit of position.
        sharpness: n.
        unloading: 0 for a straight return, 1 for one that begins twice as steep.
    """
    first, number = places(run)
    steps = np.diff(position, prepend=position[:1]) / path
    steps[first] = 0.0
    if not len(steps):
        return steps
    sign = np.where(steps >= 0.0, 1.0, -1.0)
    starts, piece = places(2 * number + (sign > 0.0))
    way = np.cumsum(np.abs(steps))
    way -= np.concatenate([[0.0], way[starts[1:] - 1]])[piece]
    flow = _flow(sharpness, unloading)
    begun = np.empty(len(starts))
    ends = np.append(starts[1:], len(steps)) - 1
    afresh = np.append(True, np.diff(run[starts]) != 0)
    state = 0.0
    for i, (side, length, new) in enumerate(
        zip(sign[starts].tolist(), way[ends].tolist(), afresh.tolist(), strict=True)
    ):
        here = _between(0.0 if new else side * state, flow.states_listed, flow.ways_listed)
        begun[i] = here
        state = side * _between(here + length, flow.ways_listed, flow.states_listed)
    return np.asarray(sign * np.interp(begun[piece] + way, flow.ways, flow.states))


def _between(at: float, points: list[float], values: list[float]) -> float:
    """As `np.interp` for one number, which takes longer to be called than to be found."""
    right = bisect_right(points, at)
    if right == 0 or right == len(points):
        return values[min(right, len(points) - 1)]
    left = right - 1
    share = (at - points[left]) / (points[right] - points[left])
    return values[left] + share * (values[right] - values[left])


@dataclass(frozen=True)
class _Flow:
    """States w from -1 to 1, and the path from -1 to each; the same as lists."""

    states: FloatArray
    ways: FloatArray
    states_listed: list[float]
    ways_listed: list[float]


@lru_cache(maxsize=64)
def _flow(sharpness: float, unloading: float) -> _Flow:
    back = np.linspace(-1.0, 0.0, _GRID // 4)
    towards = -np.expm1(-np.linspace(0.0, _DEEPEST, _GRID))[1:]
    states = np.unique(np.concatenate([back, towards]))
    middle = 0.5 * (states[1:] + states[:-1])
    slope = np.where(
        middle < 0.0,
        1.0 + unloading * np.abs(middle) ** sharpness,
        -np.expm1(sharpness * np.log(np.maximum(middle, 1e-300))),
    )
    ways = np.concatenate([[0.0], np.cumsum(np.diff(states) / np.maximum(slope, 1e-16))])
    return _Flow(states, ways, states.tolist(), ways.tolist())
