"""`palpate probe`, `replay` and `resolve`: move an arm, and log every tick."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from rich.markup import escape
from typer import Argument, Option

from palpate.common import console
from palpate.common.console import count, display_path, duration, safe, shell_path
from palpate.common.files import open_session
from palpate.common.options import SessionOutOption, with_options
from palpate.control.loop.result import Outcome
from palpate.control.probing.plan import ProbingPlan
from palpate.render.progress import diagnosis_progress, motion_progress, probing_progress
from palpate.robot_io.errors import InputError
from palpate.robot_io.files.file_model import validate
from palpate.runs.hidden_effects import scenario_of
from palpate.runs.options import (
    SESSIONS,
    RunOptions,
    YesOption,
    ask_for_power,
    describe_motion,
    parse_numbers,
    probing_plan,
)
from palpate.runs.probing import (
    ProbingJob,
    ProbingOutcome,
    ReplayJob,
    Watcher,
    online_estimators,
    references_of,
    run_probing,
    run_replay,
)
from palpate.runs.robots import describe_wires
from palpate.runs.session import raise_for_end

if TYPE_CHECKING:
    from palpate.workflows.resolve import ProbeDecision

MILLI = 1e-3
NO_ESTIMATOR = "none"


_SPEED_MM_S = "Approach speeds, such as 150,90,60; default: the plan's."
_EXPERIMENT = "Probing plan (YAML); the options below replace its values."
_FORCE_LIMIT_N = "Load up to this force; default: the plan's."
_ONLINE = f"Estimator to run while probing: {', '.join(online_estimators())}, or none."


@with_options(RunOptions)
def probe_command(
    options: RunOptions,
    *,
    experiment: Annotated[Path | None, Option(help=_EXPERIMENT)] = None,
    speed_mm_s: Annotated[str | None, Option(help=_SPEED_MM_S, metavar="MM/S,...")] = None,
    force_limit_n: Annotated[float | None, Option(help=_FORCE_LIMIT_N, metavar="N")] = None,
    hold_s: Annotated[float | None, Option(help="Hold duration; default: the plan's.", metavar="S")] = None,
    repeats: Annotated[int | None, Option(help="Repetitions of all speeds; default: the plan's.")] = None,
    out: SessionOutOption = None,
    online: Annotated[str, Option(help=_ONLINE)] = "rls",
    yes: YesOption = False,
) -> None:
    """Probe an object: approach at several speeds, touch it, load to a force, hold, retract.

    Without a robot file, this runs in simulation. The session file records every control cycle (tick).

    A real arm gets power only after a confirmation (or --yes) and a countdown.
    """
    robot_file = options.robot_file
    settings = {"force_limit_n": force_limit_n, "hold_s": hold_s, "repeats": repeats}
    changes: dict[str, Any] = {key: value for key, value in settings.items() if value is not None}
    if speed_mm_s is not None:
        speeds_mm_s = parse_numbers("--speed-mm-s", speed_mm_s, ", such as 150,90,60")
        if not all(0 < speed <= 1000 for speed in speeds_mm_s):
            raise InputError(f"--speed-mm-s {speed_mm_s!r}: each speed must be above 0 and at most 1000 mm/s")
        changes["speeds_m_s"] = [MILLI * speed for speed in speeds_mm_s]
    plan = probing_plan(experiment)
    try:
        plan = validate(ProbingPlan, plan.model_dump() | changes)
    except InputError as error:  # from plan and options combined
        key, _, problem = str(error).partition(": ")
        is_option = key in changes and key != "speeds_m_s"  # its option has another unit
        message = f"--{key.replace('_', '-')}: {problem}" if is_option else f"probing plan: {error}"
        raise InputError(message) from error
    if online not in (NO_ESTIMATOR, *online_estimators()):
        raise InputError(
            f"--online {online}: no such estimator. Valid: {', '.join(online_estimators())}, {NO_ESTIMATOR}"
        )
    job = ProbingJob(
        robot_file,
        options.session_file(out),
        plan,
        online=None if online == NO_ESTIMATOR else online,
        permission=lambda: ask_for_power(describe_motion(robot_file, plan), yes=yes),
        **options.job,
    )
    remark = f"emulated devices: {safe(describe_wires(robot_file))}" if options.wire else ""
    with probing_progress(plan, live=job.simulated, remark=remark) as watcher:
        outcome = run_probing(job, watcher)
    console.present(outcome.as_data(), lambda: _print(outcome, len(plan.runs())), as_json=options.as_json)
    outcome.raise_for_failure()


def _print(outcome: ProbingOutcome, planned: int) -> None:
    loop, out = outcome.loop, console.stdout()
    faster = ""
    if loop.wall_s < 0.9 * loop.duration_s:
        ratio = loop.duration_s / loop.wall_s
        faster = f", {ratio:.{1 if ratio < 10.0 else 0}f} times real time"
    if loop.outcome is Outcome.FINISHED:
        done = "planned" if outcome.failures else "done"
    else:
        done = f"planned, [red]{loop.outcome}[/red]: {safe(loop.cause)}"
    if outcome.failures:
        done += f", [yellow]{count(len(outcome.failures), 'failure')}[/yellow]"
    took = f"{duration(loop.duration_s)} of motion in {duration(loop.wall_s)}{faster}"
    out.print(f"{count(planned, 'run')} {done}: {took}")
    for failure in outcome.failures:
        out.print(f"  [yellow]{safe(failure)}[/yellow]")
    if not loop.is_clean:
        out.print(f"  [yellow]{safe(loop.one_line())}[/yellow]")
    if stuck := loop.outcome is Outcome.TRIPPED and loop.ticks == 0:
        out.print(
            "  nothing has moved. Correct the failure above (bring a joint outside its limits back by hand, "
            "without power), and start again"
        )
    session = shell_path(outcome.session)
    console.say(f"written: [bold]{display_path(outcome.session)}[/bold]")
    if outcome.sealed:
        reveal = f"to open it: palpate reveal {escape(session)}"
        console.say(f"sealed:  [bold]{display_path(outcome.sealed)}[/bold] ({reveal})")
    steps = []
    if outcome.touched:
        steps += [
            (f"palpate estimate {session}", "stiffness and damping with their intervals"),
            (f"palpate compare {session}", "how well a spring and damper fit, and where they fail"),
            (f"palpate diagnose {session}", "which physical effect is missing"),
        ]
    if not stuck:
        steps.append((f"palpate inspect {session}", "see it in Rerun"))
    console.next_steps(*steps, (f"palpate info {session}", "what is in the file"))


@with_options(RunOptions, "robot")
def replay_command(
    options: RunOptions,
    *,
    session: Annotated[Path, Argument(help="Probing session (.mcap) whose motion is repeated.")],
    out: SessionOutOption = None,
    yes: YesOption = False,
) -> None:
    """Repeat the joint motion of a session, in a simulated world or with a real arm.

    --scenario sets the simulated world; default: that of the session, without its hidden effects. A real
    arm gets power only after a confirmation (or --yes) and a countdown. The guard stops the arm at its
    limits; the force is not controlled.

    Example: compare a recording with its simulated twin:
      palpate export real.mcap -o twin.yaml
      palpate replay real.mcap --scenario twin.yaml -o twin.mcap
      palpate compare real.mcap twin.mcap
    """
    recorded = open_session(session)
    references, robot_file = references_of(recorded), options.robot_file
    file = options.session_file(out, "replay", keep=[session])
    runs = len(np.unique(references.run[references.run >= 0]))
    motion = (
        f"'{robot_file.name}' will move: it repeats {count(runs, 'run')} of {session.name}, "
        f"{duration(references.duration_s)}. The guard stops the arm beyond {robot_file.limits.force_n:g} N."
    )
    job = ReplayJob(
        robot_file, file, recorded, permission=lambda: ask_for_power(motion, yes=yes), **options.job
    )
    if job.simulated and job.scenario is None:
        job = replace(job, scenario=scenario_of(recorded))
    with motion_progress("repeating the motion", live=job.simulated) as watcher:
        result, sealed = run_replay(job, references, watcher)
    finished = result.outcome is Outcome.FINISHED
    done = "done" if finished else f"[red]{result.outcome}[/red]: {safe(result.cause)}"

    def show() -> None:
        console.stdout().print(f"{count(runs, 'run')} repeated, {done}")
        console.say(f"written: [bold]{display_path(file)}[/bold]")

    content = {"session": str(file), "replay_of": str(session), "outcome": str(result.outcome)}
    console.present(
        content | {"cause": result.cause, "sealed": str(sealed) if sealed else None},
        show,
        [
            (f"palpate compare {shell_path(session)} {shell_path(file)}", "compare both sessions"),
            (f"palpate inspect {shell_path(file)}", "see it in Rerun"),
        ],
        as_json=options.as_json,
    )
    raise_for_end(result)


_SECONDS = "Maximum probing time; the first probe always runs."


@with_options(RunOptions)
def resolve_command(
    options: RunOptions,
    *,
    experiment: Annotated[Path | None, Option(help="Plan (YAML) of the first probe.")] = None,
    probes: Annotated[int, Option(help="Maximum number of probes, including the first.", min=1, max=50)] = 4,
    seconds: Annotated[float, Option(help=_SECONDS, metavar="S", min=1.0, max=36000.0)] = 300.0,
    channel: Annotated[str | None, Option(help="Explain only this channel, such as joint_2.")] = None,
    out: Annotated[Path | None, Option("--out", "-o", help="Folder for sessions.", metavar="FOLDER")] = None,
    yes: YesOption = False,
) -> None:
    """Probe, diagnose and run the most informative experiment, until one explanation is left.

    After the first probe, each experiment is the feasible plan that is expected to separate the
    explanations best. Decisions are printed and logged beside the sessions. Other commands accept
    the folder as one measurement. A real arm gets power only after a confirmation of each probe (or --yes).
    Ctrl-C keeps the recorded data.

    Examples:
      palpate resolve --hidden random --seed 7
      palpate resolve --robot my_arm.yaml --probes 3 --seconds 120
    """
    from palpate.workflows.resolve import DECISIONS, resolve  # noqa: PLC0415, the study takes a second

    robot_file = options.robot_file
    plan = probing_plan(experiment)
    # Refuse a channel that no session of this arm and plan has, before the arm moves.
    names = [*(f"joint_{number}" for number in range(1, robot_file.joint_count + 1)), "contact"]
    if len(plan.targets_world_m) > 1:  # nearby places share one channel
        names += [f"contact_{number}" for number in range(1, len(plan.targets_world_m) + 1)]
    if channel is not None and channel not in names:
        raise InputError(f"--channel {channel}: no such channel. Available: {', '.join(names)}")
    folder = out or SESSIONS / options.stamped_name("resolve")
    plans = [plan]
    job = ProbingJob(
        robot_file,
        folder / "probe.mcap",
        plan,
        permission=lambda: ask_for_power(describe_motion(robot_file, plans[-1]), yes=yes),
        **options.job,
    )

    @contextmanager
    def watch(next_plan: ProbingPlan) -> Iterator[Watcher]:
        plans.append(next_plan)
        with probing_progress(next_plan, live=job.simulated) as watcher:
            yield watcher

    def tell(decision: "ProbeDecision") -> None:
        output = console.stderr() if options.as_json else console.stdout()
        output.print(safe(decision.sentence[:1].upper() + decision.sentence[1:]))

    try:
        resolved = resolve(job, probes, seconds, channel, tell, watch, diagnosis_progress)
    except KeyboardInterrupt:
        if folder.exists():
            console.stderr().print(f"kept: {display_path(folder)}")
        raise

    def show() -> None:
        total = sum(decision.seconds for decision in resolved.decisions)
        done = f"{count(len(resolved.decisions), 'probe')}, {duration(total)}: [bold]{resolved.end}[/bold]"
        log = display_path(resolved.folder / DECISIONS)
        console.stdout().print(f"\n{done}\nsessions   {display_path(resolved.folder)}\ndecisions  {log}")

    study = shell_path(resolved.folder)
    steps = [
        (f"palpate diagnose {study} --apply", "add the missing effects, with the evidence of all probes"),
        (f"palpate compare {study}", "where the model fails"),
    ]
    if options.hidden is not None:
        first = shell_path(resolved.folder / resolved.decisions[0].session)
        steps.append((f"palpate reveal {first}", "what was hidden"))
    console.present(resolved.as_data(), show, steps, as_json=options.as_json)
