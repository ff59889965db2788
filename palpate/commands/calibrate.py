"""`palpate calibrate`: find out how force sensor, encoders, drives and base differ from what they say."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from matplotlib.figure import Figure

from calibration.force.fit import ForceFit, fit_force
from calibration.force.reference_file import STANDARD_GRAVITY_M_S2, read_reference_file
from calibration.force.weighing import read_weighing
from estimation.data.import_options import parse_pairs
from palpate import console
from palpate.arm import calibration_run as calibrating
from palpate.arm.calibration_setup import Bench, CalibrationJob, Stamp, open_recorded
from palpate.arm.driver_packages import importable
from palpate.arm.permission import Permission, ask_for_pose, ask_for_power, without_question
from palpate.arm.robots import DEFAULT, find_robot
from palpate.calibration_options import (
    DriversOption,
    FromOption,
    HiddenOption,
    JsonOption,
    OutOption,
    RealtimeOption,
    RobotOption,
    ScenarioOption,
    SeedOption,
    SessionOption,
    ValidOption,
    WireOption,
    YesOption,
    joint_angles,
    numbers,
    stops_of,
)
from palpate.files import different_files, existing_file, output_file, whole_file
from palpate.text.calibration import print_calibration
from palpate.text.calibration_progress import motion_progress, weighing_progress
from palpate.text.calibration_use import NamedRobot, say_how_to_use_it
from palpate.views import style
from palpate.views.plots.calibration import arm_figure, encoder_figure, force_figure
from palpate.words import shown
from robot_io.calibration import Calibration
from robot_io.errors import InputError
from robot_io.robot_file import RobotFile
from robot_io.session import Session
from sim_backend.scenario import load_scenario

CALIBRATIONS = Path("calibrations")
SESSIONS = Path("sessions")
SHARES = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.55, 0.4, 0.25, 0.1, 0.0)  # of the force limit, simulated weights
YEAR = 365.0
PERCENT = 0.01

group = typer.Typer(
    rich_markup_mode="rich",
    add_completion=False,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@group.callback()
def root(context: typer.Context) -> None:
    """Find out how force sensor, encoders, drives and base differ from what they say.

    Each writes one YAML file; name it in the robot file, and every measurement and command is corrected:

    calibration: {force: force.yaml, encoder: encoder.yaml}

    Do [bold]encoder[/bold] first, then [bold]gravity[/bold] and [bold]torque[/bold]; force at any time.

    The arm moves under its guard. Ctrl-C brings it to rest, and no calibration is written.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
    made = [folder for folder in (CALIBRATIONS, SESSIONS) if not folder.exists()]
    context.call_on_close(lambda: _remove_empty(made))


def _remove_empty(folders: list[Path]) -> None:
    """Leave no folder behind where nothing came of the calibration."""
    for folder in folders:
        with suppress(OSError):  # there is something in it, or it was never made
            folder.rmdir()


@dataclass(frozen=True)
class Output:
    """Where the results go."""

    calibration: Path
    plot: Path


