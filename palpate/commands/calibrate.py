"""`palpate calibrate`: find out how force sensor, encoders, drives and base differ from what they say."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from calibration.force.fit import fit_force
from calibration.force.reference_file import STANDARD_GRAVITY_M_S2, read_reference_file
from calibration.force.weighing import read_weighing
from estimation.data.import_options import parse_pairs
from palpate.arm.robots import DEFAULT, find_robot
from palpate.arm.wired import is_simulated
from palpate.calibrating import run as calibrating
from palpate.calibrating.bench import open_recorded
from palpate.calibrating.common import (
    ask_for_weight,
    excite,
    finish,
    forces_from,
    job_of,
    output_for,
    question_before,
    remarks_on,
    stamp_of,
    told_of_the_end,
)
from palpate.calibrating.next_steps import NamedRobot
from palpate.calibrating.options import (
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
    pose_of,
    stops_of,
)
from palpate.files import existing_file
from palpate.render.calibration import encoder_figure, force_figure
from palpate.render.progress import motion_progress, weighing_progress
from robot_io.errors import InputError

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
    output = output_for(out, robot_file, "force", session)
    with ExitStack() as ending:
        unit = "N"
        if from_ is not None and from_.suffix != ".mcap":
            raw, columns = existing_file(from_, "data"), parse_pairs(column or (), "--column")
            plateaus, unit = read_reference_file(
                raw, columns, gravity_m_s2=gravity_m_s2, reading_unit=reading_unit
            )
        else:
            if from_ is None:
                forces_n = forces_from(
                    weights_kg, robot_file, gravity_m_s2, simulated=wire or is_simulated(robot_file)
                )
                job = job_of("force", robot_file, session, scenario, seed, hidden, wire, realtime, drivers)
                ending.enter_context(told_of_the_end(job))
                with weighing_progress(len(forces_n), live=job.simulated) as told:
                    place = (
                        calibrating.put_simulated_weight if job.simulated else ask_for_weight(gravity_m_s2)
                    )
                    calibrating.run_weighing(job, forces_n, place, told=told)
            raw = from_ or job.session
            plateaus = read_weighing(open_recorded(raw, "force", robot_file))
        fit = fit_force(plateaus, PERCENT * reference_percent)
        stamp = stamp_of(robot_file, raw, valid_days)
        calibration = calibrating.force_calibration(fit, unit, stamp)
        finish(
            calibration,
            output,
            lambda: force_figure(fit, unit),
            raw,
            NamedRobot(robot, robot_file, drivers),
            as_json,
            remarks_on(fit),
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
    if pose is not None and (lower_stops is not None or upper_stops is not None):
        raise InputError(
            "--pose: nothing moves then, and no stop is met; leave out --lower-stops, --upper-stops"
        )
    if from_ is not None and (lower_stops is not None or upper_stops is not None):
        raise InputError(
            "--from: the stops were said when they were touched, and stand in that session; leave out "
            "--lower-stops, --upper-stops"
        )
    pose_rad, stops = pose_of(pose, robot_file), stops_of(lower_stops, upper_stops, robot_file)
    output = output_for(out, robot_file, "encoder", session)
    with ExitStack() as ending:
        raw = from_
        if raw is None:
            ask = question_before("encoder", robot_file, pose_rad, yes)
            job = job_of("encoder", robot_file, session, scenario, seed, hidden, wire, realtime, drivers, ask)
            ending.enter_context(told_of_the_end(job))
            if pose_rad is not None:
                calibrating.run_pose(job)
            else:
                with motion_progress("touching the stops", live=job.simulated) as watcher:
                    calibrating.run_stops(job, stops, watcher)
            raw = job.session
        known_rad = known_mrad / 1e3
        fit = calibrating.encoder_fit_of(
            open_recorded(raw, "encoder", robot_file), robot_file.joint_count, pose_rad, known_rad
        )
        calibration = calibrating.encoder_calibration(fit, stamp_of(robot_file, raw, valid_days))
        whose = NamedRobot(robot, robot_file, drivers)
        finish(calibration, output, lambda: encoder_figure(fit), raw, whose, as_json)


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
    where = (from_, out, session, valid_days)
    excite("torque", robot, *where, scenario, seed, hidden, wire, realtime, drivers, yes, as_json)


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
    where = (from_, out, session, valid_days)
    excite("gravity", robot, *where, scenario, seed, hidden, wire, realtime, drivers, yes, as_json)
