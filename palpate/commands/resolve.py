"""`palpate resolve`: probe and diagnose, again and again, until one explanation is left."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from control.probing.plan import ProbingPlan, load_probing_plan
from palpate.common import console
from palpate.common.files import existing_file
from palpate.common.formatting import count, duration, safe, shown, typed
from palpate.common.options import takes
from palpate.render.progress import diagnosis_progress, probing_progress
from palpate.runs.confirmation import ask_for_power, motion_in_words
from palpate.runs.options import SESSIONS, RunOptions, YesOption
from palpate.runs.probing import ProbingJob, Watcher
from palpate.workflows.resolve import DECISIONS, Budget, Decision, Resolved, resolve
from robot_io.errors import InputError


@takes(RunOptions)
def command(
    options: RunOptions,
    *,
    experiment: Annotated[Path | None, typer.Option(help="Plan (YAML) of the first probe.")] = None,
    probes: Annotated[int, typer.Option(help="Probes at most, the first among them.", min=1, max=50)] = 4,
    seconds: Annotated[
        float,
        typer.Option(
            help="Time of probing at most; the first probe is always run.", metavar="S", min=1.0, max=36000.0
        ),
    ] = 300.0,
    channel: Annotated[str | None, typer.Option(help="Explain only this channel, such as joint_2.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the sessions.", metavar="FOLDER")
    ] = None,
    yes: YesOption = False,
) -> None:
    """Probe, diagnose, and run the experiment that sets apart what is left, until one explanation is.

    Each further experiment is the feasible plan whose data are expected to tell the explanations apart best.
    Decisions are told, and logged beside the sessions, which are one study: every command takes their folder.
    A real arm gets power after a question before each probe (or --yes). Ctrl-C keeps all that was recorded.

    Examples:
      palpate resolve --hidden random --seed 7

      palpate resolve --robot my_arm.yaml --probes 3 --seconds 120
    """
    robot_file = options.robot_file
    plan = load_probing_plan(existing_file(experiment, "experiment")) if experiment else ProbingPlan()
    _check_channel(channel, robot_file.joint_count, len(plan.targets_world_m))
    folder = out or SESSIONS / options.stamped_name("resolve")
    asked = [plan]
    job = ProbingJob(
        robot_file,
        folder / "probe.mcap",
        plan,
        permission=lambda: ask_for_power(motion_in_words(robot_file, asked[-1]), yes=yes),
        **options.job,
    )

    @contextmanager
    def watch(next_plan: ProbingPlan) -> Iterator[Watcher]:
        asked.append(next_plan)
        with probing_progress(next_plan, live=job.simulated) as watcher:
            yield watcher

    def tell(decision: Decision) -> None:
        talk = console.stderr() if options.as_json else console.stdout()
        talk.print(safe(decision.sentence[:1].upper() + decision.sentence[1:]))

    try:
        resolved = resolve(job, Budget(probes, seconds), channel, tell, watch, diagnosis_progress)
    except KeyboardInterrupt:
        if folder.exists():
            console.stderr().print(f"kept: {shown(folder)}")
        raise
    if options.as_json:
        console.print_json(resolved.as_data())
    else:
        _print(resolved, hidden=options.hidden is not None)


def _print(resolved: Resolved, *, hidden: bool) -> None:
    total = sum(decision.seconds for decision in resolved.decisions)
    done = f"{count(len(resolved.decisions), 'probe')}, {duration(total)}: [bold]{resolved.end}[/bold]"
    console.stdout().print(
        f"\n{done}\nsessions   {shown(resolved.folder)}\ndecisions  {shown(resolved.folder / DECISIONS)}"
    )
    folder = typed(resolved.folder)
    steps = [
        (f"palpate diagnose {folder} --apply", "add what is missing, with all the evidence"),
        (f"palpate compare {folder}", "where the model fails"),
    ]
    if hidden:
        first = typed(resolved.folder / resolved.decisions[0].session)
        steps.append((f"palpate reveal {first}", "what was hidden"))
    console.next_steps(*steps)


def _check_channel(channel: str | None, joint_count: int, target_count: int) -> None:
    """Refuse a channel that no session of this arm and plan has, before the arm moves."""
    names = [*(f"joint_{number}" for number in range(1, joint_count + 1)), "contact"]
    if target_count > 1:  # of places that are near to each other, there is one channel
        names += [f"contact_{number}" for number in range(1, target_count + 1)]
    if channel is not None and channel not in names:
        raise InputError(f"--channel {channel}: there are {', '.join(names)}")
