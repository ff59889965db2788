"""`palpate replay`: repeat the motion of a session, in simulation or with an arm."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from control.loop.result import Outcome
from palpate.common import console
from palpate.common.files import open_session, output_session
from palpate.common.formatting import count, duration, safe, shown, typed
from palpate.common.options import takes
from palpate.render.progress import motion_progress
from palpate.runs.confirmation import ask_for_power
from palpate.runs.hidden_effects import scenario_of
from palpate.runs.options import SESSIONS, RunOptions, YesOption
from palpate.runs.probing import ReplayJob, references_of, run_replay
from palpate.runs.session import raise_for_end


@takes(RunOptions, "robot")
def command(
    options: RunOptions,
    *,
    session: Annotated[Path, typer.Argument(help="Session of a probing (.mcap), whose motion is repeated.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Session file to write.")] = None,
    yes: YesOption = False,
) -> None:
    """Repeat the joint motion of a session: in a simulated world, or with a real arm.

    The simulated world is that of --scenario, else that of the session without what was hidden in it.
    A real arm gets power after a question alone (or --yes), and a countdown; no force is controlled, and its
    guard stops it at its limits.

    Example: palpate export real.mcap -o twin.yaml; palpate replay real.mcap --scenario twin.yaml
    -o twin.mcap; palpate compare real.mcap twin.mcap
    """
    recorded = open_session(session)
    references, robot_file = references_of(recorded), options.robot_file
    file = output_session(out or SESSIONS / f"{options.stamped_name('replay')}.mcap", keep=[session])
    runs = len(np.unique(references.run[references.run >= 0]))
    motion = (
        f"'{robot_file.name}' is going to move: it repeats {count(runs, 'run')} of {session.name}, "
        f"{duration(references.duration_s)}; its guard stops it beyond {robot_file.limits.force_n:g} N."
    )
    job = ReplayJob(
        robot_file, file, recorded, permission=lambda: ask_for_power(motion, yes=yes), **options.job
    )
    if job.simulated and job.scenario is None:
        job = replace(job, scenario=scenario_of(recorded))
    with motion_progress("repeating the motion", live=job.simulated) as watcher:
        result, sealed = run_replay(job, references, watcher(references.duration_s))
    if options.as_json:
        content = {"session": str(file), "replay_of": str(session), "outcome": str(result.outcome)}
        console.print_json(content | {"cause": result.cause, "sealed": str(sealed) if sealed else None})
    else:
        done = (
            "done"
            if result.outcome is Outcome.FINISHED
            else f"[red]{result.outcome}[/red]: {safe(result.cause)}"
        )
        out_ = console.stdout()
        out_.print(f"{count(runs, 'run')} repeated, {done}")
        out_.print(f"written: [bold]{shown(file)}[/bold]", soft_wrap=True)
        console.next_steps(
            (f"palpate compare {typed(session)} {typed(file)}", "both side by side"),
            (f"palpate inspect {typed(file)}", "see it in Rerun"),
        )
    raise_for_end(result)
