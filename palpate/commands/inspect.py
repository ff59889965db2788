"""`palpate inspect`: see a session in Rerun."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from palpate.common import console, files
from palpate.common.console import display_path, shell_path
from palpate.control.loop.tick_record import STREAM_NAME as TICK
from palpate.control.teleop.messaging import STREAM_NAME as LINK
from palpate.render.inspection import PLOTS, RECORDING, inspect_session
from palpate.render.recording.file import capture_screenshot, start_viewer
from palpate.robot_io.errors import InputError

BOTH = "both.rrd"  # name of a leader's and a follower's recording
PIXELS = (1600, 1000)  # width and height of a picture


_OTHER = "The other session of a teleoperation (leader's or follower's), shown on the same timeline."
_SAVE = "Write the recording here instead of opening a window."
_SCREENSHOT = "Save a picture of the arm during the hold."


def inspect_command(  # noqa: PLR0917, one parameter an option
    session: Annotated[Path, Argument(help="Session file (.mcap).")],
    other: Annotated[Path | None, Argument(help=_OTHER)] = None,
    save: Annotated[Path | None, Option(help=_SAVE, metavar="FILE.rrd")] = None,
    screenshot: Annotated[Path | None, Option(help=_SCREENSHOT, metavar="FILE.png")] = None,
    plots: Annotated[Path | None, Option(help="Save plots in this folder.", metavar="FOLDER")] = None,
    force: Annotated[bool, Option("--force", help="Replace files that already exist.")] = False,
) -> None:
    """Show a session in Rerun: arm, object, forces, torques, phases, estimates and events over time.

    The sessions of a leader and its follower (palpate teleop) are shown on one timeline.

    Without a display, the recording is written to the file of --save, or to a file in the session's folder,
    which is overwritten. Rerun opens this file on any machine.
    """
    opened, merged = files.open_session(session), None
    if other is not None:
        from palpate.teleop.merged_sessions import merge_sessions  # noqa: PLC0415, for two sides alone

        merged = merge_sessions(opened, files.open_session(other))
    elif LINK in opened.stream_names and TICK not in opened.stream_names:
        raise InputError(f"{session}: is a leader's session; give its follower's session as well")
    for output in (save, screenshot):
        if output is not None:
            files.output_file(output, force=force, keep=[session, *filter(None, [other])])
    files.different_files(save, screenshot, plots and plots / PLOTS)
    if plots is not None:
        files.spare_files(plots, [PLOTS], force=force, keep=[session])
        files.output_folder(plots)
    recording = save or files.output_folder(files.refuse_link(opened.derived_dir)) / (
        RECORDING if merged is None else BOTH
    )
    if merged is None:
        inspection = inspect_session(opened)
        moment_s = inspection.record(recording)
    else:
        if plots is not None:
            raise InputError("--plots takes only one session; use palpate inspect FOLLOWER --plots FOLDER")
        from palpate.teleop.recording import record_both  # noqa: PLC0415, as above

        moment_s = record_both(merged, recording)
        console.stdout().print(merged.clock_summary())
    console.say(f"recording: [bold]{display_path(recording)}[/bold]")
    if plots is not None:
        console.say(f"plot: [bold]{display_path(inspection.plot(plots))}[/bold]")
    if screenshot is not None:
        capture_screenshot(recording, screenshot, moment_s, PIXELS)
        console.say(f"picture: [bold]{display_path(screenshot)}[/bold]")
    elif save is None and plots is None and console.has_display():
        start_viewer("--port", "auto", str(recording.absolute()), detached=True)
        console.stdout().print("opened in a separate window")
    else:
        console.next_steps(
            (
                f"rerun {shell_path(recording)}",
                "open the recording (on any machine with the same version of rerun-sdk)",
            )
        )
