"""The phases of a press, from its motion: approach, loading, hold, unloading, retract, free."""

import numpy as np
from scipy.ndimage import median_filter

from control.loop.phases import Phase
from estimation.data.press_runs import force_levels
from estimation.signals.blocks import blocks
from estimation.statistics.likeness import likeness
from robot_io.types import BoolArray, FloatArray, IntArray

_SLOW = 0.05  # of the usual speed, below which something is held
_SPRINGY = 0.5  # correlation of position and force: in free air they have nothing to do with each other
_LASTING = 9  # samples that decide together, so that noise makes no phases
_PHASES = np.array(  # of what is free and what is pressed, by the way it moves
    [
        [Phase.RETRACT, Phase.FREE_AIR, Phase.APPROACH],
        [Phase.UNLOADING, Phase.HOLD, Phase.LOADING],
    ],
    dtype=np.int64,
)


def press_phases(position: FloatArray, velocity: FloatArray, force: FloatArray, run: IntArray) -> IntArray:
    """Numbers of `control.loop.phases.Phase`, shape (n,).

    What is pressed is below the surface, if the displacement says where that is, or else has a force.

    Args:
        position: displacement, shape (n,), positive into the object.
        velocity: shape (n,).
        force: shape (n,), positive in compression.
        run: shape (n,), one block of samples for each run.
    """
    pressed = _pressed(position, force)
    moving = np.abs(velocity[np.abs(velocity) > 0.0])
    slow = _SLOW * float(np.quantile(moving, 0.9)) if len(moving) else 0.0
    way = (velocity > slow).astype(np.int8) - (velocity < -slow).astype(np.int8)
    phase = np.empty(len(position), dtype=np.int64)
    for rows in blocks(run):
        of_run = np.asarray(median_filter(way[rows], min(_LASTING, rows.stop - rows.start), mode="nearest"))
        touching = np.asarray(median_filter(pressed[rows].astype(np.int8), 3, mode="nearest"))
        phase[rows] = _PHASES[touching, of_run + 1]
    return phase


def _pressed(position: FloatArray, force: FloatArray) -> BoolArray:
    if position.min() <= 0.0:
        return np.asarray(position > 0.0)
    pressed = np.asarray(force > force_levels(force, position).released)
    if likeness(position[~pressed], force[~pressed]) > _SPRINGY:
        return np.ones(len(position), dtype=np.bool_)
    return pressed
