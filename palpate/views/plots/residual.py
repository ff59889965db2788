"""What the model leaves unexplained, over depth, with its distribution beside it."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimation.channel import ChannelData
from palpate.views import style
from palpate.views.runs import runs_by_speed
from robot_io.types import BoolArray, FloatArray

MILLI = 1e3
BINS = 41
WIDEST = 0.998  # share of the residuals that the vertical axis must show


def residual_figure(
    data: ChannelData, residuals: FloatArray, used: BoolArray, noise_n: float | None
) -> Figure:
    """Residual of each sample against its depth, coloured by speed.

    Args:
        data: contact channel, n samples.
        residuals: measured minus predicted (n,) [N].
        used: mask (n,) of the samples that the fit was made with; the others are not shown.
        noise_n: standard deviation of the sensor's own noise [N], drawn as a band; None where unknown.
    """
    figure = style.new_figure(8.2, 4.2)
    axes, side = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [4.5, 1], "wspace": 0.02})
    runs = runs_by_speed(data)
    for run in runs:
        rows = run.rows & used
        axes.plot(
            MILLI * data.position[rows],
            residuals[rows],
            ".",
            color=run.color,
            markersize=2.4,
            alpha=0.45,
            mew=0,
        )
    shown = residuals[used]
    reach = float(np.quantile(np.abs(shown), WIDEST)) if len(shown) else 1.0
    side.hist(
        shown,
        bins=np.linspace(-reach, reach, BINS),
        orientation="horizontal",
        color=style.MEASURED,
        alpha=0.65,
    )
    if noise_n:
        for panel in (axes, side):
            panel.axhspan(-2 * noise_n, 2 * noise_n, color=style.INK, alpha=0.06, linewidth=0)
    for panel in (axes, side):
        panel.axhline(0, color=style.INK, linewidth=0.9)
    axes.set(xlabel="displacement into the object  [mm]", ylabel="measured − model  [N]")
    axes.set_ylim(-1.15 * reach, 1.15 * reach)
    side.set(xlabel="samples")
    side.grid(visible=False)
    handles = [Line2D([], [], color=run.color, marker="o", linewidth=0, label=run.label) for run in runs]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    style.title(figure, "What the model leaves unexplained", _remark(shown, noise_n))
    return figure


def _remark(shown: FloatArray, noise_n: float | None) -> str:
    rms = float(np.sqrt(np.mean(shown**2))) if len(shown) else float("nan")
    band = (
        f"; the grey band is ±2 standard deviations of the sensor's noise ({noise_n:.3f} N)"
        if noise_n
        else ""
    )
    return f"rms {rms:.3f} N{band}"
