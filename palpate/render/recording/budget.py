"""An error budget in Rerun: a stacked bar, a bar with its range for each part, and all in words."""

import rerun as rr
import rerun.blueprint as rrb

from palpate.render import palette
from palpate.render.recording.chart import label
from palpate.render.recording.stream import BACKGROUND
from palpate.render.view import BudgetPart, BudgetView

_WIDTH = 160.0  # of a share of 1, in the view's own units
_STACK, _ROW = 14.0, 13.0  # heights of the stacked bar and of a row
_NAMES = -62.0  # left end of the rows' names
_STEP = 0.5  # between the lines that fill a bar: Rerun only outlines boxes
_THICK = 5.0  # of a row's bar
_INK = "#bec8d2"


def log_budget(recording: rr.RecordingStream, entity: str, budget: BudgetView) -> None:
    """Log an error budget, the same at all times."""
    total = sum(max(part.share, 0.0) for part in budget.parts) or 1.0
    left = 0.0
    for number, part in enumerate(budget.parts):
        right = left + max(part.share, 0.0) / total * _WIDTH
        _fill(recording, f"{entity}/chart/stack/{number}", (left, right), (0.0, _STACK), part.color)
        left = right
        _log_row(recording, f"{entity}/chart/row/{number}", _STACK + (number + 1) * _ROW, part)
    words = rr.TextDocument(_words(budget), media_type=rr.MediaType.MARKDOWN)
    recording.log(f"{entity}/words", words, static=True)


def _log_row(recording: rr.RecordingStream, entity: str, y: float, part: BudgetPart) -> None:
    """Name and share of a part; its bar, and a line from the necessary to the sufficient share."""
    name = label((_NAMES / 2, y - 3.5), f"{part.word} {part.share_text}", _INK)
    recording.log(f"{entity}/name", name, static=True)
    end = max(part.share, 0.0) * _WIDTH
    _fill(recording, f"{entity}/bar", (0.0, end), (y - _THICK / 2, y + _THICK / 2), part.color)
    if part.necessary is not None and part.sufficient is not None:
        ends = [[_WIDTH * share, y + _THICK / 2 + 1.5] for share in (part.necessary, part.sufficient)]
        line = rr.LineStrips2D([ends], colors=palette.rgb(part.color), radii=rr.Radius.ui_points(1.0))
        recording.log(f"{entity}/range", line, static=True)


def _fill(
    recording: rr.RecordingStream,
    entity: str,
    x: tuple[float, float],
    y: tuple[float, float],
    color: str,
) -> None:
    count = max(round((y[1] - y[0]) / _STEP), 1)
    heights = [y[0] + (place + 0.5) * _STEP for place in range(count)]
    lines = [[[x[0], height], [x[1], height]] for height in heights]
    filled = rr.LineStrips2D(lines, colors=palette.rgb(color), radii=_STEP / 2 + 0.05)
    recording.log(entity, filled, static=True)


def _words(budget: BudgetView) -> str:
    lines = ["### Error budget", budget.sentence, ""]
    lines += ["| kind | share | 95 % interval | necessary to sufficient | form | effects |", "|---" * 6 + "|"]
    for part in budget.parts:
        interval = f"{100 * part.interval[0]:.0f} to {100 * part.interval[1]:.0f} %" if part.interval else ""
        cells = part.word, part.share_text, interval, part.range_text, part.form, part.effects_text
        lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        "Shares of the base model's squared error in held-out runs. The line below a bar goes from ",
    ]
    lines[-1] += "what only this kind explains to what it explains alone."
    return "\n".join([*lines, *(f"\n{confusion}" for confusion in budget.confusions)])


def budget_tab(entity: str, name: str) -> rrb.Horizontal:
    """The tab of an error budget."""
    frame = rrb.VisualBounds2D(x_range=[_NAMES - 8.0, _WIDTH + 8.0], y_range=[-8.0, _STACK + 9 * _ROW])
    background = rrb.Background(color=BACKGROUND)
    chart = rrb.Spatial2DView(
        origin=f"{entity}/chart", name="Shares", visual_bounds=frame, background=background
    )
    words = rrb.TextDocumentView(origin=f"{entity}/words", name="In words")
    return rrb.Horizontal(chart, words, column_shares=[3, 2], name=name)
