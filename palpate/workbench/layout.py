"""Layout of the page: a study with its diagnosis, or a start page without data."""

import asyncio
import secrets
import shlex
from collections.abc import Awaitable, Callable
from functools import partial
from itertools import count
from pathlib import Path

from nicegui import run, ui

from palpate.common import console
from palpate.common.console import safe
from palpate.common.files import output_folder, write_text
from palpate.estimation.data.file_columns import is_session
from palpate.estimation.data.import_options import ImportOptions
from palpate.planning.next_probe import plan_text, same_world
from palpate.robot_io.errors import PalpateError
from palpate.runs.options import SESSIONS
from palpate.workbench import elements
from palpate.workbench.elements import set_props
from palpate.workbench.file_drop import FileDrop
from palpate.workbench.live import live_view, newest_growing, run_command
from palpate.workbench.page import FOLLOW_S, Page
from palpate.workbench.startup import AppState
from palpate.workbench.state import WorkbenchState

_NEXT = "next-experiment.yaml"
_CODE_DIGITS = 6


async def lay_out_page(home: AppState) -> None:
    """Build the page for the server's state.

    Args:
        home: state of the server.
    """
    if home.state is None:
        # Start page without data: drop a file, choose one, or probe.
        with ui.element("div").classes("begin"):
            ui.label("palpate workbench").classes("brand")
            if home.error:
                ui.label(home.error).classes("bad").mark("refused")
            drop = _choose(home)
            if home.error and home.file is not None and not is_session(home.file):
                ui.timer(0.01, partial(drop.begin, home.file), once=True)  # the user may correct its columns
        # another tab may open a file
        ui.timer(FOLLOW_S, lambda: None if home.state is None else ui.navigate.reload())
        return
    state = home.state

    def choose_other() -> None:
        with ui.dialog() as dialog, ui.card().classes("gallery"):
            _choose(home)
            ui.button("Close", on_click=dialog.close).props("flat no-caps")
        dialog.on("hide", dialog.delete)
        dialog.open()

    await Page(home, state, choose_other, lambda: _next_step(home, state)).build()


def _choose(home: AppState) -> FileDrop:
    drop = FileDrop(lambda path, options: _show(home, path, options))
    endings = (".csv", ".tsv", ".xlsx", ".parquet", ".npz")
    files = [
        file
        for file in (home.folder.iterdir() if home.folder.is_dir() else ())
        if file.is_file() and (file.name.lower().removesuffix(".gz").endswith(endings) or is_session(file))
    ]
    for file in sorted(files, key=lambda file: -file.stat().st_mtime)[:12]:
        ui.button(file.name, on_click=partial(drop.begin, file)).props("flat dense no-caps")
    if sum(map(is_session, files)) > 1:
        words_of_all = "All sessions of the folder as one study"
        ui.button(words_of_all, on_click=partial(drop.begin, home.folder)).props("flat dense no-caps")
    growing = newest_growing(home.folder) if home.folder.is_dir() else None
    if growing is not None:
        live_view(growing, lambda path: _show(home, path, ImportOptions()), home.feed)
    place = ui.element("div")
    _once("Probe the simulated arm", lambda: _probe(home, [], place)).props(
        "outline no-caps dense icon=precision_manufacturing"
    ).mark("probe")
    return drop


async def _show(home: AppState, path: Path, options: ImportOptions) -> None:
    """Open a file and show it, or show the error where it was selected."""
    assert home.open is not None  # noqa: S101, set before the page is served
    opener = home.open
    home.state = await asyncio.to_thread(lambda: opener(path, options))
    home.error, home.riddle = "", False
    ui.navigate.reload()


async def _probe(home: AppState, arguments: list[str], place: ui.element, *, join: bool = False) -> None:
    """Probe and follow the growing session; then open it, or join it to the study."""
    session = _unused_path(home, "workbench", ".mcap")

    async def done(path: Path) -> None:
        if join and home.state is not None:
            home.state = await asyncio.to_thread(home.state.joined_with, path)
            ui.navigate.reload()
        else:
            await _show(home, path, ImportOptions())

    place.clear()
    with place:
        ui.label(shlex.join(["palpate", "probe", *arguments, "--out", str(session)])).classes("code")
        live_view(session, done, home.feed)
    if failed := await run_command(["probe", *arguments, "--out", str(session)], lambda line: None):
        with place:
            ui.label(failed).classes("bad")


