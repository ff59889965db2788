"""Draws all plots of a session and saves them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from estimation.channel import ChannelData
from estimation.data.contact import find_contacts
from palpate.files import whole_file
from palpate.findings.estimation_run import ChannelEstimates
from palpate.views import style
from palpate.views.columns import Columns
from palpate.views.plots.force_displacement import force_displacement_figure
from palpate.views.plots.force_time import force_time_figure
from palpate.views.plots.residual import residual_figure
from palpate.views.plots.torque import torque_figure
from robot_io.types import FloatArray

NAMES = tuple(f"{name}.png" for name in ("force-displacement", "force-time", "residual", "torque"))


def save_plots(ticks: Columns | None, found: ChannelEstimates, folder: Path) -> list[Path]:
    """Save the plots of one probed place.

    Args:
        ticks: columns of the "tick" stream, None where no arm was there.
        found: its contact channel with estimates.
        folder: where to; it is there already.

    Returns:
        The files.

    Raises:
        InputError: a file cannot be written.
    """
    channel, prediction = found.channel, found.prediction()
    model = found.model.name.replace("_", "-").title()
    desired = desired_force(ticks, channel) if ticks is not None else None
    draw: dict[str, Callable[[], Figure]] = {
        "force-displacement": lambda: force_displacement_figure(channel, prediction, model),
        "force-time": lambda: force_time_figure(channel, desired, prediction),
        "residual": lambda: residual_figure(
            channel, channel.effort - prediction, found.rows, free_air_noise(channel)
        ),
    }
    if ticks is not None:
        draw["torque"] = lambda: torque_figure(ticks)
    return [_save(name, figure, folder) for name, figure in draw.items()]


def free_air_noise(channel: ChannelData) -> float | None:
    """Standard deviation of the force in free air [N]; None where it is not known what was free air."""
    if (channel.phase < 0).any():
        return None
    return float(np.median([c.noise_n for c in find_contacts(channel.effort, channel.run, channel.phase)]))


def desired_force(ticks: Columns, channel: ChannelData) -> FloatArray:
    """The force aimed at when each of the channel's samples was taken, shape (n,) [N]; NaN where free."""
    tick = np.searchsorted(ticks["time_s"], channel.time_s)
    desired: FloatArray = ticks["desired_force_n"][np.minimum(tick, len(ticks["time_s"]) - 1)]
    return desired


def _save(name: str, draw: Callable[[], Figure], folder: Path) -> Path:
    path = folder / f"{name}.png"
    with whole_file(path) as unfinished, style.house_style():
        draw().savefig(unfinished)
    return path
