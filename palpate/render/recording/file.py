"""Recording files of Rerun: write them, open a window, and take screenshots."""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from palpate.common.files import atomic_write
from palpate.render import palette
from palpate.render.recording.rerun_modules import experimental, rerun_cli, rr, rrb
from palpate.robot_io.errors import PalpateError
from palpate.robot_io.files.atomic_write import replace_undecodable
from palpate.robot_io.types import FloatArray

TIME, REVISION = "time", "revision"  # timelines
BACKGROUND = (24, 29, 36)
Line = tuple[FloatArray, str, float]  # values (n,), color, width in points


@contextmanager
def recording_file(name: str, path: Path, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Open a new .rrd file for writing.

    Args:
        name: name of the recording.
        path: the file; replaced if it exists.
        blueprint: layout of the recording.

    Raises:
        InputError: the file cannot be written.
    """
    # Write to memory first, then to the disk, because Rerun's writer hangs if the disk is full.
    with atomic_write(path) as unfinished:
        unfinished.touch()  # checks the folder before the work begins
        name = replace_undecodable(name)
        recording = rr.RecordingStream("palpate", recording_id=name)
        memory = recording.memory_recording()
        recording.send_blueprint(blueprint)
        recording.send_recording_name(name)
        try:
            yield recording
        finally:  # after a failure too, because Rerun would warn about unused data
            content = memory.drain_as_bytes()
        unfinished.write_bytes(content or b"")


def time_column(time_s: FloatArray) -> list[rr.TimeColumn]:
    """Return the timeline of a session.

    Args:
        time_s: shape (n,) [s].
    """
    return [rr.TimeColumn(TIME, duration=time_s)]


def send_lines(
    recording: rr.RecordingStream,
    entity: str,
    index: FloatArray | list[rr.TimeColumn],
    lines: Mapping[str, Line],
) -> None:
    """Send several curves as one entity at once.

    Args:
        recording: destination.
        entity: path of the entity.
        index: times (n,) [s], or the n places on another timeline.
        lines: values (n,), color and width of each curve, by its name in the legend.
    """
    colors = [palette.rgb(color) for _, color, _ in lines.values()]
    widths = [width for *_, width in lines.values()]
    look = rr.SeriesLines(names=list(lines), colors=colors, widths=widths)
    recording.log(entity, look, static=True)
    index = time_column(index) if isinstance(index, np.ndarray) else index
    scalars = np.column_stack([values for values, *_ in lines.values()])
    recording.send_columns(entity, indexes=index, columns=rr.Scalars.columns(scalars=scalars))


def markdown(text: str) -> rr.TextDocument:
    """Return a text with Markdown's formatting."""
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def plot(
    origin: str, name: str, span: tuple[float, float] | None = None, legend: rrb.Corner2D | None = None
) -> rrb.TimeSeriesView:
    """Make a plot over the whole time range.

    Args:
        origin: path of the entity.
        name: title of the plot.
        span: range of the vertical axis; None to fit all values.
        legend: corner of the legend; None for no legend.
    """
    axis = rrb.ScalarAxis(range=span) if span else None
    shown = rrb.PlotLegend(legend) if legend else rrb.PlotLegend(visible=False)
    endless = rr.TimeRangeBoundary.infinite()
    whole_time = rrb.TimeAxis(view_range=rr.TimeRange(start=endless, end=endless))
    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=whole_time, axis_y=axis, plot_legend=shown)


def shown_on(*contents: rrb.Container | rrb.View, timeline: str) -> rrb.Blueprint:
    """Make a blueprint of tabs without extra panels; a timeline of revisions starts at the last one."""
    # the view stays at the end of the timeline
    play: Literal["following", "paused"] = "following" if timeline == REVISION else "paused"
    panel = rrb.TimePanel(state="collapsed", timeline=timeline, play_state=play)
    return rrb.Blueprint(rrb.Tabs(*contents), panel, collapse_panels=True)


