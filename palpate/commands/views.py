"""`palpate inspect`, `report` and `workbench`: see a measurement in Rerun, as a page, and on a live page."""

import webbrowser
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Annotated

import typer

from estimation.data.import_options import ImportOptions
from palpate.common import console
from palpate.common.console import shown, typed
from palpate.common.files import (
    different_files,
    existing_file,
    folder_to_read,
    open_session,
    output_file,
    output_folder,
    spare_files,
)
from palpate.render.build import REPORT, is_own_page
from palpate.render.inspection import PLOTS, RECORDING, look_into
from palpate.render.recording.file import open_window, take_picture
from palpate.teleop.haptics import STREAM_NAME as HAPTIC
from palpate.teleop.merged_sessions import merge_sessions
from palpate.teleop.recording import record_both
from palpate.workbench.startup import AppState, EarlyServer, raw_curves
from palpate.workflows.data_options import (
    DataArguments,
    FolderOption,
    JsonOption,
    ModelOption,
    may_take_data,
    takes_data,
)
from robot_io.errors import InputError, PalpateError

if TYPE_CHECKING:
    from palpate.workbench.state import WorkbenchState

BOTH = "both.rrd"  # name of a leader's and a follower's recording
PIXELS = (1600, 1000)  # width and height of a picture


def inspect_command(  # noqa: PLR0917, one parameter an option
    session: Annotated[Path, typer.Argument(help="Session file (.mcap).")],
    other: Annotated[
        Path | None,
        typer.Argument(help="The other side's session (palpate teleop): both on one time line."),
    ] = None,
    save: Annotated[
        Path | None, typer.Option(help="Write the recording here, and open no window.", metavar="FILE.rrd")
    ] = None,
    screenshot: Annotated[
        Path | None,
        typer.Option(help="Save a picture while force is held.", metavar="FILE.png"),
    ] = None,
    plots: Annotated[
        Path | None, typer.Option(help="Save a page of plots in this folder.", metavar="FOLDER")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are there already.")] = False,
) -> None:
    """See a session in Rerun: arm, object, forces, torques, phases, estimates and events over time.

    Two sessions, of a leader and its follower (palpate teleop), are shown on one time line.

    Without a display the recording is written to a file that Rerun opens on any machine: --save, or a file in
    the session's folder, which is overwritten.
    """
    found = open_session(session)
    merged = None if other is None else merge_sessions(found, open_session(other))
    if other is None and HAPTIC in found.stream_names:
        raise InputError(f"{session}: is a leader's session: give that of its follower as well")
    for output in (save, screenshot):
        if output is not None:
            output_file(output, force=force, keep=[session, *filter(None, [other])])
    different_files(save, screenshot, plots and plots / PLOTS)
    if plots is not None:
        spare_files(plots, [PLOTS], force=force, keep=[session])
        output_folder(plots)
    recording = save or output_folder(found.derived_dir) / (RECORDING if merged is None else BOTH)
    out = console.stdout()
    if merged is None:
        inspection = look_into(found)
        moment_s = inspection.record(recording)
    else:
        if plots is not None:
            raise InputError("--plots is for one session; palpate inspect FOLLOWER --plots FOLDER")
        moment_s = record_both(merged, recording)
        out.print(merged.clock_summary())
    out.print(f"recording: [bold]{shown(recording)}[/bold]", soft_wrap=True)
    if plots is not None:
        out.print(f"plot: [bold]{shown(inspection.plot(plots))}[/bold]", soft_wrap=True)
    if screenshot is not None:
        take_picture(recording, screenshot, moment_s, PIXELS)
        out.print(f"picture: [bold]{shown(screenshot)}[/bold]", soft_wrap=True)
    elif save is None and plots is None and console.has_display():
        open_window(recording)
        out.print("opened in a window of its own")
    else:
        console.next_steps(
            (f"rerun {typed(recording)}", "open it (on any machine with rerun-sdk of the same version)")
        )


@takes_data
def report_command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    folder: FolderOption = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Page to write.", metavar="FILE.html")] = Path(
        REPORT
    ),
    force: Annotated[
        bool, typer.Option("--force", help="Replace the file even if palpate did not write it.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write measurement, models, what was found missing and what was added as one page that needs no network.

    palpate report press.csv -o press.html
    """
    path = output_file(out, force=force or is_own_page(out), keep=[data.file])
    study = data.study(model, folder_to_read(data.file, folder))
    with console.stderr().status("fitting and drawing"):
        study.report(path, [f"palpate report {data.typed(model=model, folder=folder)}"])
    if as_json:
        console.print_json({"file": str(data.file), "report": str(path)})
        return
    console.stdout().print(f"report  [bold]{shown(path)}[/bold]", soft_wrap=True)
    console.next_steps(
        (f"palpate workbench {data.typed()}", "the same on a local page, with effects to tick")
    )


LOOPBACK = "127.0.0.1"
_MODEL = "kelvin_voigt"  # of a riddle


@may_take_data
def workbench_command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on this machine; 0 takes any free one.")
    ] = 8090,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    foxglove: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="Also serve a running probe to Foxglove, on this port.", metavar="PORT"
        ),
    ] = None,
    riddle: Annotated[
        bool, typer.Option("--riddle", help="Hide an effect in the simulated object, for you to find.")
    ] = False,
) -> None:
    """Serve a page on this machine: tick an effect, and see error, curves and parameters change at once.

    FILE may also be a folder of sessions, or nothing: the page then takes a file by drop, or probes. Nothing
    leaves this machine. Ctrl-C ends it.

    Examples: palpate workbench press.csv; palpate workbench sessions --no-browser; palpate workbench --riddle
    """
    if riddle and data.file != Path():
        raise InputError("--riddle probes an object of its own: leave out the file")
    if foxglove is not None and foxglove == port != 0:
        raise InputError(f"--port {port} and --foxglove {foxglove}: give them different ports")
    if not data.file.is_dir():
        existing_file(data.file, "session or data file")
    if data.urdf is not None:
        existing_file(data.urdf, "URDF")
    for effect in data.effect or ():
        existing_file(Path(effect.rpartition(":")[0] or effect), "effect")
    data.refuse_unknown(model)
    is_folder = data.file.is_dir()
    folder, file = (data.file, None) if is_folder else (data.file.parent, data.file)
    home = AppState(folder, file, riddle)
    home.open = lambda path, options: _state(data, path, options, model)
    if file is not None and data.held_out:
        home.state = _state(data, file, data.options, model)  # a run that is not there is refused here
    early = _early_server(port)
    if foxglove is not None:
        from palpate.workbench.sources import Feed  # noqa: PLC0415, rarely wanted

        home.feed = Feed(LOOPBACK, foxglove)
    address = f"http://{LOOPBACK}:{early.port}"
    console.stdout().print(f"workbench: [bold]{address}[/bold]  (Ctrl-C ends it)")
    if home.feed is not None:
        console.stdout().print(f"Foxglove:  [bold]ws://{LOOPBACK}:{home.feed.port}[/bold]")
    if not no_browser:
        Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    if file is not None:
        with suppress(PalpateError):  # the page says what is wrong with it
            home.raw = raw_curves(file)
    if riddle:
        home.read(lambda: _state(data, _posed(), ImportOptions(), model or _MODEL), "probing an object")
    elif file is not None and home.state is None:
        home.read(lambda: _state(data, file, data.options, model), f"reading {file.name}")
    early.answer_with(home.waiting)
    # a second or two to import; whoever asks meanwhile sees what was measured
    from palpate.workbench.server import serve  # noqa: PLC0415

    serve(home, early.release_socket())


def _state(data: DataArguments, path: Path, options: ImportOptions, model: str | None) -> "WorkbenchState":
    from palpate.workbench.state import WorkbenchState  # noqa: PLC0415, while the server begins

    given = replace(
        data,
        file=path,
        column=[f"{name}={column}" for name, column in options.columns.items()] or None,
        unit=[f"{name}={unit}" for name, unit in options.units.items()] or None,
        where=[f"{name}={text}" for name, text in options.where.items()] or None,
        context=list(options.context) or None,
        fresh_runs=options.fresh,
        runs=options.runs,
    )
    return WorkbenchState(given.study(model), given.typed(**{"held-out": None}))  # known already


def _posed() -> Path:
    from palpate.runs.options import SESSIONS  # noqa: PLC0415, with the simulator
    from palpate.workbench.diagnosis import pose  # noqa: PLC0415, with the simulator

    return pose(output_folder(SESSIONS))


def _early_server(port: int) -> EarlyServer:
    """The page's address, open from now on. InputError: somebody has the port."""
    try:
        return EarlyServer(LOOPBACK, port)
    except OSError as error:
        said = f"--port {port}: {error.strerror or error}; another, or 0 for any free one"
        raise InputError(said) from error
