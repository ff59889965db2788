"""What the model leaves unexplained, over depth, with its distribution beside it."""

import numpy as np
from matplotlib.figure import Figure

from estimation.channel import ChannelData
from palpate.views import style
from palpate.views.runs import legend_of, runs_by_speed
from robot_io.types import BoolArray, FloatArray

MILLI = 1e3
BINS = 41
WIDEST = 0.998  # share of the residuals that the vertical axis must show
MARGIN = 0.08
MARKER = 2.6  # [points]


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
            markersize=MARKER,
            alpha=0.45,
            mew=0,
        )
    shown = residuals[used]
    lowest, highest = _reach(shown)
    bins = np.linspace(lowest, highest, BINS)
    side.hist(shown, bins=bins, orientation="horizontal", color=style.MEASURED, alpha=0.65)
    if noise_n:
        for panel in (axes, side):
            panel.axhspan(-2 * noise_n, 2 * noise_n, color=style.INK, alpha=0.06, linewidth=0)
    for panel in (axes, side):
        panel.axhline(0, color=style.INK, linewidth=0.9)
    axes.set(xlabel="displacement into the object  [mm]", ylabel="measured − model  [N]")
    axes.set_ylim(lowest, highest)
    side.set(xlabel="samples")
    side.grid(visible=False)
    handles = legend_of(runs, marker="o", linewidth=0)
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    style.title(figure, "What the model leaves unexplained", _remark(shown, noise_n))
    return figure


def _reach(shown: FloatArray) -> tuple[float, float]:
    """Vertical range that holds nearly all of the residuals, and zero."""
    if not len(shown):
        return -1.0, 1.0
    lowest, highest = np.quantile(shown, [(1 - WIDEST) / 2, (1 + WIDEST) / 2]).tolist()
    margin = max(MARGIN * (highest - lowest), 1e-9)
    return min(lowest, 0.0) - margin, max(highest, 0.0) + margin


def _remark(shown: FloatArray, noise_n: float | None) -> str:
    rms = float(np.sqrt(np.mean(shown**2))) if len(shown) else float("nan")
    band = (
        f"; the grey band is ±2 standard deviations of the sensor's noise ({noise_n:.3f} N)"
        if noise_n
        else ""
    )
    return f"rms {rms:.3f} N{band}"
