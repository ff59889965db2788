"""`palpate inspect`: see a session in Rerun."""

import math
from pathlib import Path
from typing import Annotated

import typer

from palpate import console
from palpate.doctor.viewer import has_display
from palpate.files import different_files, open_session, output_file, output_folder, spare_files
from palpate.render.inspection import PLOTS, RECORDING, look_into
from palpate.render.recording.viewer import open_window, take_picture
from palpate.teleop.haptics import STREAM_NAME as HAPTIC
from palpate.teleop.joined import join
from palpate.teleop.recording import record_both
from palpate.words import shown, typed
from robot_io.errors import InputError

BOTH = "both.rrd"  # name of a leader's and a follower's recording
PIXELS_LEAST, PIXELS_MOST = 200, 8000


def command(  # noqa: PLR0917, one parameter an option
    session: Annotated[Path, typer.Argument(help="Session file (.mcap).")],
    other: Annotated[
        Path | None,
        typer.Argument(help="The other side's session (palpate teleop): both on one time line."),
    ] = None,
    save: Annotated[
        Path | None, typer.Option(help="Write the recording here, and open no window.", metavar="FILE.rrd")
    ] = None,
    screenshot: Annotated[
        Path | None, typer.Option(help="Save a picture of the viewer.", metavar="FILE.png")
    ] = None,
    plots: Annotated[
        Path | None, typer.Option(help="Save a page of plots in this folder.", metavar="FOLDER")
    ] = None,
    at_s: Annotated[
        float | None, typer.Option(help="Moment of the picture; default: while force is held.", metavar="S")
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the picture in pixels.", metavar="WxH")] = "1600x1000",
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there already.")] = False,
) -> None:
    """See a session in Rerun: arm, object, forces, torques, phases, estimates and events over time.

    With the sessions of a leader and its follower, both on one time line (palpate teleop).

    Without a display the recording is written to a file that Rerun opens anywhere: into the session's own
    folder, where it is renewed each time, or where --save says.
    """
    found = open_session(session)
    joined = None if other is None else join(found, open_session(other))
    if other is None and HAPTIC in found.stream_names:
        raise InputError(f"{session}: is a leader's session: give that of its follower as well")
    pixels = _size(size)
    if at_s is not None:
        _check_moment(at_s, screenshot)
    for output in (save, screenshot):
        if output is not None:
            output_file(output, force=force, keep=[session, *filter(None, [other])])
    different_files(save, screenshot, *(plots / name for name in PLOTS if plots is not None))
    if plots is not None:
        spare_files(plots, PLOTS, force=force, keep=[session])
        output_folder(plots)
    recording = save or output_folder(found.derived_dir) / (RECORDING if joined is None else BOTH)
    out = console.stdout()
    if joined is None:
        inspection = look_into(found)
        _check_within(at_s, inspection.lasts_s)
        moment_s = inspection.record(recording)
    else:
        if plots is not None:
            raise InputError("--plots is for one session; palpate inspect FOLLOWER --plots FOLDER")
        moment_s = record_both(joined, recording)
        out.print(joined.clocks_in_words())
    out.print(f"recording: [bold]{shown(recording)}[/bold]", soft_wrap=True)
    for plot in inspection.plot(plots) if plots is not None else ():
        out.print(f"plot: [bold]{shown(plot)}[/bold]", soft_wrap=True)
    if screenshot is not None:
        take_picture(recording, screenshot, moment_s if at_s is None else at_s, pixels)
        out.print(f"picture: [bold]{shown(screenshot)}[/bold]", soft_wrap=True)
    elif save is None and plots is None and has_display():
        open_window(recording)
        out.print("opened in a window of its own")
    else:
        console.next_steps(
            (f"rerun {typed(recording)}", "open it (on any machine with rerun-sdk of the same version)")
        )


def _check_moment(at_s: float, screenshot: Path | None) -> None:
    if not 0.0 <= at_s < math.inf:
        raise InputError(f"--at-s {at_s:g}: give seconds from the start of the session, such as 2.5")
    if screenshot is None:
        raise InputError(f"--at-s {at_s:g}: is the moment of a picture; add --screenshot FILE.png")


def _check_within(at_s: float | None, lasts_s: float) -> None:
    if at_s is not None and at_s > lasts_s:
        raise InputError(f"--at-s {at_s:g}: the session ends after {lasts_s:.4g} s")


def _size(text: str) -> tuple[int, int]:
    width, separator, height = text.partition("x")
    if not (separator and text.isascii() and width.isdecimal() and height.isdecimal()):
        raise InputError(f"--size {text!r}: give width and height, such as 1600x1000")
    if not all(PIXELS_LEAST <= int(side) <= PIXELS_MOST for side in (width, height)):
        raise InputError(f"--size {text!r}: each side must be {PIXELS_LEAST} to {PIXELS_MOST} pixels")
    return int(width), int(height)
