"""Contact force against displacement, one curve a speed (the paper's figure 4a)."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimation.channel import ChannelData
from palpate.views import style
from palpate.views.runs import legend_of, runs_by_speed
from robot_io.types import FloatArray

MILLI = 1e3
NEAR_SHARE = 0.35  # how far before the touch the picture begins, as a share of the greatest depth


def force_displacement_figure(data: ChannelData, prediction: FloatArray | None, model: str) -> Figure:
    """Measured loops, coloured from slow to fast, with what the model makes of the same motion.

    Args:
        data: contact channel, n samples; displacement counted from the surface.
        prediction: the model's force (n,), or None for the measurement alone.
        model: what to call the prediction.
    """
    figure = style.new_figure(7.2, 5.0)
    axes = figure.subplots()
    depth_mm = MILLI * data.position
    runs = runs_by_speed(data)
    for run in runs:
        axes.plot(depth_mm[run.rows], data.effort[run.rows], color=run.color, linewidth=1.3, alpha=0.85)
    if prediction is not None:
        for run in runs:
            axes.plot(depth_mm[run.rows], prediction[run.rows], color=style.INK, linewidth=1.0, dashes=(4, 2))
    deepest_mm = float(np.max(depth_mm, initial=1e-3))
    nearest_mm = max(-NEAR_SHARE * deepest_mm, float(np.min(depth_mm, initial=0.0)) - 0.03 * deepest_mm)
    axes.set_xlim(nearest_mm, 1.03 * deepest_mm)
    axes.set(xlabel="displacement into the object  [mm]", ylabel="contact force  [N]")
    handles = legend_of(runs, linewidth=2)
    if prediction is not None:
        handles.append(Line2D([], [], color=style.INK, dashes=(4, 2), linewidth=1, label=model))
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    style.title(
        figure,
        "Force against displacement",
        _remark(len({run.color for run in runs}), prediction is not None, model),
    )
    return figure


def _remark(color_count: int, has_model: bool, model: str) -> str:
    text = "Coloured: measured, one colour a speed or run." if color_count > 1 else "Coloured: measured."
    return text + (f"  Dashed: {model}, fitted to all runs." if has_model else "")