@group.command()
def force(  # noqa: PLR0917, one parameter an option
    robot: RobotOption = DEFAULT,
    from_: Annotated[
        Path | None,
        typer.Option(
            "--from", help="Data file (CSV, Parquet, NPZ) or session; nothing is read.", metavar="FILE"
        ),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            help="What reading, reference or settled is called in the data file.", metavar="ROLE=COLUMN"
        ),
    ] = None,
    reading_unit: Annotated[
        str | None, typer.Option(help="Unit of the readings, if the column's name does not end with it.")
    ] = None,
    weights_kg: Annotated[
        str | None,
        typer.Option(
            help="Masses to put on the sensor, in this order, such as 0,1,2,4,2,1,0.", metavar="KG,..."
        ),
    ] = None,
    gravity_m_s2: Annotated[float, typer.Option(help="What makes a mass a weight.", min=9.7, max=9.9)] = (
        STANDARD_GRAVITY_M_S2
    ),
    reference_percent: Annotated[
        float,
        typer.Option(
            help="Standard uncertainty of all references together.", metavar="PERCENT", min=0, max=50
        ),
    ] = 0.0,
    out: OutOption = None,
    session: SessionOption = None,
    valid_days: ValidOption = YEAR,
    scenario: ScenarioOption = None,
    seed: SeedOption = None,
    hidden: HiddenOption = None,
    wire: WireOption = False,
    realtime: RealtimeOption = False,
    drivers: DriversOption = None,
    as_json: JsonOption = False,
) -> None:
    """Force sensor: scale, zero and curvature, from known weights or somebody's data; hysteresis is reported.

    On the robot: without power, the sensor's axis upright, you put on weight after weight, up and down.

    From a file: one row a sample, with columns for the reading and for the reference.
    """
    robot_file = find_robot(robot)
    output = _output(out, robot_file, "force", session)
    unit = "N"
    if from_ is not None and from_.suffix != ".mcap":
        raw, columns = existing_file(from_, "data"), parse_pairs(column or (), "--column")
        plateaus, unit = read_reference_file(
            raw, columns, gravity_m_s2=gravity_m_s2, reading_unit=reading_unit
        )
    else:
        if from_ is None:
            forces_n = _forces(
                weights_kg, robot_file, gravity_m_s2, simulated=wire or _is_simulated(robot_file)
            )
            job = _job("force", robot_file, session, scenario, seed, hidden, wire, realtime, drivers)
            with _told_of_the_end(job), weighing_progress(len(forces_n), live=job.simulated) as told:
                place = calibrating.put_simulated_weight if job.simulated else _ask_for_weight(gravity_m_s2)
                calibrating.run_weighing(job, forces_n, place, told=told)
        raw = from_ or job.session
        plateaus = read_weighing(open_recorded(raw, "force", robot_file))
    fit = fit_force(plateaus, PERCENT * reference_percent)
    stamp = _stamp(robot_file, raw, valid_days)
    calibration = calibrating.force_calibration(fit, unit, stamp)
    _finish(
        calibration,
        output,
        lambda: force_figure(fit, unit),
        raw,
        NamedRobot(robot, robot_file, drivers),
        as_json,
        _remarks(fit),
    )


