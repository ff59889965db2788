"""`palpate calibrate`: measure the errors of force sensor, encoders, drives and base."""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from plotly.graph_objects import Figure
from typer import Option

from palpate.calibration.arm_fit import fit_arm, implausible_arm, motion_of
from palpate.calibration.encoder import fit_encoder
from palpate.calibration.force import (
    STANDARD_GRAVITY_M_S2,
    describe_saturation,
    fit_force,
    implausible_force,
    read_reference_file,
    read_weighing,
)
from palpate.common import console
from palpate.common.console import AT_REST, command_group, display_path
from palpate.common.files import atomic_write_all, different_files, existing_file, output_file
from palpate.common.options import with_options
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.tick_record import STREAM_NAME
from palpate.estimation.data.import_options import parse_pairs
from palpate.render.calibration import arm_figure, encoder_figure, force_figure, print_calibration
from palpate.render.progress import motion_progress
from palpate.render.report import PLOT_CONFIG
from palpate.robot_io.calibration.applied import Calibrations
from palpate.robot_io.calibration.file import Calibration
from palpate.robot_io.errors import InputError, PalpateError
from palpate.runs import calibration as runs
from palpate.runs import calibration_file as fits
from palpate.runs.calibration_file import print_usage_hint
from palpate.runs.options import (
    CalibrateOptions,
    MotionOptions,
    Permission,
    ask_for_pose,
    ask_for_power,
    parse_joint_angles,
    parse_numbers,
    without_question,
)
from palpate.runs.session import ArmSession

Analysis = tuple[Calibration, Figure, Sequence[str]]  # the file's content, its picture, remarks for the user
CALIBRATIONS = Path("calibrations")
PERCENT = 0.01
BEYOND_STOPS_RAD = 0.1  # an arm may be held against its stops, whose real positions differ from the URDF
# Simulated weights, as shares of the force limit.
SHARES = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.55, 0.4, 0.25, 0.1, 0.0)

group = command_group(
    """Calibrate the force sensor, encoders, drives and base.

Each calibration writes one YAML file; name it in the robot file to correct all measurements and commands:

calibration: {force: force.yaml, encoder: encoder.yaml}

Run [bold]encoder[/bold] first, then [bold]gravity[/bold] and [bold]torque[/bold]; run force at any time.

The arm moves under its guard. Ctrl-C brings it to rest, and no calibration is written."""
)


_COLUMN = "Column of the reading, the reference, or settled (0 marks rows to ignore), such as reading=raw."
_WEIGHTS_KG = "Masses to place on the sensor, in this order, such as 0,1,2,4,2,1,0."
_REFERENCE_PERCENT = "Standard uncertainty that is common to all references."
_READING_UNIT = "Unit of the readings, if the column's name does not end with it."
_GRAVITY_M_S2 = "Gravitational acceleration at the site."


@group.command()
@with_options(CalibrateOptions)
def force(
    options: CalibrateOptions,
    *,
    column: Annotated[list[str] | None, Option(help=_COLUMN, metavar="ROLE=COLUMN")] = None,
    reading_unit: Annotated[str | None, Option(help=_READING_UNIT)] = None,
    weights_kg: Annotated[str | None, Option(help=_WEIGHTS_KG, metavar="KG,...")] = None,
    gravity_m_s2: Annotated[float, Option(help=_GRAVITY_M_S2, min=9.7, max=9.9)] = STANDARD_GRAVITY_M_S2,
    reference_percent: Annotated[
        float, Option(help=_REFERENCE_PERCENT, metavar="PERCENT", min=0, max=50)
    ] = 0.0,
) -> None:
    """Calibrate scale, zero and curvature of the force sensor, from weights or a file; report hysteresis.

    On the robot, you place known weights on the sensor and remove them. The arm has no power, and the
    sensor's axis must be vertical.

    With --from, reads a table (CSV, Parquet, NPZ) with one row per sample. It needs a column for the reading
    and a column for the reference.
    """
    robot_file = options.robot_file

    def record(job: runs.CalibrationJob) -> None:
        if weights_kg is not None:
            masses_kg = parse_numbers("--weights-kg", weights_kg)
            if min(masses_kg) < 0:
                raise InputError(f"--weights-kg {weights_kg!r}: masses must not be negative")
            forces_n = [mass_kg * gravity_m_s2 for mass_kg in masses_kg]
        elif job.simulated:
            forces_n = [share * job.robot_file.limits.force_n for share in SHARES]
        else:
            raise InputError(
                "--weights-kg: give masses in the order in which you place them, such as 0,0.5,1,2,1,0.5,0"
            )
        place = runs.put_simulated_weight if job.simulated else partial(ask_for_weight, gravity_m_s2)
        runs.run_weighing(job, forces_n, place)

    def analyze(raw: Path) -> Analysis:
        if raw.suffix == ".mcap":
            plateaus, unit = read_weighing(fits.open_recorded(raw, "force", robot_file)), "N"
        else:
            columns = parse_pairs(column or (), "--column")
            plateaus, unit = read_reference_file(
                existing_file(raw, "data"), columns, gravity_m_s2=gravity_m_s2, reading_unit=reading_unit
            )
        fit = fit_force(plateaus, PERCENT * reference_percent)
        remarks = []
        if not fit.is_used.all():
            remarks.append(describe_saturation(plateaus, fit.is_used))
            most = plateaus.reading[~fit.is_used].max()
            if most > fit.plateaus.reading.max():
                above = most - fit.zero.value
                shown_n = above * (fit.scale.value + above * (fit.curvature.value if fit.curvature else 0.0))
                remarks[-1] += (
                    f"; the sensor never shows more than {shown_n:.3g} N, so set limits.force_n below that, "
                    "or use a sensor with a larger range"
                )
        if fit.drift_n is not None:
            remarks.append(
                f"the reading drifts by {fit.drift_n.value:+.2g} N during the record. The zero holds for the "
                "middle of the record, and its uncertainty covers the drift. Let the sensor warm up"
            )
        if fit.unsettled_n:
            remarks.append(
                "the reading still changes within the plateaus, so up to "
                f"{2 * fit.unsettled_n:.2g} N of the hysteresis may be slow settling; wait longer at "
                "each weight"
            )
        if fit.plateaus.glitches:
            remarks.append(f"{fit.plateaus.glitches} samples were left out as glitches of the A/D converter")
        if fit.suspect is not None:
            force_n, off_n = fit.plateaus.reference_n[fit.suspect], fit.residual_n[fit.suspect]
            number = np.flatnonzero(fit.is_used)[fit.suspect] + 1
            remarks.append(
                f"plateau {number} ({force_n:.4g} N) is {off_n:+.2g} N off, much more than the others; was "
                "this the right weight?"
            )
        calibration = fits.make_calibration(
            "force", fit, robot_file, raw, options.valid_days, reading_unit=unit
        )
        remarks += _accepted(implausible_force(fit), options)
        return calibration, force_figure(fit, unit), remarks

    _calibrate("force", options, record, analyze)