def _unused_path(home: AppState, name: str, ending: str = "") -> Path:
    """Return an unused path that no other tab is about to write to."""
    folder = output_folder(SESSIONS if home.folder == Path() else home.folder)
    paths = (folder / f"{name}-{number}{ending}" for number in count(1))
    free = next(path for path in paths if path not in home.reserved and not path.exists())
    home.reserved.add(free)
    return free


def _next_step(home: AppState, state: WorkbenchState) -> None:
    """Show the experiment that separates the open explanations, with a button that runs it."""
    diagnosis, session = state.diagnosis, state.study.source.session
    world = None if session is None else same_world(session)
    folder = state.study.folder
    if session is None or diagnosis is None or diagnosis.next_experiment is None or folder is None:
        return
    if world is None:
        ui.label(elements.SEALED).classes("quiet")
        return
    place = ui.element("div")
    # A session's metadata may be untrusted. Its drivers are code, which runs only after confirmation.
    simulated = "simulated" in session.metadata.extra.get("source", "") and "--drivers" not in world

    async def go() -> None:
        place.clear()
        with place:
            ui.label(elements.DESIGNING).classes("quiet")
        try:
            following = await run.io_bound(lambda: state.study.next_probe([diagnosis]))
            if following is None:
                ui.notify("no experiment that this arm can do is expected to separate the explanations")
                return
            text = plan_text(following.proposal, following.plan)
            write_text(output_folder(folder) / _NEXT, text)
        except PalpateError as error:
            ui.notify(str(error), type="negative")
            return
        if not place.client.has_socket_connection:  # prevents motion after the page was closed
            return
        arguments = ["--experiment", str(folder / _NEXT), *shlex.split(world)]
        if simulated:
            await _probe(home, arguments, place, join=True)
        elif await _ask_permission(following.plan.force_limit_n, ["palpate", "probe", *arguments]):
            await _probe(home, [*arguments, "--yes"], place, join=True)

    async def resolve() -> None:
        """Run `palpate resolve` in the probed world, and show its decisions as they arrive."""
        out = _unused_path(home, "resolve")
        arguments = ["resolve", *shlex.split(world), "--out", str(out)]
        place.clear()
        with place:
            ui.label(shlex.join(["palpate", *arguments])).classes("code")
            log = ui.log(max_lines=200).classes("told")
        if failed := await run_command(arguments, log.push):
            log.push(failed)
        else:
            await _show(home, out, ImportOptions())

    if simulated:
        button = _once("Resolve: probe until one explanation is left", resolve).props("dense outline no-caps")
        set_props(button, title=elements.RESOLVE)
    text = "Run it on the simulated arm" if simulated else "Run it on the robot"
    _once(text, go).props("dense outline no-caps")


def _once(text: str, work: Callable[[], Awaitable[None]]) -> ui.button:
    """Make a button that is disabled while its work runs."""

    async def pressed() -> None:
        button.disable()
        try:
            await work()
        finally:
            button.enable()

    return (button := ui.button(text, on_click=pressed))


async def _ask_permission(force_n: float, arguments: list[str]) -> bool:
    """Ask before a real arm gets power, as `palpate probe` does.

    The answer needs a number that only the terminal shows, so neither a script in the page nor another user
    of this machine can give it.
    """
    code, command = f"{secrets.randbelow(10**_CODE_DIGITS):0{_CODE_DIGITS}}", shlex.join(arguments)
    console.stderr().print(
        f"the page asks to power the arm: {safe(command)}\nto allow it, type {code} on the page"
    )
    with ui.dialog().props("persistent") as dialog, ui.card():
        ui.label(f"The arm will move and press with {force_n:g} N.").classes("text-bold")
        ui.label(
            "Keep clear of the arm and of the space below it, and hold its power switch in your hand. "
            "Power the arm now?"
        )
        ui.label(command).classes("code")
        typed = ui.input("number shown in the terminal").props("dense outlined autofocus")
        with ui.row():
            ui.button("No", on_click=lambda: dialog.submit(False)).props("outline no-caps")
            ui.button("Yes, power it", on_click=lambda: dialog.submit(True)).props(
                "unelevated no-caps color=negative"
            )
    if not await dialog:
        return False
    if secrets.compare_digest(str(typed.value).strip().encode(), code.encode()):
        return True
    ui.notify("that is not the number shown in the terminal: nothing has moved", type="warning")
    return False