@group.command()
def encoder(  # noqa: PLR0917, one parameter an option
    robot: RobotOption = DEFAULT,
    pose: Annotated[
        str | None,
        typer.Option(
            help="The arm is held here: 'home', or one angle per joint. Nothing moves.", metavar="RAD,..."
        ),
    ] = None,
    lower_stops: Annotated[
        str | None, typer.Option(help="Lower hard stops; without, the URDF's limits.", metavar="RAD,...")
    ] = None,
    upper_stops: Annotated[
        str | None, typer.Option(help="Upper hard stops; without, the URDF's limits.", metavar="RAD,...")
    ] = None,
    known_mrad: Annotated[
        float, typer.Option(help="Standard uncertainty of stops or pose.", metavar="MRAD", min=0, max=100)
    ] = 1.0,
    from_: FromOption = None,
    out: OutOption = None,
    session: SessionOption = None,
    valid_days: ValidOption = YEAR,
    scenario: ScenarioOption = None,
    seed: SeedOption = None,
    hidden: HiddenOption = None,
    wire: WireOption = False,
    realtime: RealtimeOption = False,
    drivers: DriversOption = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Encoders: the joints' zeros, against hard stops (slowly, with little torque) or in a known pose."""
    robot_file = find_robot(robot)
    output = _output(out, robot_file, "encoder", session)
    pose_rad = None if pose is None else joint_angles("--pose", pose, robot_file)
    raw = from_
    if raw is None:
        ask = _question("encoder", robot_file, pose_rad, yes)
        job = _job("encoder", robot_file, session, scenario, seed, hidden, wire, realtime, drivers, ask)
        if pose_rad is not None:
            with _told_of_the_end(job):
                calibrating.run_pose(job)
        else:
            stops = stops_of(lower_stops, upper_stops, robot_file)
            progress = motion_progress("touching the stops", live=job.simulated)
            with _told_of_the_end(job), progress as watcher:
                calibrating.run_stops(job, stops, watcher)
        raw = job.session
    known_rad = known_mrad / 1e3
    fit = calibrating.encoder_fit_of(
        open_recorded(raw, "encoder", robot_file), robot_file.joint_count, pose_rad, known_rad
    )
    calibration = calibrating.encoder_calibration(fit, _stamp(robot_file, raw, valid_days))
    whose = NamedRobot(robot, robot_file, drivers)
    _finish(calibration, output, lambda: encoder_figure(fit), raw, whose, as_json)


@group.command()
def torque(  # noqa: PLR0917, one parameter an option
    robot: RobotOption = DEFAULT,
    from_: FromOption = None,
    out: OutOption = None,
    session: SessionOption = None,
    valid_days: ValidOption = YEAR,
    scenario: ScenarioOption = None,
    seed: SeedOption = None,
    hidden: HiddenOption = None,
    wire: WireOption = False,
    realtime: RealtimeOption = False,
    drivers: DriversOption = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Drives: gains and offsets of their torques, from a motion in free air against the arm's weight.

    Friction is found beside them and reported; it is not compensated. The URDF's masses are taken as exact.
    """
    robot_file = find_robot(robot)
    ask = _question("torque", robot_file, None, yes)
    job = _job("torque", robot_file, session, scenario, seed, hidden, wire, realtime, drivers, ask)
    _excite(job, NamedRobot(robot, robot_file, drivers), from_, out, valid_days, as_json)


@group.command()
def gravity(  # noqa: PLR0917, one parameter an option
    robot: RobotOption = DEFAULT,
    from_: FromOption = None,
    out: OutOption = None,
    session: SessionOption = None,
    valid_days: ValidOption = YEAR,
    scenario: ScenarioOption = None,
    seed: SeedOption = None,
    hidden: HiddenOption = None,
    wire: WireOption = False,
    realtime: RealtimeOption = False,
    drivers: DriversOption = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Base: how it is tilted, from slow motions through many postures, there and back.

    An arm that moves in one plane feels the tilt in that plane alone. The URDF's masses are taken as exact.
    """
    robot_file = find_robot(robot)
    ask = _question("gravity", robot_file, None, yes)
    job = _job("gravity", robot_file, session, scenario, seed, hidden, wire, realtime, drivers, ask)
    _excite(job, NamedRobot(robot, robot_file, drivers), from_, out, valid_days, as_json)


def _excite(  # noqa: PLR0917, the options as they come
    job: CalibrationJob,
    whose: NamedRobot,
    from_: Path | None,
    out: Path | None,
    valid_days: float,
    as_json: bool,
) -> None:
    """Torque and gravity: one motion, one fit, two files."""
    robot_file = job.robot_file
    output = _output(out, robot_file, job.kind, job.session)
    raw = from_
    if raw is None:
        progress = motion_progress("moving in free air", live=job.simulated)
        with _told_of_the_end(job), progress as watcher:
            calibrating.run_motion(job, watcher=watcher)
        raw = job.session
    fit = calibrating.arm_fit_of(
        open_recorded(raw, job.kind, robot_file), robot_file.urdf_path, robot_file.tip_frame
    )
    make = calibrating.torque_calibration if job.kind == "torque" else calibrating.gravity_calibration
    calibration = make(fit, _stamp(robot_file, raw, valid_days))
    _finish(calibration, output, lambda: arm_figure(fit), raw, whose, as_json)


def _job(  # noqa: PLR0917, the options as they come
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
    return CalibrationJob(
        kind=kind,
        robot_file=robot_file,
        session=output_file(session or SESSIONS / f"{_stamped(robot_file, kind)}.mcap"),
        scenario=load_scenario(scenario) if scenario is not None else None,
        seed=seed,
        hidden=hidden,
        wired=wire,
        paced=realtime,
        drivers=importable(drivers or []),
        command_line=" ".join(["palpate", *sys.argv[1:]]),
        permission=permission,
    )


def _question(kind: str, robot_file: RobotFile, pose_rad: list[float] | None, yes: bool) -> Permission:
    """What is asked before a real arm is moved, or read in a pose."""
    if pose_rad is not None:
        return lambda: ask_for_pose(pose_rad, yes=yes)
    motion = f"'{robot_file.name}' is going to move: {calibrating.motion_in_words(kind)}."
    return lambda: ask_for_power(motion, yes=yes)


def _stamped(robot_file: RobotFile, kind: str) -> str:
    """A name that nobody has used yet."""
    stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    return f"{stamp}-{robot_file.name}-{kind}"


def _output(out: Path | None, robot_file: RobotFile, kind: str, session: Path | None) -> Output:
    path = output_file(out or CALIBRATIONS / f"{_stamped(robot_file, kind)}.yaml")
    plot = output_file(path.with_suffix(".png"))
    different_files(path, plot, session)
    return Output(path, plot)


def _is_simulated(robot_file: RobotFile) -> bool:
    return CalibrationJob("force", robot_file, Path()).simulated


def _stamp(robot_file: RobotFile, raw: Path, valid_days: float) -> Stamp:
    made_with: tuple[str, ...] = ()
    if raw.suffix == ".mcap":
        found = Session.open(raw).metadata.calibration
        made_with = tuple(
            line.rstrip(":") for line in found.splitlines() if line and not line.startswith(" ")
        )
    return Stamp(robot_file, raw, calibrating.now(), valid_days, made_with)


def _forces(
    weights_kg: str | None, robot_file: RobotFile, gravity_m_s2: float, *, simulated: bool
) -> list[float]:
    if weights_kg is not None:
        return [mass * gravity_m_s2 for mass in numbers("--weights-kg", weights_kg)]
    if not simulated:
        raise InputError("--weights-kg: say which masses you have, up and down, such as 0,0.5,1,2,1,0.5,0")
    return [share * robot_file.limits.force_n for share in SHARES]


def _ask_for_weight(gravity_m_s2: float) -> calibrating.Place:
    """Somebody who puts the weights on, and is waited for."""

    def ask(bench: Bench, number: int, force_n: float) -> None:
        weight = f"{force_n / gravity_m_s2:.4g} kg ({force_n:.3f} N)"
        console.stderr().print(f"{number + 1}: put {weight} on the sensor, let it come to rest, press Enter")
        if not sys.stdin.readline():
            raise InputError("weights are put on by hand: run this in a terminal")

    return ask


@contextmanager
def _told_of_the_end(job: CalibrationJob) -> Iterator[None]:
    """Say after Ctrl-C how things stand."""
    try:
        yield
    except KeyboardInterrupt:
        said = "the arm is at rest and without torque; no calibration is written"
        if job.session.exists():
            said += f". What was recorded until then stays in {shown(job.session)}"
        console.stderr().print(said, soft_wrap=True)
        raise


def _remarks(fit: ForceFit) -> list[str]:
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


def _finish(  # noqa: PLR0917, what was found and where it goes
    calibration: Calibration,
    output: Output,
    draw: Callable[[], Figure],
    raw: Path,
    whose: NamedRobot,
    as_json: bool,
    remarks: list[str] | None = None,
) -> None:
    """Write file and plot, say what was found, and what to do with it."""
    with whole_file(output.plot) as unfinished, style.house_style():
        draw().savefig(unfinished)
    calibrating.write_calibration(calibration, output.calibration)
    if as_json:
        written = {"file": str(output.calibration), "plot": str(output.plot), "raw": str(raw)}
        console.print_json(written | calibration.model_dump(mode="json"))
        return
    print_calibration(calibration, remarks or [])
    out = console.stdout()
    files = f"[bold]{shown(output.calibration)}[/bold], residuals: [bold]{shown(output.plot)}[/bold]"
    out.print(f"written: {files}", soft_wrap=True)
    out.print(f"from:    {shown(raw)}", soft_wrap=True)
    say_how_to_use_it(calibration, output.calibration.resolve(), whose)
