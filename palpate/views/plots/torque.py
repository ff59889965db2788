"""Commanded and measured joint torques over time (the paper's figure 3a)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.views import style
from palpate.views.columns import Columns
from palpate.views.plots.phase_strip import draw_phase_strip, phase_legend
from robot_io.types import FloatArray

PANEL_IN = 1.45
STRIP_IN = 0.16


def torque_figure(ticks: Columns) -> Figure:
    """One panel a joint: commanded as a broad grey line, measured as a coloured one on top.

    Args:
        ticks: columns of the "tick" stream, n rows.
    """
    time_s = ticks["time_s"] - ticks["time_s"][0]
    measured, commanded = ticks["torque_measured_nm"], ticks["torque_sent_nm"]
    joints = measured.shape[1]
    figure = style.new_figure(9.0, 1.75 + PANEL_IN * joints)
    panels = figure.subplots(
        joints + 1, 1, sharex=True, gridspec_kw={"height_ratios": [PANEL_IN] * joints + [STRIP_IN]}
    )
    difference = measured - _in_force(ticks)
    for joint in range(joints):
        _draw_joint(panels[joint], time_s, measured[:, joint], commanded[:, joint], joint)
        rms = float(np.sqrt(np.nanmean(difference[:, joint] ** 2)))
        panels[joint].set_title(
            f"rms difference {rms:.3f} N m", loc="right", size=8.5, weight="normal", color=style.MUTED
        )
    draw_phase_strip(panels[-1], time_s, ticks["phase"])
    panels[-1].set(xlabel="time  [s]", xlim=(time_s[0], time_s[-1]))
    figure.align_ylabels(panels[:-1])
    figure.legend(
        handles=phase_legend(ticks["phase"]),
        loc="outside lower center",
        ncols=9,
        fontsize=8.5,
        handlelength=1,
    )
    style.title(figure, "Joint torques", "Coloured: measured at the drives.  Broad and grey: commanded.")
    return figure


def _in_force(ticks: Columns) -> FloatArray:
    """The command that held when each torque was sampled, shape (n, joints) [N m]; NaN before the first.

    What is read in a tick was sampled before that tick's own command went out.
    """
    tick_before = np.arange(len(ticks["time_s"])) - 1
    newest = np.searchsorted(ticks["time_s"], ticks["torque_at_s"], side="right") - 1
    held = np.minimum(tick_before, newest)
    sent: FloatArray = np.where(held[:, None] >= 0, ticks["torque_sent_nm"][held], np.nan)
    return sent


def _draw_joint(
    axes: Axes, time_s: FloatArray, measured: FloatArray, commanded: FloatArray, joint: int
) -> None:
    axes.plot(time_s, commanded, color=style.COMMANDED, linewidth=3.6)
    axes.plot(time_s, measured, color=style.joint_color(joint), linewidth=0.9)
    axes.set_ylabel(f"joint {joint + 1}  [N m]")
    axes.margins(y=0.1)
