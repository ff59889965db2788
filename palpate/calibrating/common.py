"""What the four calibrations of the command line have in common: where from, asked what, written where."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from plotly.graph_objects import Figure

from calibration.force.fit import ForceFit
from palpate import console
from palpate.arm.driver_packages import importable
from palpate.arm.hiding import command_line
from palpate.arm.permission import Permission, ask_for_pose, ask_for_power, without_question
from palpate.arm.robots import find_robot
from palpate.calibrating import run as calibrating
from palpate.calibrating.bench import Bench, CalibrationJob, Stamp, open_recorded
from palpate.calibrating.next_steps import NamedRobot, say_how_to_use_it
from palpate.calibrating.options import numbers
from palpate.files import different_files, output_file
from palpate.render.calibration import arm_figure, print_calibration, write_figure
from palpate.render.progress import motion_progress
from palpate.words import AT_REST, shown
from robot_io.calibration import Calibration
from robot_io.errors import InputError, PalpateError
from robot_io.robot_file import RobotFile
from robot_io.session import Session
from sim_backend.scenario import load_scenario

CALIBRATIONS = Path("calibrations")
SESSIONS = Path("sessions")
SHARES = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.55, 0.4, 0.25, 0.1, 0.0)  # of the force limit, simulated weights


@dataclass(frozen=True)
class Output:
    """Where the results go."""

    calibration: Path
    plot: Path


def excite(  # noqa: PLR0917, the options as they come
    kind: str,
    robot: str,
    from_: Path | None,
    out: Path | None,
    session: Path | None,
    valid_days: float,
    scenario: str | None,
    seed: int | None,
    hidden: str | None,
    wire: bool,
    realtime: bool,
    drivers: list[str] | None,
    yes: bool,
    as_json: bool,
) -> None:
    """Torque and gravity: one motion, one fit, two files."""
    robot_file = find_robot(robot)
    output = output_for(out, robot_file, kind, session)
    with ExitStack() as ending:
        raw = from_
        if raw is None:
            ask = question_before(kind, robot_file, None, yes)
            job = job_of(kind, robot_file, session, scenario, seed, hidden, wire, realtime, drivers, ask)
            ending.enter_context(told_of_the_end(job))
            with motion_progress("moving in free air", live=job.simulated) as watcher:
                calibrating.run_motion(job, watcher=watcher)
            raw = job.session
        fit = calibrating.arm_fit_of(
            open_recorded(raw, kind, robot_file), robot_file.urdf_path, robot_file.tip_frame
        )
        make = calibrating.torque_calibration if kind == "torque" else calibrating.gravity_calibration
        calibration = make(fit, stamp_of(robot_file, raw, valid_days))
        whose = NamedRobot(robot, robot_file, drivers)
        finish(calibration, output, lambda: arm_figure(fit), raw, whose, as_json)


def job_of(  # noqa: PLR0917, the options as they come
    kind: str,
    robot_file: RobotFile,
    session: Path | None,
    scenario: str | None,
    seed: int | None,
    hidden: str | None,
    wire: bool,
    realtime: bool,
    drivers: list[str] | None,
    permission: Permission = without_question,
) -> CalibrationJob:
    """The job that these options describe."""
    return CalibrationJob(
        kind=kind,
        robot_file=robot_file,
        session=output_file(session or SESSIONS / f"{stamped_name(robot_file, kind)}.mcap"),
        scenario=load_scenario(scenario) if scenario is not None else None,
        seed=seed,
        hidden=hidden,
        wired=wire,
        paced=realtime,
        drivers=importable(drivers or []),
        command_line=command_line(sys.argv[1:], hidden),
        permission=permission,
    )


def question_before(kind: str, robot_file: RobotFile, pose_rad: list[float] | None, yes: bool) -> Permission:
    """What is asked before a real arm is moved, or read in a pose."""
    if pose_rad is not None:
        return lambda: ask_for_pose(pose_rad, yes=yes)
    motion = f"'{robot_file.name}' is going to move: {calibrating.motion_in_words(kind, robot_file.limits)}."
    return lambda: ask_for_power(motion, yes=yes)


def stamped_name(robot_file: RobotFile, kind: str) -> str:
    """A name that nobody has used yet."""
    stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    return f"{stamp}-{robot_file.name}-{kind}"


def output_for(out: Path | None, robot_file: RobotFile, kind: str, session: Path | None) -> Output:
    """Where calibration and picture go; nothing is there yet.

    Raises:
        InputError: something is there, or nothing can be written there.
    """
    path = output_file(out or CALIBRATIONS / f"{stamped_name(robot_file, kind)}.yaml")
    plot = output_file(path.with_suffix(".html"))
    different_files(path, plot, session)
    return Output(path, plot)


def stamp_of(robot_file: RobotFile, raw: Path, valid_days: float) -> Stamp:
    """What a calibration says of its making; those applied in its session are named."""
    made_with: tuple[str, ...] = ()
    if raw.suffix == ".mcap":
        found = Session.open(raw).metadata.calibration
        made_with = tuple(
            line.rstrip(":") for line in found.splitlines() if line and not line.startswith(" ")
        )
    return Stamp(robot_file, raw, _made_utc(raw), valid_days, made_with)


def _made_utc(raw: Path) -> datetime:
    """When what was recorded was recorded; a data file says nothing of that."""
    if raw.suffix != ".mcap":
        return calibrating.now()
    return datetime.fromisoformat(Session.open(raw).metadata.created_utc)


def forces_from(
    weights_kg: str | None, robot_file: RobotFile, gravity_m_s2: float, *, simulated: bool
) -> list[float]:
    """The forces that are put on, one after the other [N].

    Raises:
        InputError: nobody said which, and they cannot be chosen; or one is negative.
    """
    if weights_kg is not None:
        masses_kg = numbers("--weights-kg", weights_kg)
        if min(masses_kg) < 0:
            raise InputError(f"--weights-kg {weights_kg!r}: no mass is below 0 kg")
        return [mass_kg * gravity_m_s2 for mass_kg in masses_kg]
    if not simulated:
        raise InputError("--weights-kg: say which masses you have, up and down, such as 0,0.5,1,2,1,0.5,0")
    return [share * robot_file.limits.force_n for share in SHARES]


def ask_for_weight(gravity_m_s2: float) -> calibrating.Place:
    """Somebody who puts the weights on, and is waited for."""

    def ask(bench: Bench, number: int, force_n: float) -> None:
        weight = f"{force_n / gravity_m_s2:.4g} kg ({force_n:.3f} N)"
        console.stderr().print(f"{number + 1}: put {weight} on the sensor, let it come to rest, press Enter")
        if not sys.stdin.readline():
            words = "weights are put on by hand: run this in a terminal"
            if number == 0:
                raise InputError(words)
            raise PalpateError(f"no answer at weight {number + 1}: {words}")  # what was weighed stays

    return ask


@contextmanager
def told_of_the_end(job: CalibrationJob) -> Iterator[None]:
    """Say after Ctrl-C how things stand, and after a failure what is left of it, until all is written."""
    try:
        yield
    except PalpateError:
        if job.session.exists():
            left = f"no calibration is written. What was recorded until then stays in {shown(job.session)}"
            console.stderr().print(left, soft_wrap=True)
        raise
    except KeyboardInterrupt:
        said = f"{AT_REST}; no calibration is written"
        if job.session.exists():
            said += f". What was recorded until then stays in {shown(job.session)}"
        console.stderr().print(said, soft_wrap=True)
        raise


def remarks_on(fit: ForceFit) -> list[str]:
    """What a person should know of a fit, beside its numbers."""
    remarks = []
    if fit.plateaus.glitches:
        remarks.append(f"{fit.plateaus.glitches} samples were left out as glitches of the converter")
    if fit.suspect is not None:
        force_n, off_n = fit.plateaus.reference_n[fit.suspect], fit.residual_n[fit.suspect]
        remarks.append(
            f"plateau {fit.suspect + 1} ({force_n:.4g} N) is {off_n:+.2g} N off, unlike the others: "
            "was it the right weight?"
        )
    return remarks


def finish(  # noqa: PLR0917, what was found and where it goes
    calibration: Calibration,
    output: Output,
    draw: Callable[[], Figure],
    raw: Path,
    whose: NamedRobot,
    as_json: bool,
    remarks: list[str] | None = None,
) -> None:
    """Write file and plot, say what was found, and what to do with it."""
    write_figure(draw(), output.plot)
    calibrating.write_calibration(calibration, output.calibration)
    if as_json:
        written = {"file": str(output.calibration), "plot": str(output.plot), "raw": str(raw)}
        console.print_json(written | calibration.model_dump(mode="json"))
        return
    out = console.stdout()
    print_calibration(out, calibration, remarks or [])
    files = f"[bold]{shown(output.calibration)}[/bold], residuals: [bold]{shown(output.plot)}[/bold]"
    out.print(f"written: {files}", soft_wrap=True)
    out.print(f"from:    {shown(raw)}", soft_wrap=True)
    say_how_to_use_it(calibration, output.calibration.resolve(), whose)
