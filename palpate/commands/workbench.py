"""`palpate workbench`: tick an effect on a local page, and see at once what it does."""

import socket
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimation.data.import_options import ImportOptions
from palpate import console
from palpate.data_options import DataArguments, ModelOption, may_take_data
from palpate.files import existing_file, output_folder
from palpate.runs.options import SESSIONS
from palpate.workbench.home import Home
from robot_io.errors import InputError

if TYPE_CHECKING:
    from palpate.workbench.bench import Bench

LOOPBACK = "127.0.0.1"
_MODEL = "kelvin_voigt"  # of a riddle


@may_take_data
def command(
    data: DataArguments,
    *,
    model: ModelOption = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="On this machine; 0 for any free one.")] = 8090,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
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
    if not data.file.is_dir():
        existing_file(data.file, "session or data file")
    chosen = _free(port)
    is_folder = data.file.is_dir()
    folder, file = (data.file, None) if is_folder else (data.file.parent, data.file)
    home = Home(folder, file, riddle)
    home.open = lambda path, options: _bench(data, path, options, model)
    if riddle:
        home.read(lambda: _bench(data, _posed(), ImportOptions(), model or _MODEL), "probing an object")
    elif not is_folder:
        home.read(lambda: _bench(data, data.file, data.options, model), f"reading {data.file.name}")
    console.stdout().print(f"workbench: [bold]http://{LOOPBACK}:{chosen}[/bold]  (Ctrl-C ends it)")
    # the page's library takes a second to import, in which the data is read
    from palpate.workbench.server import serve  # noqa: PLC0415

    serve(home, LOOPBACK, chosen, browser=not no_browser)


def _bench(data: DataArguments, path: Path, options: ImportOptions, model: str | None) -> "Bench":
    from palpate.workbench.bench import Bench  # noqa: PLC0415, while the server begins

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
    return Bench(given.study(model), given.typed())


def _posed() -> Path:
    from palpate.workbench.riddle import pose  # noqa: PLC0415, with the simulator

    return pose(output_folder(SESSIONS))


def _free(port: int) -> int:
    """The port, if nobody has it.

    Raises:
        InputError: somebody has.
    """
    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((LOOPBACK, port))
        except OSError as error:
            raise InputError(
                f"--port {port}: {error.strerror or error}; another, or 0 for any free one"
            ) from error
        return int(tried.getsockname()[1])
