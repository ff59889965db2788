"""`palpate teleop`: teleoperate through a virtual object that is updated from the real one."""

import sys
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

from typer import Option

from palpate.common import console
from palpate.common.console import as_command, command_group, count, display_path, safe, shell_path
from palpate.common.files import existing_file, output_session
from palpate.common.options import JsonOption, SessionOutOption, scenario_names, with_options
from palpate.control.loop.result import Outcome
from palpate.control.probing.plan import ProbingPlan
from palpate.control.teleop.follower_task import SilenceAction
from palpate.control.teleop.leader_arm import OPERATOR_DEVICES, LeaderArm, build_operator
from palpate.render.terminal import print_files
from palpate.robot_io.clock import MonotonicClock
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.link.connection import Impairment, LinkSettings
from palpate.robot_io.link.frame import load_seal
from palpate.robot_io.robot_file import load_robot_file
from palpate.robot_io.session import SessionMetadata
from palpate.runs.options import (
    SESSIONS,
    RunOptions,
    YesOption,
    ask_for_power,
    parse_numbers,
    probing_plan,
    time_stamp,
)
from palpate.runs.robots import find_robot, robot_names
from palpate.runs.session import SOURCE, raise_for_end
from palpate.sim_backend.scenario import load_scenario, shipped_scenarios
from palpate.teleop.demo import run_demo
from palpate.teleop.follower import FollowerJob, run_follower
from palpate.teleop.haptics import HapticJob
from palpate.teleop.leader import run_leader

MILLI, PERCENT = 1e-3, 0.01
# Starts well above the target: an operator who has felt nothing yet may place it too low.
PLAN = ProbingPlan(hold_s=0.4, approach_clearance_m=0.08)

group = command_group(
    """Teleoperate through a virtual object whose model is estimated from the real one.

The operator moves a virtual arm, feels a virtual object and chooses places to probe (leader). Only these
places are sent. Another arm probes them by itself (follower) and sends back a model of the object; the
virtual object is updated with this model.

[bold]palpate teleop demo --out DIR[/bold] runs both on this machine, without a device or an arm."""
)
_NAME = "Name of the pair of leader and follower; the same on both sides."
NameOption = Annotated[str, Option("--name", help=_NAME)]
_PORT = "Port on this machine's loopback; used if --link is not given."
PortOption = Annotated[int, Option("--port", help=_PORT)]
_LINK = "zenoh configuration (JSON5): endpoints, router, certificates."
LinkOption = Annotated[Path | None, Option("--link", help=_LINK, metavar="FILE")]
_KEY = "Secret key file, the same on both sides; messages signed with another key are refused."
KeyOption = Annotated[Path | None, Option("--key", help=_KEY, metavar="FILE")]
_BAD_NETWORK = "For tests: delay and jitter (ms) and loss (%) of this side's messages, such as 500,20,10."
BadNetworkOption = Annotated[str | None, Option("--bad-network", help=_BAD_NETWORK, metavar="MS,MS,%")]


_ON_SILENCE = "What to do with the current target if the leader is silent."