_HOST = "127.0.0.1"  # Rerun's default would listen on all addresses of the machine
_START_LIMIT_S = 30.0
_POLL_S = 0.1
_DRIVER = "without a Vulkan driver, try: apt install mesa-vulkan-drivers"
_SETTLE_S = 2.0  # curves and meshes load gradually
_TOAST_S = 7.0  # the viewer first shows a notification in its upper right corner


def capture_screenshot(
    recording: Path, picture: Path, time_s: float, size: tuple[int, int], *, revision: int | None = None
) -> None:
    """Save what the viewer shows at a moment as PNG; needs a Vulkan driver, but no display.

    Args:
        recording: .rrd file.
        picture: .png file, replaced if it exists; it appears completely or not at all.
        time_s: moment on the session's timeline [s].
        size: width and height in pixels.
        revision: stage to show instead, in a recording of revisions.

    Raises:
        PalpateError: the viewer could not be started or did not answer.
        InputError: the picture cannot be written.
    """

    def is_loaded() -> bool:
        state = viewer.get_state()
        return bool(state.active_recording) and not state.loading

    started_s = time.monotonic()
    with (
        TemporaryDirectory() as folder,
        atomic_write(picture) as unfinished,
        _headless_viewer(size) as viewer,
    ):
        # The viewer accepts UTF-8 names only.
        shown, taken = Path(folder, "shown.rrd"), Path(folder, "taken.png")
        shown.symlink_to(recording.absolute())
        try:
            viewer.open(str(shown))
            _wait_for(is_loaded, "the Rerun viewer did not load the recording")
            if revision is None:
                viewer.set_time(TIME, duration=time_s, play_state="paused")
            else:
                viewer.set_time(REVISION, sequence=revision, play_state="paused")
            time.sleep(max(_SETTLE_S, _TOAST_S - (time.monotonic() - started_s)))
            viewer.save_screenshot(str(taken))
        except (OSError, RuntimeError, ValueError) as error:
            reason = str(error).partition("\n")[0] or type(error).__name__
            raise PalpateError(f"the viewer returned no picture: {reason} ({_DRIVER})") from error
        if not taken.is_file():
            raise PalpateError(f"the viewer did not write {picture}")
        unfinished.write_bytes(taken.read_bytes())


@contextmanager
def _headless_viewer(size: tuple[int, int]) -> Iterator[experimental.ViewerClient]:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port = probe.getsockname()[1]
    window = f"{size[0]}x{size[1]}"
    process = start_viewer(
        "--headless", "--hide-welcome-screen", "--port", str(port), "--window-size", window
    )
    clients: list[experimental.ViewerClient] = []

    def connected() -> bool:
        if process.poll() is not None:
            raise PalpateError(f"the Rerun viewer ended at once ({_DRIVER})")
        try:
            client = experimental.ViewerClient.connect(f"rerun+http://{_HOST}:{port}/proxy")
            client.get_state()
        except (OSError, RuntimeError):
            return False
        clients.append(client)
        return True

    try:
        _wait_for(connected, f"the Rerun viewer did not start without a display ({_DRIVER})")
        yield clients[0]
    finally:
        process.terminate()
        try:
            process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_for(is_done: Callable[[], bool], failure: str) -> None:
    give_up_s = time.monotonic() + _START_LIMIT_S
    while not is_done():
        if time.monotonic() > give_up_s:
            raise PalpateError(failure)
        time.sleep(_POLL_S)


def start_viewer(*arguments: str, detached: bool = False) -> subprocess.Popen[bytes]:
    """Start Rerun's viewer.

    Args:
        arguments: its options, and recordings to show.
        detached: whether it outlives this program.

    Raises:
        PalpateError: its program cannot be started.
    """
    program = Path(rerun_cli.__file__).parent / "rerun"
    environment = os.environ | {"RERUN_APP_ONLY": "true"}  # no questions at the start
    try:
        return subprocess.Popen(  # noqa: S603, our own program with our own arguments
            [str(program), "--bind", _HOST, *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=detached,
        )
    except OSError as error:
        raise PalpateError(f"the Rerun viewer cannot be started: {error.strerror}: {program}") from error