_POSE = "Pose in which the arm is held: 'home', or one angle per joint. The arm does not move."
_LOWER_STOPS = "Lower hard stops; default: the URDF's limits."
_UPPER_STOPS = "Upper hard stops; default: the URDF's limits."
_KNOWN_MRAD = "Standard uncertainty of the stops or the pose."


@group.command()
@with_options(MotionOptions)
def encoder(
    options: MotionOptions,
    *,
    pose: Annotated[str | None, Option(help=_POSE, metavar="RAD,...")] = None,
    lower_stops: Annotated[str | None, Option(help=_LOWER_STOPS, metavar="RAD,...")] = None,
    upper_stops: Annotated[str | None, Option(help=_UPPER_STOPS, metavar="RAD,...")] = None,
    known_mrad: Annotated[float, Option(help=_KNOWN_MRAD, metavar="MRAD", min=0, max=100)] = 1.0,
) -> None:
    """Calibrate the zeros of the encoders, against hard stops (slowly, at low torque) or in a known pose."""
    robot_file, stops_stated = options.robot_file, lower_stops is not None or upper_stops is not None
    if pose is not None and stops_stated:
        raise InputError(
            "--pose: the arm does not move to its stops, so leave out --lower-stops and --upper-stops"
        )
    if options.from_ is not None and stops_stated:
        raise InputError("--from: the session states the stops, so leave out --lower-stops and --upper-stops")
    pose_rad = None
    if pose is not None:
        pose_rad = parse_joint_angles("--pose", pose, robot_file)
        body = RigidBody.from_urdf(robot_file.urdf_path, robot_file.tip_frame)
        ranges = zip(pose_rad, *body.position_limits_rad, strict=True)
        for joint, (angle, low, high) in enumerate(ranges, 1):
            if not low - BEYOND_STOPS_RAD <= angle <= high + BEYOND_STOPS_RAD:
                raise InputError(
                    f"--pose {pose!r}: {angle:g} rad is outside the URDF's limits of joint {joint}, "
                    f"{low:g} to {high:g} rad"
                )
    stops = None  # lower and upper ones, NaN where not stated
    if stops_stated:
        none = [np.nan] * robot_file.joint_count
        lower = none if lower_stops is None else parse_joint_angles("--lower-stops", lower_stops, robot_file)
        upper = none if upper_stops is None else parse_joint_angles("--upper-stops", upper_stops, robot_file)
        for joint, (low, high) in enumerate(zip(lower, upper, strict=True), 1):
            if low >= high:
                raise InputError(
                    f"--lower-stops {lower_stops!r}: {low:g} rad of joint {joint} is not below its upper "
                    f"stop, {high:g} rad"
                )
        stops = np.array(lower), np.array(upper)

    def record(job: runs.CalibrationJob) -> None:
        if pose_rad is not None:
            runs.run_pose(job)
            return
        with motion_progress("touching the stops", live=job.simulated) as watcher:
            runs.run_stops(job, stops, watcher)

    def analyze(raw: Path) -> Analysis:
        recorded = fits.open_recorded(raw, "encoder", robot_file)
        fit = fit_encoder(recorded, robot_file.joint_count, pose_rad, known_mrad / 1e3)
        calibration = fits.make_calibration("encoder", fit, robot_file, raw, options.valid_days)
        return calibration, encoder_figure(fit), ()

    held = None if pose_rad is None else (lambda: ask_for_pose(pose_rad, yes=options.yes))
    _calibrate("encoder", options, record, analyze, held or _motion_permission("encoder", options))


