"""`palpate workbench`: tick an effect on a local page, and see at once what it does."""

import webbrowser
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Annotated

import numpy as np
from typer import Option

from palpate.common import console
from palpate.common.files import existing_data, existing_file, output_folder
from palpate.estimation.data.import_options import ImportOptions
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.extras import missing_package
from palpate.workbench.startup import LOOPBACK, AppState, EarlyServer, raw_curves
from palpate.workflows.data_options import DataArguments, ModelOption, may_take_data

if TYPE_CHECKING:
    from palpate.workbench.state import WorkbenchState

_MODEL = "kelvin_voigt"  # of a riddle
_HIDDEN = (  # one of these is hidden in it
    *("adhesion", "cubic_stiffness", "delay", "dry_friction", "layered_stiffness", "plastic_set"),
    *("quadratic_damping", "stress_relaxation"),
)


_FOXGLOVE = "Also serve a running probe to Foxglove on this port."
_RIDDLE = "Hide an effect in a simulated object that you then diagnose."


@may_take_data
def workbench_command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    port: Annotated[int, Option(min=0, max=65535, help="Port on this machine; 0 selects a free one.")] = 8090,
    no_browser: Annotated[bool, Option("--no-browser", help="Only print the address.")] = False,
    foxglove: Annotated[int | None, Option(min=0, max=65535, help=_FOXGLOVE, metavar="PORT")] = None,
    riddle: Annotated[bool, Option("--riddle", help=_RIDDLE)] = False,
) -> None:
    """Serve a local web page on which you tick effects and see how error, curves and parameters change.

    FILE may also be a folder of sessions. Without FILE, drop a file on the page, or probe from the page.
    No data leave this machine. Ctrl-C ends the server.

    Examples:
      palpate workbench press.csv
      palpate workbench sessions --no-browser
      palpate workbench --riddle
    """
    if riddle and data.file != Path():
        raise InputError("--riddle probes an object of its own, so leave out the file")
    if foxglove is not None and foxglove == port != 0:
        raise InputError(f"--port {port} and --foxglove {foxglove}: give them different ports")
    existing_data(data.file)
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
        home.state = _state(data, file, data.options, model)  # refuses runs that do not exist
    if find_spec("nicegui") is None:  # before an address is printed
        raise ModuleNotFoundError(missing_package("nicegui"), name="nicegui")
    early = EarlyServer(port)
    if foxglove is not None:
        from palpate.workbench.live import FoxgloveFeed  # noqa: PLC0415, rarely wanted

        home.feed = FoxgloveFeed(LOOPBACK, foxglove)
    address = f"http://{LOOPBACK}:{early.port}"
    console.stdout().print(f"workbench: [bold]{address}[/bold]  (Ctrl-C ends it)")
    if home.feed is not None:
        console.stdout().print(f"Foxglove:  [bold]ws://{LOOPBACK}:{home.feed.port}[/bold]")
    if not no_browser:
        Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    if file is not None:
        with suppress(PalpateError):  # the page shows the error
            home.raw = raw_curves(file)
    if riddle:

        def probe_object() -> "WorkbenchState":
            # imported only for a riddle, which needs the simulator
            from palpate.commands.demo import HIDDEN_PLAN, drawn_seed, hide_one, probe_demo  # noqa: PLC0415
            from palpate.runs.options import SESSIONS  # noqa: PLC0415
            from palpate.runs.robots import DEFAULT_SCENARIO  # noqa: PLC0415
            from palpate.sim_backend.scenario import load_scenario  # noqa: PLC0415

            drawn = drawn_seed()
            world = hide_one(load_scenario(DEFAULT_SCENARIO), np.random.default_rng(drawn), _HIDDEN)
            session = output_folder(SESSIONS) / f"riddle-{drawn}.mcap"
            probe_demo(session, world, drawn, plan=HIDDEN_PLAN, command_line="palpate workbench --riddle")
            return _state(data, session, ImportOptions(), model or _MODEL)

        home.read(probe_object, "probing an object")
    elif file is not None and home.state is None:
        home.read(lambda: _state(data, file, data.options, model), f"reading {file.name}")
    early.answer_with(home.waiting)
    # takes 1 to 2 s to import; until then the page shows the raw curves
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
        table=options.table or None,
        runs=options.runs,
    )
    return WorkbenchState(given.study(model), given.command_text(**{"held-out": None}))  # known already
