"""Bouc-Wen hysteresis along a path, exact between reversals for any step size."""

from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimation.signals.blocks import block_index
from robot_io.types import FloatArray, IntArray

_DEEPEST = 36.0  # -log(1 - w) at which w is 1 to the last digit
_GRID = 3000


def bouc_wen(
    position: FloatArray, run: IntArray, path: float, sharpness: float, unloading: float
) -> FloatArray:
    """Compute the Bouc-Wen state w, from 0 at the start of each run.

    Along the direction of motion dw/dx = (1 - w^n) / path while w grows away from zero, and
    (1 + unloading |w|^n) / path while it goes back. With n = 1 and unloading = 1 it is Dahl's friction.

    Args:
        position: shape (n,).
        run: run of each sample.
        path: over which w builds up, in the unit of position.
        sharpness: n.
        unloading: 0 for a straight return, 1 for one that begins twice as steep.

    Returns:
        State in [-1, 1], shape (n,).
    """
    first, number = block_index(run)
    steps = np.diff(position, prepend=position[:1]) / path
    steps[first] = 0.0
    if not len(steps):
        return steps
    sign = np.where(steps >= 0.0, 1.0, -1.0)
    starts, piece = block_index(2 * number + (sign > 0.0))
    way = np.cumsum(np.abs(steps))
    way -= np.concatenate([[0.0], way[starts[1:] - 1]])[piece]
    flow = _flow(sharpness, unloading)
    initial = np.empty(len(starts))
    ends = np.append(starts[1:], len(steps)) - 1
    is_new_run = np.append(True, np.diff(run[starts]) != 0)
    state = 0.0
    for i, (side, length, is_new) in enumerate(
        zip(sign[starts].tolist(), way[ends].tolist(), is_new_run.tolist(), strict=True)
    ):
        initial[i] = _interpolate(0.0 if is_new else side * state, flow.states_listed, flow.ways_listed)
        state = side * _interpolate(initial[i] + length, flow.ways_listed, flow.states_listed)
    return np.asarray(sign * np.interp(initial[piece] + way, flow.ways, flow.states))


def _interpolate(at: float, points: list[float], values: list[float]) -> float:
    """Do the work of `np.interp` for a single number, without the cost of calling NumPy."""
    right = bisect_right(points, at)
    if right == 0 or right == len(points):
        return values[min(right, len(points) - 1)]
    left = right - 1
    share = (at - points[left]) / (points[right] - points[left])
    return values[left] + share * (values[right] - values[left])


@dataclass(frozen=True)
class _Flow:
    """States w from -1 to 1 and the path from -1 to each, as arrays and as lists."""

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
