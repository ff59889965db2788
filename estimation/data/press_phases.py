"""The phases of a press, from its motion: approach, loading, hold, unloading, retract, free."""

import numpy as np
import scipy

from control.loop.task import Phase
from estimation.data.press_runs import force_levels
from estimation.signals.blocks import blocks
from estimation.statistics.correlation import correlation_coefficient
from robot_io.types import BoolArray, FloatArray, IntArray

_SLOW = 0.05  # of the usual speed, below which something is held
_EDGE = 0.5  # of the usual speed, which a smoothed velocity has where the motion begins
_SPRINGY = 0.5  # correlation of position and force: in free air they have nothing to do with each other
_LASTING = 9  # samples that decide together, so that noise makes no phases
_PHASES = np.array(  # of what is free and what is pressed, by the way it moves
    [
        [Phase.RETRACT, Phase.FREE_AIR, Phase.APPROACH],
        [Phase.UNLOADING, Phase.HOLD, Phase.LOADING],
    ],
    dtype=np.int64,
)


def press_phases(
    position: FloatArray,
    velocity: FloatArray,
    force: FloatArray,
    run: IntArray,
    pressed: BoolArray | None = None,
) -> IntArray:
    """Numbers of `control.loop.task.Phase`, shape (n,).

    What is pressed is below the surface, if the displacement says where that is, or else has a force.

    Args:
        position: displacement, shape (n,), positive into the object.
        velocity: shape (n,).
        force: shape (n,), positive in compression.
        run: shape (n,), one block of samples for each run.
        pressed: where something is pressed or pulled, shape (n,); None to find out.
    """
    if pressed is None:
        pressed = _pressed(position, force)
    usual = _usual(velocity)
    moves = np.abs(velocity) > _SLOW * usual
    # A velocity that was derived over many samples begins before the motion, and ends after it.
    change = np.concatenate([_change(position[rows]) for rows in blocks(run)])
    moves &= (np.abs(velocity) > _EDGE * usual) | (change > _SLOW * _usual(change))
    way = np.sign(velocity).astype(np.int8) * moves
    phase = np.empty(len(position), dtype=np.int64)
    for rows in blocks(run):
        of_run = np.asarray(
            scipy.ndimage.median_filter(way[rows], min(_LASTING, rows.stop - rows.start), mode="nearest")
        )
        touching = np.asarray(scipy.ndimage.median_filter(pressed[rows].astype(np.int8), 3, mode="nearest"))
        phase[rows] = _PHASES[touching, of_run + 1]
    return phase


def _usual(signal: FloatArray) -> float:
    """Size of a signal (n,) where there is one."""
    there = np.abs(signal[signal != 0.0])
    return float(np.quantile(there, 0.9)) if len(there) else 0.0


def _change(position: FloatArray) -> FloatArray:
    """How far it is from some samples before, and to some after each one of a run, the less; shape (n,)."""
    half = _LASTING // 2
    padded = np.pad(position, half, mode="reflect", reflect_type="odd")  # as if the motion went on
    before, after = position - padded[: -2 * half], padded[2 * half :] - position
    return np.asarray(np.minimum(np.abs(before), np.abs(after)))


def _pressed(position: FloatArray, force: FloatArray) -> BoolArray:
    if position.min() <= 0.0:
        return np.asarray(position > 0.0)
    pressed = np.asarray(force > force_levels(force, position).released)
    if correlation_coefficient(position[~pressed], force[~pressed]) > _SPRINGY:
        return np.ones(len(position), dtype=np.bool_)
    return pressed
