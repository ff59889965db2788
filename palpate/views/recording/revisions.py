"""A model growing stage by stage, on a timeline of revisions: curves, residual, error bars, words."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from estimation.channel import ChannelData
from palpate.findings.story import Story
from palpate.views import colors
from palpate.views.quantities import quantities_of
from palpate.views.recording.chart import HEIGHT, WIDTH, Chart, span_of
from palpate.views.recording.entities import REVISION
from palpate.views.recording.file import recording_file
from palpate.views.time_axis import one_after_the_other
from palpate.words import significant
from robot_io.types import FloatArray, IntArray

FIRST: colors.Color = (112, 122, 134)  # revision 0, which stays beside the newest
MOST_POINTS = 4000
SIGMAS_95 = 1.96
BAR_WIDTH = 24.0
BAR_LINE = 0.6  # height of the lines that fill a bar
WIDE = 300.0


def write_revisions(name: str, stories: Sequence[Story], path: Path) -> None:
    """Write the recording; the file appears whole or not at all.

    Args:
        name: what to call it.
        stories: channels with at least one stage each.
        path: the .rrd file.

    Raises:
        InputError: the file cannot be written.
    """
    with recording_file(f"{name} revisions", path, _blueprint(stories)) as recording:
        for story in stories:
            _log_story(recording, story)


def _log_story(recording: rr.RecordingStream, story: Story) -> None:
    data, names = story.subject.channel, quantities_of(story.subject.channel)
    where, stages, rows = data.name, story.stages, _rows(data)
    time_s = one_after_the_other(data)
    residuals = np.concatenate([stages[0].residual, stages[-1].residual])
    position = names.scale * data.position
    reach = span_of(np.concatenate([data.effort, stages[0].predicted]))
    curve = Chart(f"{where}/effort", span_of(time_s, 0.0), reach, "time [s]", names.effort, WIDE)
    loop = Chart(f"{where}/loop", span_of(position[data.engaged]), reach, names.position, names.effort)
    left = f"measured − model [{names.effort_unit}]"
    state = Chart(
        f"{where}/residual", span_of(position[data.engaged]), span_of(residuals), names.position, left
    )
    for chart in (curve, loop, state):
        chart.draw_frame(recording)
    pressed = [run[data.engaged[run]] for run in rows]

    def along(x: FloatArray, y: FloatArray, parts: Sequence[IntArray]) -> list[tuple[FloatArray, FloatArray]]:
        return [(x[part], y[part]) for part in parts]

    def static(entity: str, strips: rr.LineStrips2D) -> None:
        recording.log(f"{where}/{entity}", strips, static=True)

    static("effort/a_measured", curve.strips(along(time_s, data.effort, rows), colors.MEASURED, 3.5))
    static("loop/a_measured", loop.strips(along(position, data.effort, pressed), colors.MEASURED, 3.5))
    static("residual/a_first", state.strips(along(position, stages[0].residual, pressed), FIRST, 1.2))
    for number, stage in enumerate(stages):
        recording.set_time(REVISION, sequence=number)
        model = stage.predicted
        recording.log(
            f"{where}/effort/model", curve.strips(along(time_s, model, rows), colors.COMMANDED, 1.4)
        )
        recording.log(
            f"{where}/loop/model", loop.strips(along(position, model, pressed), colors.COMMANDED, 1.4)
        )
        recording.log(
            f"{where}/residual/now",
            state.strips(along(position, stage.residual, pressed), colors.DESIRED, 1.2),
        )
        recording.log(f"{where}/words", rr.TextDocument(_words(story, number), media_type="text/markdown"))
    recording.reset_time()
    _log_bars(recording, story)


def _log_bars(recording: rr.RecordingStream, story: Story) -> None:
    """The error of each revision beside that of revision 0, over the noise floor."""
    where, stages = f"{story.subject.channel.name}/error", story.stages
    unit = story.subject.channel.kind.effort_unit
    reach = 1.16 * max(stage.rmse for stage in stages)
    chart = Chart(where, (0.0, WIDTH), (0.0, reach), "", f"held-out error [{unit}]")
    chart.draw_scale(recording)
    floor = stages[-1].noise_floor
    line = chart.strips([(np.array([0.0, WIDTH]), np.array([floor, floor]))], colors.FINAL, 2.0)
    recording.log(f"{where}/floor", line, static=True)
    label = rr.Points2D(
        [[WIDTH - 18.0, chart.place(np.zeros(1), np.array([floor]))[0, 1] - 9.0]],
        labels=[f"noise floor {floor:.3g}"],
        colors=colors.FINAL,
        radii=0.0,
        show_labels=True,
    )
    recording.log(f"{where}/floor_word", label, static=True)
    _bar(recording, f"{where}/first", chart, 42.0, stages[0].rmse, f"revision 0: {stages[0].rmse:.3g}")
    for number, stage in enumerate(stages):
        recording.set_time(REVISION, sequence=number)
        text = f"revision {number}: {stage.rmse:.3g}"
        _bar(recording, f"{where}/now", chart, 92.0, stage.rmse, text)
    recording.reset_time()


def _bar(  # noqa: PLR0917, what a bar is drawn from
    recording: rr.RecordingStream, entity: str, chart: Chart, middle: float, error: float, text: str
) -> None:
    """A bar from zero to the error with its words; filled with lines, since boxes are only outlined."""
    top = float(chart.place(np.zeros(1), np.array([error]))[0, 1])
    color = FIRST if entity.endswith("first") else colors.MEASURED
    static = entity.endswith("first")
    left, right = middle - BAR_WIDTH / 2, middle + BAR_WIDTH / 2
    heights = np.linspace(HEIGHT, top, max(2, round((HEIGHT - top) / BAR_LINE)))
    lines = [[[left, height], [right, height]] for height in heights]
    recording.log(entity, rr.LineStrips2D(lines, colors=color, radii=BAR_LINE / 2 + 0.1), static=static)
    word = rr.Points2D([[middle, top - 9.0]], labels=[text], colors=color, radii=0.0, show_labels=True)
    recording.log(f"{entity}/word", word, static=static)


def _words(story: Story, number: int) -> str:
    stages, unit = story.stages, story.subject.channel.kind.effort_unit
    stage = stages[number]
    added = f"added **{stage.added}**" if stage.added else "the base model"
    lines = [f"### Revision {number}: {stage.model.name}", f"{added}", ""]
    lines += [
        f"held-out error **{stage.rmse:.4g} {unit}**, noise floor {stages[-1].noise_floor:.4g} {unit}",
        "",
    ]
    lines += [f"`{effect.name}` {effect.equation}  " for effect in stage.model.effects]
    lines += ["", "| parameter | value | ± 95 % | unit |", "|---|---|---|---|"]
    for name, found in stage.parameters.items():
        half = SIGMAS_95 * found.std_err
        known = bool(np.isfinite(half))
        value = significant(found.value, half if known else None)
        lines.append(f"| {name} | {value} | {significant(half, half) if known else '?'} | {found.unit} |")
    return "\n".join(lines)


def _rows(data: ChannelData) -> list[IntArray]:
    """Samples of each run that are drawn."""
    step = max(1, len(data) // MOST_POINTS)
    return [np.flatnonzero(data.run == run)[::step] for run in data.runs]


def _blueprint(stories: Sequence[Story]) -> rrb.Blueprint:
    tabs = [_tab(story.subject.channel.name) for story in stories]
    return rrb.Blueprint(
        rrb.Tabs(*tabs),
        rrb.TimePanel(state="collapsed", timeline=REVISION, play_state="paused"),
        collapse_panels=True,
    )


def _tab(channel: str) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.Vertical(
            _view(f"{channel}/effort", "Measured (blue) and model (amber)", WIDE),
            rrb.Horizontal(
                _view(f"{channel}/loop", "Over the state"),
                _view(f"{channel}/residual", "What is left: revision 0 grey, now red"),
            ),
            row_shares=[1, 1],
        ),
        rrb.Vertical(
            _view(f"{channel}/error", "Error in held-out runs"),
            rrb.TextDocumentView(origin=f"{channel}/words", name="This revision"),
            row_shares=[1, 1],
        ),
        column_shares=[2, 1],
        name=channel,
    )


def _view(origin: str, name: str, width: float = WIDTH) -> rrb.Spatial2DView:
    frame = rrb.VisualBounds2D(x_range=[-16.0, width + 6.0], y_range=[-14.0, HEIGHT + 18.0])
    return rrb.Spatial2DView(
        origin=origin, name=name, visual_bounds=frame, background=rrb.Background(color=colors.BACKGROUND)
    )
