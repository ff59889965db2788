"""`palpate demo`: everything once, without asking anything."""

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from palpate import console
from palpate.demo import PLAN, Demo, probe_demo, show_demo
from palpate.estimate_report import as_data, remarks
from palpate.estimate_table import estimate_table
from palpate.files import output_file
from palpate.progress import probing_progress
from palpate.words import shown
from sim_backend.scenario import load_scenario, shipped_scenarios


def command(
    scenario: Annotated[
        str, typer.Option(help=f"Simulated world: a file, or one of {', '.join(shipped_scenarios())}.")
    ] = "default",
    seed: Annotated[int | None, typer.Option(help="Seed of all simulated noise.", min=0)] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Session file to write.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Probe a simulated object at three speeds, estimate how stiff and damped it is, and show it.

    Writes a session file, and beside it a folder with a Rerun recording and plots. Takes some seconds.
    """
    world = load_scenario(scenario)
    session = output_file(out or _default_session())
    talk = console.stderr()
    talk.print(f"A simulated arm probes [bold]{world.description or scenario}[/bold] at three speeds.")
    with probing_progress(PLAN, live=True) as watcher:
        probe_demo(session, world, seed, watcher)
    with talk.status("estimating, recording and plotting"):
        demo = show_demo(session)
    if as_json:
        console.print_json(_as_data(demo))
    else:
        _print(demo)


def _default_session() -> Path:
    return Path("sessions") / f"demo-{datetime.now().astimezone():%Y%m%d-%H%M%S}.mcap"


def _as_data(demo: Demo) -> dict[str, object]:
    return {
        "session": str(demo.session),
        "recording": str(demo.recording),
        "plots": [str(plot) for plot in demo.plots],
        "result": as_data(demo.found, demo.material.truth),
    }


def _print(demo: Demo) -> None:
    out = console.stdout()
    out.print(estimate_table(demo.found, demo.material.truth, out.width))
    for remark in remarks(demo.found, demo.material.truth):
        out.print(f"  {remark}")
    out.print(f"\nsession    [bold]{shown(demo.session)}[/bold]")
    out.print(f"recording  [bold]{shown(demo.recording)}[/bold]")
    for number, plot in enumerate(demo.plots):
        out.print(f"{'' if number else 'plots':<10} [bold]{shown(plot)}[/bold]")
    session = shown(demo.session)
    console.next_steps(
        (f"palpate inspect {session}", "see arm, forces and estimates in Rerun"),
        ("palpate probe --scenario stiff --speed-mm-s 50,20,10", "another object, other speeds"),
        (f"palpate estimate {session} --estimator ransac --json", "one method, for a program"),
        ("palpate probe --robot my_arm.yaml", "your own arm"),
    )
