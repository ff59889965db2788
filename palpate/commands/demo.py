"""`palpate demo`: run the whole workflow once without questions."""

from typing import Annotated, Any

import numpy as np
import typer

from palpate.common import console
from palpate.common.console import as_command, display_path, shell_path, significant
from palpate.common.files import output_file, output_session
from palpate.common.options import JsonOption, SessionOutOption, scenario_names
from palpate.render.build import result_view
from palpate.render.estimates import as_data, print_estimates
from palpate.render.progress import diagnosis_progress, probing_progress
from palpate.render.terminal import print_files, print_stages
from palpate.runs.options import ENGINE, SESSIONS, time_stamp
from palpate.sim_backend.contact_laws.standard import KelvinVoigtLaw
from palpate.sim_backend.engines import EngineName
from palpate.sim_backend.hidden import sealed_path
from palpate.sim_backend.scenario import MOST_SEED, load_scenario, shipped_scenarios
from palpate.workflows.demo import (
    HIDDEN_PLAN,
    PLAN,
    HiddenDemo,
    drawn_seed,
    hide_one,
    probe_demo,
    show_demo,
    solve,
)

DEFAULT = "default"


def demo_command(
    scenario: Annotated[
        str,
        typer.Option(
            help=f"Simulated world: a file, or one of {', '.join(shipped_scenarios())}.",
            autocompletion=scenario_names,
        ),
    ] = DEFAULT,
    engine: Annotated[EngineName | None, typer.Option(help=ENGINE)] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Seed of simulated noise and hidden effects; default: random.", min=0, max=MOST_SEED
        ),
    ] = None,
    out: SessionOutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Probe a simulated object and estimate its stiffness, then find a hidden effect in another object.

    Writes two session files, NAME.mcap and NAME-hidden.mcap, each with a folder of results. Takes less
    than a minute.
    """
    world = load_scenario(scenario)
    if engine is not None:
        world = world.with_engine(engine)
    session = output_session(out or SESSIONS / f"demo-{time_stamp()}.mcap")
    # With another law, the base model would miss more than the hidden effect.
    can_hide = isinstance(world.object.law, KelvinVoigtLaw)
    second = output_file(session.with_name(f"{session.stem}-hidden.mcap")) if can_hide else None
    if seed is None and second is not None:
        seed = drawn_seed()
    given = {"--scenario": None if scenario == DEFAULT else scenario, "--engine": engine, "--seed": seed}
    chosen = [word for name, value in given.items() if value is not None for word in (name, str(value))]
    again = as_command(["demo", *chosen])
    talk = console.stderr()
    seeded = "" if seed is None else f" (seed {seed})"
    talk.print(
        f"A simulated arm probes [bold]{world.description or scenario}[/bold] at three speeds{seeded}."
    )
    with probing_progress(PLAN, live=True) as watcher:
        probe_demo(session, world, seed, watcher, command_line=again)
    with talk.status("estimating, recording and plotting"):
        study, estimates, recording, plots = show_demo(session)
    truth = study.truth_of(estimates.channel)
    if not as_json:
        out_ = console.stdout()
        print_estimates(out_, estimates, truth)
        out_.print()
        recorded = {} if recording is None else {"recording": recording}
        print_files(out_, {"session": session, **recorded})
        print_files(out_, {"plots": plots})
    hidden = None
    if second is not None:
        talk.print("\n[bold]Now the object has a hidden effect that the model lacks.[/bold]")
        world = hide_one(world, np.random.default_rng(seed))
        with probing_progress(HIDDEN_PLAN, live=True) as watcher:
            probe_demo(second, world, seed, watcher, HIDDEN_PLAN, command_line=again)
        talk.print(f"probed again; the hidden effect is stored in {display_path(sealed_path(second))}")
        with diagnosis_progress(["contact"]) as progress:
            hidden = solve(second, progress)
    if as_json:
        content = {
            "again": again,
            "session": str(session),
            "recording": None if recording is None else str(recording),
            "plots": [str(plots)],
            "result": as_data(estimates, truth),
            "hidden": None if hidden is None else _hidden_data(hidden),
        }
        console.print_json(content)
        return
    if hidden is not None:
        _print_hidden(hidden)
    viewer = "" if recording else "pip install 'palpate[view]' && "
    inspect = console.format_command(f"palpate inspect {shell_path(session)}")
    steps = [
        (f"{viewer}{inspect}", "see arm, forces and estimates in Rerun"),
        (
            "palpate doctor --robot my_arm.yaml",
            "your own arm, before it gets power (docs/how-to/hardware.md)",
        ),
    ]
    if hidden is not None:
        if "recording" in hidden.files:
            steps.insert(1, console.rerun_step(hidden.files["recording"]))
        steps.insert(
            2, ("palpate probe --hidden random --seed 7", "another hidden effect, drawn from all effects")
        )
    console.next_steps(*steps, (again, "the same demo again"))


def _hidden_data(hidden: HiddenDemo) -> dict[str, Any]:
    diagnosis = hidden.result.diagnosis
    return {
        "session": str(hidden.session),
        "files": {what: str(path) for what, path in hidden.files.items()},
        "diagnosis": diagnosis.model_dump(mode="json") if diagnosis is not None else None,
        "answer": [{"effect": entry.name, **entry.model_dump()} for entry in hidden.answer.hidden],
        "found": hidden.found,
    }


def _print_hidden(hidden: HiddenDemo) -> None:
    """Print the diagnosis of the second part, and what the sealed answer says."""
    out = console.stdout()
    print_stages(out, result_view(hidden.result))
    answer = "; ".join(
        f"[bold]{entry.name}[/bold] ("
        + ", ".join(f"{name} {significant(value)} {unit}" for name, (value, unit) in entry.values().items())
        + ")"
        for entry in hidden.answer.hidden
    )
    mark = "[bold green]CORRECT[/bold green]" if hidden.found else "[bold yellow]NOT FOUND[/bold yellow]"
    out.print(f"{mark}  the hidden effect was {answer}\n")
    print_files(out, {"session": hidden.session, **hidden.files})
