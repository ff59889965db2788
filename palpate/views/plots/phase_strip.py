"""A thin band under the curves that says what the arm was doing."""

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from palpate.views import style
from robot_io.types import FloatArray, IntArray

LEAST_SHARE = 0.002  # of the samples, below which a phase is too thin to be seen


def stretches(values: IntArray) -> list[tuple[int, int]]:
    """Half-open index ranges (first, past the last) in which `values` stays the same."""
    if not len(values):
        return []
    edges = np.flatnonzero(np.diff(values)) + 1
    bounds = [0, *edges.tolist(), len(values)]
    return list(pairwise(bounds))


def draw_phase_strip(axes: Axes, time_s: FloatArray, phase: IntArray) -> None:
    """Fill `axes` with one coloured stretch a phase, and name the colours below.

    Args:
        axes: low and wide; its horizontal axis is time.
        time_s: shape (n,), in the units of the axis.
        phase: shape (n,), numbers of `Phase`.
    """
    for first, past in stretches(phase):
        end = time_s[min(past, len(time_s) - 1)]
        axes.axvspan(time_s[first], end, color=style.phase_color(int(phase[first])), linewidth=0)
    hide_strip(axes)


def hide_strip(axes: Axes) -> None:
    """Leave only the labels of the horizontal axis."""
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def phase_legend(phase: IntArray) -> list[Patch]:
    """One coloured square a phase that can be seen, in the order of the phases' numbers."""
    phases, counts = np.unique(phase, return_counts=True)
    seen = phases[counts >= LEAST_SHARE * len(phase)].tolist()
    return [Patch(color=style.phase_color(p), label=style.phase_name(p)) for p in seen]