@group.command()
@with_options(RunOptions)
def follower(
    options: RunOptions,
    *,
    experiment: Annotated[Path | None, Option(help="Probing plan (YAML) for every target.")] = None,
    on_silence: Annotated[SilenceAction, Option(help=_ON_SILENCE)] = SilenceAction.FINISH,
    diagnose: Annotated[bool, Option(help="Diagnose which effects the contact law lacks.")] = True,
    name: NameOption = "arm",
    port: PortOption = 7447,
    link: LinkOption = None,
    key: KeyOption = None,
    bad_network: BadNetworkOption = None,
    out: SessionOutOption = None,
    yes: YesOption = False,
) -> None:
    """Probe the places that a leader chooses, and send back a model of the object.

    The arm holds still unless messages of a leader arrive. The follower's own plan sets speed and force;
    its guard stops the arm at the limits, whatever the messages say. A real arm gets power only after a
    confirmation (or --yes) and a countdown.

    Examples:
      palpate teleop follower --scenario stiff -o follower.mcap
      palpate teleop follower --robot my_arm.yaml --experiment gentle.yaml --link router.json5
    """
    robot_file = options.robot_file
    plan = probing_plan(experiment, PLAN)
    speeds = ", ".join(f"{speed / MILLI:g}" for speed in plan.speeds_m_s)
    motion = (
        f"'{robot_file.name}' will move to every place that a leader chooses, and probe it at {speeds} "
        f"mm/s, pressing with {plan.force_limit_n:g} N. The guard stops the arm beyond "
        f"{robot_file.limits.force_n:g} N."
    )
    job = FollowerJob(
        robot_file,
        options.session_file(out, "teleop"),
        plan,
        permission=lambda: ask_for_power(motion, yes=yes),
        link=_link_settings(name, port, link, key, bad_network),
        on_silence=on_silence,
        diagnose=diagnose,
        **{**options.job, "paced": True},
    )
    stderr = console.stderr()
    outcome = run_follower(job, lambda text: stderr.print(safe(text)))
    targets = {str(number): state.name.lower() for number, state in outcome.states.items()}

    def show() -> None:
        is_finished = outcome.loop.outcome is Outcome.FINISHED
        end = "" if is_finished else f"; [red]{safe(outcome.loop.one_line())}[/red]"
        sent = count(outcome.estimates, "estimate")
        console.stdout().print(f"{_state_summary(targets)}; {sent} sent{end}")
        if outcome.messaging_error:
            console.stdout().print(f"  [yellow]the link failed: {safe(outcome.messaging_error)}[/yellow]")
        console.say(f"written: [bold]{display_path(job.session)}[/bold]")

    content = {
        "session": str(job.session),
        "outcome": str(outcome.loop.outcome),
        "cause": outcome.loop.cause,
        "targets": targets,
        "estimates": outcome.estimates,
        "overruns": outcome.loop.overruns,
        "link_error": outcome.messaging_error,
    }
    session = shell_path(job.session)
    steps = {
        f"palpate estimate {session}": "stiffness and damping of every place",
        f"palpate inspect {session}": "name the leader's session first to show both on one timeline",
    }
    if not outcome.estimates:
        steps = {"palpate teleop leader": "chooses places to probe"}
    console.present(content, show, steps.items(), as_json=options.as_json)
    raise_for_end(outcome.loop)


def _state_summary(states: Mapping[int, str] | Mapping[str, str]) -> str:
    """Describe what became of each target, such as "target 0: done, target 1: queued"."""
    return ", ".join(f"target {number}: {state}" for number, state in states.items()) or "no target"


_OPERATOR = f"{', '.join(OPERATOR_DEVICES)}, or a YAML file with the settings of one of these."
_ROBOT = "Virtual arm that the operator moves: shipped, or a file."
_SCENARIO = "Virtual object that the operator feels before the first estimate."
_JUMP_N = "Largest change of force per millisecond when the model is updated."