@group.command()
@with_options(MotionOptions)
def torque(options: MotionOptions) -> None:
    """Calibrate gains and offsets of the drives' torques from the arm's weight, during a motion in free air.

    Friction is estimated and reported, but not compensated. The URDF's masses are assumed to be exact.
    """
    _move_in_free_air("torque", options)


@group.command()
@with_options(MotionOptions)
def gravity(options: MotionOptions) -> None:
    """Calibrate the tilt of the base, from slow motions through many postures and back.

    An arm that moves in one plane shows only the tilt in that plane. The URDF's masses are assumed to be
    exact.
    """
    _move_in_free_air("gravity", options)


def _move_in_free_air(kind: str, options: MotionOptions) -> None:
    robot_file = options.robot_file

    def record(job: runs.CalibrationJob) -> None:
        with motion_progress("moving in free air", live=job.simulated) as watcher:
            runs.run_motion(job, watcher=watcher)

    def analyze(raw: Path) -> Analysis:
        session = fits.open_recorded(raw, kind, robot_file)
        body = RigidBody.of_robot(robot_file, Calibrations())
        fit = fit_arm(motion_of(session.samples(STREAM_NAME)), body)
        remarks = _accepted(implausible_arm(fit, gains_are_applied=kind == "torque"), options)
        calibration = fits.make_calibration(kind, fit, robot_file, raw, options.valid_days)
        return calibration, arm_figure(fit), remarks

    _calibrate(kind, options, record, analyze, _motion_permission(kind, options))


def _accepted(implausible: list[str], options: CalibrateOptions) -> list[str]:
    """Return the reasons against a calibration if the user accepts them; raise `InputError` otherwise."""
    if implausible and not options.accept_implausible:
        raise InputError(f"{'; '.join(implausible)}; add --accept-implausible to write it nevertheless")
    return [f"implausible: {reason}" for reason in implausible]


def _motion_permission(kind: str, options: MotionOptions) -> Permission:
    robot_file = options.robot_file
    motion = f"'{robot_file.name}' will move: {runs.describe_motion(kind, robot_file.limits)}."
    return lambda: ask_for_power(motion, yes=options.yes)


def _calibrate(
    kind: str,
    options: CalibrateOptions,
    record: Callable[[runs.CalibrationJob], None],
    analyze: Callable[[Path], Analysis],
    permission: Permission = without_question,
) -> None:
    """Record or read a session, fit it, write the calibration with its picture, and print the result."""
    robot_file = options.robot_file
    path = output_file(options.out or CALIBRATIONS / f"{options.stamped_name(kind)}.yaml")
    plot = output_file(path.with_suffix(".html"))
    different_files(path, plot, options.session)
    raw, job = options.from_, None
    if raw is None:
        raw = options.session_file(options.session, kind)
        job = runs.CalibrationJob(robot_file, raw, kind, permission=permission, **options.job)
    try:
        if job is not None:
            record(job)
        calibration, figure, remarks = analyze(raw)
        page = figure.to_html(include_plotlyjs=True, config=PLOT_CONFIG)  # needs no network
        with atomic_write_all({plot: page, path: calibration.to_yaml()}):
            pass
    except (PalpateError, KeyboardInterrupt) as error:
        if job is not None:
            words = [AT_REST + "; "] * isinstance(error, KeyboardInterrupt) + ["no calibration is written"]
            if job.session.exists():
                words.append(f". The recording so far stays in {display_path(job.session)}")
            if len(words) > 1:
                console.stderr().print("".join(words), soft_wrap=True)
        raise

    def show() -> None:
        print_calibration(console.stdout(), calibration, remarks)
        console.say(
            f"written: [bold]{display_path(path)}[/bold], residuals: [bold]{display_path(plot)}[/bold]"
        )
        console.say(f"from:    {display_path(raw)}")
        print_usage_hint(calibration, path.resolve(), options)

    written = {"file": str(path), "plot": str(plot), "raw": str(raw)}
    content = calibration.model_dump(mode="json") | {"warnings": list(remarks)}
    console.present(written | content, show, as_json=options.as_json)


def ask_for_weight(gravity_m_s2: float, _arm: ArmSession, number: int, force_n: float) -> None:
    """Ask a person to put a weight on, and wait for it.

    Args:
        gravity_m_s2: gravitational acceleration, which converts masses to weights [m/s^2].
        number: number of the force from 0.
        force_n: the force [N].
    """
    weight = f"{force_n / gravity_m_s2:.4g} kg ({force_n:.3f} N)"
    console.stderr().print(f"{number + 1}: put {weight} on the sensor, let it come to rest, press Enter")
    if not sys.stdin.readline():
        words = "weights are placed by hand: run this in a terminal"
        if number == 0:
            raise InputError(words)
        raise PalpateError(f"no answer at weight {number + 1}: {words}")  # readings so far are kept
