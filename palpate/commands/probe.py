"""`palpate probe`: touch an object at several speeds and log every tick."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from control.loop.result import Outcome
from control.probing.plan import ProbingPlan, load_probing_plan
from palpate.common import console
from palpate.common.files import existing_file, output_session
from palpate.common.formatting import count, duration, safe, shown, typed
from palpate.common.options import takes
from palpate.render.progress import probing_progress
from palpate.runs.confirmation import ask_for_power, motion_in_words
from palpate.runs.options import SESSIONS, RunOptions, YesOption, numbers
from palpate.runs.probing import ProbingJob, ProbingOutcome, online_estimators, run_probing
from palpate.runs.robots import wires_in_words
from robot_io.errors import InputError
from robot_io.files.file_model import validate

MILLI = 1e-3
NO_ESTIMATOR = "none"


@takes(RunOptions)
def command(
    options: RunOptions,
    *,
    experiment: Annotated[Path | None, typer.Option(help="Probing plan (YAML) to start from.")] = None,
    speed_mm_s: Annotated[
        str | None, typer.Option(help="Approach speeds, such as 150,90,60.", metavar="MM/S,...")
    ] = None,
    force_limit_n: Annotated[float | None, typer.Option(help="Load up to this force.", metavar="N")] = None,
    hold_s: Annotated[float | None, typer.Option(help="Hold the force for so long.", metavar="S")] = None,
    repeats: Annotated[int | None, typer.Option(help="How often all speeds are run.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Session file to write.")] = None,
    online: Annotated[
        str, typer.Option(help=f"Estimator that runs along: {', '.join(online_estimators())}, or none.")
    ] = "rls",
    yes: YesOption = False,
) -> None:
    """Probe an object: approach at several speeds, touch, load to a force, hold, retract.

    Without a robot file of your own this runs in simulation. The session file holds every tick.

    A real arm gets power after a question alone (or --yes), and a countdown.
    """
    robot_file = options.robot_file
    speeds_m_s = _speeds(speed_mm_s) if speed_mm_s is not None else None
    changes = {"speeds_m_s": speeds_m_s, "force_limit_n": force_limit_n, "hold_s": hold_s, "repeats": repeats}
    plan = _plan(experiment, {key: value for key, value in changes.items() if value is not None})
    if online not in (NO_ESTIMATOR, *online_estimators()):
        raise InputError(f"--online {online}: valid are {', '.join(online_estimators())}, {NO_ESTIMATOR}")
    job = ProbingJob(
        robot_file,
        output_session(out or SESSIONS / f"{options.stamped_name()}.mcap"),
        plan,
        online=None if online == NO_ESTIMATOR else online,
        permission=lambda: ask_for_power(motion_in_words(robot_file, plan), yes=yes),
        **options.job,
    )
    remark = f"emulated devices: {safe(wires_in_words(robot_file))}" if options.wire else ""
    with probing_progress(plan, live=job.simulated, remark=remark) as watcher:
        outcome = run_probing(job, watcher)
    if options.as_json:
        console.print_json(_as_data(outcome))
    else:
        _print(outcome, len(list(plan.runs())))
    outcome.raise_for_failure()


def _speeds(text: str) -> list[float]:
    """Speeds in m/s from comma-separated mm/s."""
    speeds = numbers("--speed-mm-s", text, ", such as 150,90,60")
    if not all(0 < speed <= 1000 for speed in speeds):
        raise InputError(f"--speed-mm-s {text!r}: each speed must be above 0 and at most 1000 mm/s")
    return [MILLI * speed for speed in speeds]


def _plan(experiment: Path | None, changes: dict[str, Any]) -> ProbingPlan:
    plan = load_probing_plan(existing_file(experiment, "experiment")) if experiment else ProbingPlan()
    try:
        return validate(ProbingPlan, plan.model_dump() | changes)
    except InputError as error:  # of plan and options together
        key, _, problem = str(error).partition(": ")
        typed = key in changes and key != "speeds_m_s"  # whose option has another unit
        said = f"--{key.replace('_', '-')}: {problem}" if typed else f"probing plan: {error}"
        raise InputError(said) from error


def _as_data(outcome: ProbingOutcome) -> dict[str, Any]:
    loop = outcome.loop
    return {
        "session": str(outcome.session),
        "sealed": str(outcome.sealed) if outcome.sealed else None,
        "outcome": str(loop.outcome),
        "cause": loop.cause,
        "failed_runs": list(outcome.failures),
        "ticks": loop.ticks,
        "overruns": loop.overruns,
        "dropped": loop.dropped,
        "unsent": loop.unsent,
        "log_error": loop.log_error,
        "observer_error": loop.observer_error,
        "deactivation_error": loop.deactivation_error,
        "duration_s": loop.duration_s,
        "wall_s": loop.wall_s,
    }


def _print(outcome: ProbingOutcome, planned: int) -> None:
    loop, out = outcome.loop, console.stdout()
    faster = (
        f", {loop.duration_s / loop.wall_s:.0f} times real time"
        if loop.wall_s < 0.9 * loop.duration_s
        else ""
    )
    if loop.outcome is Outcome.FINISHED:
        done = "planned" if outcome.failures else "done"
    else:
        done = f"planned, [red]{loop.outcome}[/red]: {safe(loop.cause)}"
    if outcome.failures:
        done += f", [yellow]{count(len(outcome.failures), 'failure')}[/yellow]"
    out.print(
        f"{count(planned, 'run')} {done}: {duration(loop.duration_s)} in {duration(loop.wall_s)}{faster}"
    )
    for failure in outcome.failures:
        out.print(f"  [yellow]{safe(failure)}[/yellow]")
    if not loop.is_clean:
        out.print(f"  [yellow]{safe(loop.one_line())}[/yellow]")
    if stuck := loop.outcome is Outcome.TRIPPED and loop.ticks == 0:
        out.print(
            "  nothing has moved: put right what is said above (a joint that is beyond its limits by hand, "
            "without power), and start again"
        )
    session = typed(outcome.session)
    out.print(f"written: [bold]{shown(outcome.session)}[/bold]", soft_wrap=True)
    if outcome.sealed:
        reveal = f"to open it: palpate reveal {escape(session)}"
        out.print(f"sealed:  [bold]{shown(outcome.sealed)}[/bold] ({reveal})", soft_wrap=True)
    estimate = (f"palpate estimate {session}", "stiffness and damping with their intervals")
    inspect = (f"palpate inspect {session}", "see it in Rerun")
    info = (f"palpate info {session}", "what is in the file")
    compare = (f"palpate compare {session}", "how far off a spring and damper are, and where")
    diagnose = (f"palpate diagnose {session}", "which physical effect is missing")
    steps = [estimate, compare, diagnose] if outcome.touched else []
    console.next_steps(*steps, *[inspect] * (not stuck), info)