@group.command()
def leader(  # noqa: PLR0917, one parameter an option
    operator: Annotated[str, Option("--operator", help=_OPERATOR, metavar="DEVICE|FILE")] = "keyboard",
    robot: Annotated[str, Option(help=_ROBOT, autocompletion=robot_names)] = "leader",
    scenario: Annotated[
        str, Option(help=_SCENARIO, metavar="WORLD", autocompletion=scenario_names)
    ] = "default",
    jump_n: Annotated[float, Option(help=_JUMP_N, metavar="N")] = 0.05,
    name: NameOption = "arm",
    port: PortOption = 7447,
    link: LinkOption = None,
    key: KeyOption = None,
    bad_network: BadNetworkOption = None,
    out: SessionOutOption = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Move a virtual arm, feel a virtual object, and choose places for the follower to probe.

    The device's button chooses the place below the tip; pressing it there again cancels that target.
    Every estimate from the follower updates the virtual object, and its uncertainty is shown. An arm used
    as device (leader_arm) gets power only after a confirmation (or --yes) and a countdown.

    Examples:
      palpate teleop leader --operator gamepad -o leader.mcap
      palpate teleop leader --operator touch.yaml --link router.json5
    """
    command_line = as_command(sys.argv[1:])
    device = build_operator(operator, MonotonicClock())  # checks the file before anything starts
    scene, robot_file = load_scenario(scenario), find_robot(robot)
    session = output_session(out or SESSIONS / f"{time_stamp()}-leader.mcap")
    metadata = SessionMetadata(
        robot_file=robot_file.text,
        urdf=robot_file.urdf_path.read_text(encoding="utf-8"),
        scenario=scene.public_yaml(),
        software_version=version("palpate"),
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        command_line=command_line,
        extra={SOURCE: "leader"},
    )
    haptics = HapticJob(robot, operator, scene, session, metadata, largest_jump_n=jump_n)
    line = _link_settings(name, port, link, key, bad_network)
    if isinstance(device, LeaderArm):
        arm = load_robot_file(device.settings.robot)
        torques = ", ".join(f"{torque:g}" for torque in arm.limits.torque_nm)
        ask_for_power(
            f"'{arm.name}' will carry its own weight and push against the hand that holds it, "
            f"with joint torques of at most {torques} N m.",
            yes=yes,
        )
    stderr = console.stderr()
    with stderr.status("starting") as status:
        outcome = run_leader(
            haptics, line, lambda text: stderr.print(safe(text)), lambda text: status.update(safe(text))
        )

    def show_outcome() -> None:
        received = count(outcome.estimates, "estimate")
        console.stdout().print(f"{_state_summary(outcome.states)}; {received} received")
        if (late := outcome.lateness) is not None:
            console.stdout().print(
                f"haptic loop: {late.count} ticks; 99 % are at most {1e6 * late.p99_s:.0f} us late, "
                f"99.9 % at most {1e6 * late.p999_s:.0f} us"
            )
        console.say(f"written: [bold]{display_path(session)}[/bold]")

    both = "show both sessions on one timeline (give the follower's session, too)"
    again = "the follower sent nothing; run it with the same options"
    inspect = f"palpate inspect {shell_path(session)} FOLLOWER.mcap"
    steps = [(inspect, both) if outcome.heard else ("palpate teleop follower --help", again)]
    content = {"session": str(session), **asdict(outcome)}
    console.present(content, show_outcome, steps, as_json=as_json)
    if not outcome.heard:
        raise PalpateError("no follower answered: nothing was probed")
    if outcome.unfinished:
        targets = ", ".join(f"target {number}" for number in outcome.unfinished)
        raise PalpateError(f"the follower did not finish {targets}: it ended, fell silent or took too long")


_DEMO_SCENARIO = (
    f"Simulated object of the follower: a scenario file, or one of {', '.join(shipped_scenarios())}."
)


@group.command()
def demo(
    out: Annotated[Path, Option("--out", "-o", help="Output folder.", metavar="DIR")],
    scenario: Annotated[str, Option(help=_DEMO_SCENARIO, autocompletion=scenario_names)] = "stiff",
    bad_network: BadNetworkOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run both sides as two processes on this machine, with a scripted operator; takes less than a minute.

    The operator chooses two places and presses on a virtual object that is a guess at first. At the end,
    the demo states the difference between the felt and the real force, and warns if the machine was too slow.

    Examples:
      palpate teleop demo --out teleop-demo
      palpate teleop demo --out far --scenario hunt_crossley --bad-network 500,20,10
    """
    _link_settings("arm", 7447, None, None, bad_network)  # checks the option before anything starts
    network = [] if bad_network is None else ["--bad-network", bad_network]
    with console.stderr().status("leader and follower are running (about 30 s)"):
        made = run_demo(out, load_scenario(scenario), network)
    if as_json:
        files = {what: str(path) for what, path in made.files.items()}
        console.print_json(
            {
                "files": files,
                "felt_share": made.rendered.settled().share,
                "felt_share_with_all": made.rendered.share,
                "verdicts": made.merged.verdicts(),
                "model_share": made.modeled.share,
                "clock_offset_s": made.merged.offset_s,
                "missed_tick_share": made.merged.missed_share,
                "slipped_clock_share": made.merged.slipped_share,
                "too_slow": made.slowness_summary(),
            }
        )
        return
    sessions = " ".join(shell_path(made.files[side]) for side in ("leader", "follower"))
    print_files(console.stdout(), made.files)
    console.stdout().print(f"models compared with the follower's own measurements: {made.modeled.summary()}")
    known = made.merged.verdicts().items()
    verdicts = [f"target {number} {verdict or 'none before the end'}" for number, verdict in known]
    console.say(f"verdicts of the diagnosis: {', '.join(verdicts) or 'nothing was probed before the end'}")
    console.next_steps(
        (f"palpate inspect {sessions}", "both sides on one timeline"),
        (f"palpate estimate {shell_path(made.files['follower'])}", "stiffness and damping of every place"),
    )
    console.say(made.force_summary())
    if slowness := made.slowness_summary():
        console.say(f"[yellow]{slowness}[/yellow]")


def _link_settings(
    name: str, port: int, config: Path | None, key: Path | None, bad_network: str | None
) -> LinkSettings:
    impairment = None
    if bad_network is not None:
        parts = parse_numbers("--bad-network", bad_network, ", such as 500,20,10")
        if len(parts) != 3:
            raise InputError(f"--bad-network {bad_network!r}: give delay, jitter [ms] and loss [%]")
        impairment = Impairment(MILLI * parts[0], MILLI * parts[1], PERCENT * parts[2])
    if config is not None:
        existing_file(config, "zenoh configuration")
    if key is not None:
        load_seal(existing_file(key, "key"), name)  # checks the key before anything starts
    return LinkSettings(name, port, config, key, impairment)
