"""The error in held-out runs, falling stage by stage to the noise floor."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from estimation.revision import Revision
from palpate.files import whole_file
from palpate.views import style

BESIDE = 0.012  # of the axis, between a bar and its number
ROOM = 1.16  # of the largest error, for its number


def waterfall_figure(channel: str, unit: str, stages: Sequence[Revision]) -> Figure:
    """One bar a stage; what the stage took away is hatched behind it.

    Args:
        channel: what to call it.
        unit: of the errors.
        stages: from the base model on.
    """
    figure = style.new_figure(7.6, 1.5 + 0.46 * len(stages))
    axes = figure.subplots()
    errors = [stage.rmse for stage in stages]
    floor, reach = stages[-1].noise_floor, ROOM * max(errors)
    for row, error in enumerate(errors):
        before = errors[row - 1] if row else error
        if before > error:
            axes.barh(row, before - error, left=error, height=0.52, color=style.RULE, linewidth=0)
        color = style.COMMANDED if row == 0 else style.MEASURED
        axes.barh(row, error, height=0.52, color=color, linewidth=0)
        fall = f"   −{100 * (1 - error / before):.0f} %" if before > error else ""
        place = max(error, before) + BESIDE * reach
        axes.text(place, row, f"{error:.3g} {unit}{fall}", va="center", size=9, color=style.INK)
    axes.axvline(floor, color=style.TRUTH, linewidth=1.1, dashes=(2, 2))
    axes.text(floor, -0.62, f" noise floor {floor:.3g} {unit}", color=style.TRUTH, size=8.5, va="center")
    names = [f"+ {stage.added}" if stage.added else stage.model.name for stage in stages]
    axes.set_yticks(np.arange(len(stages)), names)
    axes.set(xlabel=f"error in held-out runs  [{unit}]", xlim=(0, reach), ylim=(len(stages) - 0.5, -0.9))
    axes.grid(visible=False, axis="y")
    style.title(figure, f"How the error falls: {channel}", _remark(stages, floor))
    return figure


def save_waterfall(channel: str, unit: str, stages: Sequence[Revision], path: Path) -> None:
    """Draw and save it as PNG.

    Raises:
        InputError: the file cannot be written.
    """
    with whole_file(path) as unfinished, style.house_style():
        waterfall_figure(channel, unit, stages).savefig(unfinished)


def _remark(stages: Sequence[Revision], floor: float) -> str:
    if len(stages) == 1:
        return "The base model alone; each run is predicted from the others"
    times = stages[0].rmse / floor if floor > 0 else float("inf")
    ends = stages[-1].rmse / floor if floor > 0 else float("inf")
    return f"From {times:.1f} to {ends:.2f} times the noise floor; each run is predicted from the others"
