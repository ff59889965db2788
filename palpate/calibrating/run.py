"""The four calibrations, from robot or data to a file."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calibration.arm.excitation import GRAVITY_MOTION, TORQUE_MOTION, ExcitationSettings, choose_path
from calibration.arm.fit import ArmFit, fit_arm, motion_of
from calibration.arm.free_motion import PathTask
from calibration.arm.model import GravityBodies
from calibration.arm.room import paced, travel_speed_rad_s
from calibration.encoder.fit import EncoderFit, fit_pose, fit_stops
from calibration.encoder.stop_plan import plan_stops, with_room_for_stops
from calibration.encoder.stop_task import PUSH_SHARE, StopSettings, StopTask
from calibration.force.fit import ForceFit, check_references
from calibration.force.weighing import weigh
from calibration.statistics import Estimate
from calibration.still import StillRobot
from control.laws.gains import gains_of
from palpate.arm.probing_run import NOBODY, Watcher
from palpate.calibrating.bench import Bench, CalibrationJob, Stamp, anywhere, calibration_bench, slowed
from palpate.files import write_text
from robot_io.calibration import (
    Calibration,
    EncoderCalibration,
    ForceCalibration,
    GravityCalibration,
    TorqueCalibration,
)
from robot_io.errors import InputError
from robot_io.files.file_model import validate
from robot_io.guard import Limits
from robot_io.session import Session
from robot_io.types import FloatArray

MOTIONS = {"torque": TORQUE_MOTION, "gravity": GRAVITY_MOTION}
SPEED_MARGIN = 1.5  # of the guard over the motion's own speed
STOP_SPEED_RAD_S = (
    3.0  # of the guard while stops are touched; a light wrist is jerked when the shoulder stops
)
BEYOND_RAD = 0.05  # of the guard over where the search for a stop gives up by itself
POSE_S = 1.0

Place = Callable[[Bench, int, float], None]


def motion_in_words(kind: str, limits: Limits) -> str:
    """What the arm does to have its encoders, drives or base calibrated, as a person reads it beforehand."""
    travel_rad_s = travel_speed_rad_s(limits)
    if kind in MOTIONS:
        wish = MOTIONS[kind]
        fastest_rad_s = max(float(paced(wish.speed_rad_s, limits).max()), travel_rad_s)
        return (
            f"all joints at once in free air, up to {fastest_rad_s:.3g} rad/s, for "
            f"{wish.duration_s:g} s and the ways there and back"
        )
    settings = StopSettings.within(limits)
    trips_rad_s = max(slowed(limits, STOP_SPEED_RAD_S).velocity_rad_s)
    return (
        f"all joints at up to {settings.travel_rad_s:.3g} rad/s to where there is room, then each at "
        f"{settings.speed_rad_s:.2g} rad/s against its hard stops, pushing with {100 * PUSH_SHARE:g} % of "
        f"its torque limit; its guard stops it beyond {trips_rad_s:.3g} rad/s"
    )


def run_motion(
    job: CalibrationJob,
    wish: ExcitationSettings | None = None,
    watcher: Callable[[float], Watcher] = lambda _s: NOBODY,
    now_utc: datetime | None = None,
) -> None:
    """Excite the arm in free air and log it: for torque and gravity.

    Args:
        job: what is wanted.
        wish: kind of motion; None is the usual one for the kind.
        watcher: makes somebody who looks on, from the motion's duration [s].
        now_utc: wall clock.

    Raises:
        InputError: as `calibration_bench`, or no motion is clear of the ground.
        PalpateError: the arm was stopped.
        KeyboardInterrupt: the user stopped it.
    """
    wish = wish or MOTIONS[job.kind]
    with calibration_bench(job, now_utc) as bench:
        robot_file = job.robot_file
        bodies = GravityBodies.from_urdf(robot_file.urdf_path, robot_file.tip_frame)
        start_rad = _where_it_stands(bench)
        rng = np.random.default_rng(0)
        path = choose_path(bench.body, bodies, start_rad, robot_file.limits, settings=wish, rng=rng)
        travel_rad_s = travel_speed_rad_s(robot_file.limits)
        task = PathTask(bench.body, gains_of(robot_file).tracking, path, travel_rad_s)
        limits = slowed(robot_file.limits, SPEED_MARGIN * max(wish.speed_rad_s, 1.0))
        bench.run(task, limits, watcher(wish.duration_s + 10.0))


def run_stops(
    job: CalibrationJob,
    stops_rad: tuple[FloatArray, FloatArray] | None = None,
    watcher: Callable[[float], Watcher] = lambda _s: NOBODY,
    now_utc: datetime | None = None,
) -> None:
    """Touch the joints' hard stops and log it.

    Args:
        job: what is wanted.
        stops_rad: lower and upper stops, (n,) each [rad]; None takes the URDF's joint limits.
        watcher: as for `run_motion`.
        now_utc: wall clock.

    Raises:
        InputError: as `calibration_bench`, or a stop cannot be reached.
        PalpateError: the arm was stopped.
        KeyboardInterrupt: the user stopped it.
    """
    with calibration_bench(job, now_utc) as bench:
        limits = job.robot_file.limits
        settings = StopSettings.within(limits)
        stops_rad = stops_rad or bench.body.position_limits_rad
        start_rad = _where_it_stands(bench)
        up_rad, approaches = plan_stops(bench.body, start_rad, limits, stops_rad, settings.reach_rad)
        task = StopTask(bench.body, gains_of(job.robot_file).tracking, up_rad, approaches, settings)
        opened = with_room_for_stops(limits, approaches, settings.reach_rad + BEYOND_RAD)
        bench.run(task, slowed(opened, STOP_SPEED_RAD_S), watcher(12.0 * len(approaches)))


def run_pose(job: CalibrationJob, now_utc: datetime | None = None) -> None:
    """Read the encoders of an arm that is held in a known pose, without power, and log it.

    Raises:
        InputError: as `calibration_bench`.
        SafetyTripError: a sample is missing or old.
    """
    with calibration_bench(job, now_utc) as bench:
        still = _still(bench)
        still.await_samples()
        still.watch(POSE_S, 0)


def run_weighing(
    job: CalibrationJob,
    forces_n: Sequence[float],
    place: Place,
    *,
    settle_s: float = 1.0,
    measure_s: float = 1.0,
    told: Callable[[float], None] | None = None,
    now_utc: datetime | None = None,
) -> None:
    """Put known forces on the sensor of an arm without power, one after the other, and log it.

    Args:
        job: what is wanted.
        forces_n: positive in compression [N].
        place: sees to it that force number i is there.
        settle_s: between placing and reading [s].
        measure_s: how long each is read [s].
        told: called with the share that is done.
        now_utc: wall clock.

    Raises:
        InputError: as `calibration_bench`, or there are too few forces, or one is beyond the robot's limit.
        SafetyTripError: a sample is missing, old or beyond a limit.
        KeyboardInterrupt: the user stopped it.
    """
    check_references(forces_n)
    limit_n = job.robot_file.limits.force_n
    if max(map(abs, forces_n)) >= limit_n:
        raise InputError(
            f"{max(forces_n, key=abs):.4g} N: limits.force_n of '{job.robot_file.name}' is {limit_n:g} N"
        )
    with calibration_bench(job, now_utc) as bench:
        still = _still(bench)
        still.await_samples()

        def put(number: int, force_n: float) -> None:
            place(bench, number, force_n)

        weigh(still, forces_n, put, settle_s=settle_s, measure_s=measure_s, progress=told)


def put_simulated_weight(bench: Bench, number: int, force_n: float) -> None:
    """Put a force on the simulated sensor."""
    if bench.world is not None:
        bench.world().sensor_load_n = force_n


def force_calibration(fit: ForceFit, reading_unit: str, stamp: Stamp) -> ForceCalibration:
    """The file's content."""
    unit, share = reading_unit, {"unit": "1"}
    values = {"zero": _one(fit.zero, unit), "scale": _one(fit.scale, f"N/{unit}")}
    if fit.curvature:
        values["curvature"] = _one(fit.curvature, f"N/{unit}^2")
    findings = {
        "hysteresis": _one(fit.hysteresis_n, "N"),
        "nonlinearity": {"value": fit.nonlinearity.value, "std_err": fit.nonlinearity.std_err, **share},
        "residual_rms": {"value": fit.rms_n, "std_err": 0.0, "unit": "N"},
        "range": {"value": list(fit.range_n), "std_err": [0.0, 0.0], "unit": "N"},
    }
    content = stamp.content("force") | {"reading_unit": unit, "values": values, "findings": findings}
    return validate(ForceCalibration, content)


def encoder_calibration(fit: EncoderFit, stamp: Stamp) -> EncoderCalibration:
    """The file's content."""
    values = {"offset": _all(fit.offset_rad, fit.std_rad, "rad")}
    findings = {"repeatability": _all(fit.repeatability_rad, np.zeros_like(fit.repeatability_rad), "rad")}
    return validate(EncoderCalibration, stamp.content("encoder") | {"values": values, "findings": findings})


def torque_calibration(fit: ArmFit, stamp: Stamp) -> TorqueCalibration:
    """The file's content; friction is a finding."""
    values = {
        "gain": _all(fit.gain.value, fit.gain.std_err, "1"),
        "offset": _all(fit.offset_nm.value, fit.offset_nm.std_err, "N m"),
        "command_offset": _all(fit.command_offset_nm.value, fit.command_offset_nm.std_err, "N m"),
    }
    findings = {
        "coulomb_friction": _all(fit.coulomb_nm.value, fit.coulomb_nm.std_err, "N m"),
        "viscous_friction": _all(fit.viscous_nms_rad.value, fit.viscous_nms_rad.std_err, "N m s/rad"),
        "residual_rms": _all(_rms(fit.residual_nm), np.zeros(len(fit.gain.value)), "N m"),
    }
    return validate(TorqueCalibration, stamp.content("torque") | {"values": values, "findings": findings})


def gravity_calibration(fit: ArmFit, stamp: Stamp) -> GravityCalibration:
    """The file's content; an angle that the arm does not feel is left out.

    Raises:
        InputError: the arm feels no tilt at all.
    """
    values = {
        name: _one(Estimate(float(angle), float(std)), "rad")
        for name, angle, std in zip(("pitch", "roll"), fit.tilt_rad.value, fit.tilt_rad.std_err, strict=True)
        if np.isfinite(angle)
    }
    if not values:
        raise InputError("no joint of this arm carries weight: it cannot feel how its base stands")
    findings = {
        "torque_gain": _all(fit.gain.value, fit.gain.std_err, "1"),
        "coulomb_friction": _all(fit.coulomb_nm.value, fit.coulomb_nm.std_err, "N m"),
        "residual_rms": _all(_rms(fit.residual_nm), np.zeros(len(fit.gain.value)), "N m"),
    }
    return validate(GravityCalibration, stamp.content("gravity") | {"values": values, "findings": findings})


def arm_fit_of(session: Session, urdf: str | Path, tip_frame: str) -> ArmFit:
    """Gains, offsets, friction and tilt from a session of `run_motion`.

    Raises:
        InputError: it is no such session, or a joint's gain cannot be told from it.
    """
    return fit_arm(motion_of(session.samples("tick")), GravityBodies.from_urdf(urdf, tip_frame))


def encoder_fit_of(
    session: Session, joint_count: int, pose_rad: Sequence[float] | None, known_std_rad: float
) -> EncoderFit:
    """Zeros from a session of `run_stops`, or of `run_pose` in this pose.

    Raises:
        InputError: it is no such session.
    """
    if pose_rad is None:
        try:
            return fit_stops(session, joint_count, known_std_rad)
        except InputError as error:
            raise InputError(f"{error}; if the arm was held in a pose, say in which: --pose") from error
    return fit_pose(session, np.array(pose_rad, dtype=np.float64), known_std_rad)


def write_calibration(calibration: Calibration, out: Path) -> None:
    """Write the file.

    Raises:
        InputError: it cannot be written; nothing is left of it then.
    """
    write_text(out, calibration.to_yaml())


def now() -> datetime:
    """The wall clock."""
    return datetime.now(UTC)


def _where_it_stands(bench: Bench) -> FloatArray:
    """Joint positions before anything moves, shape (n,) [rad]."""
    return _still(bench).await_samples().joint_position_rad


def _still(bench: Bench) -> StillRobot:
    robot_file = bench.job.robot_file
    guard = bench.guard(anywhere(robot_file.limits))
    return StillRobot(bench.robot, guard, bench.clock, bench.log, robot_file.control_rate_hz)


def _rms(residual: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.nanmean(residual**2, axis=0)))


def _one(estimate: Estimate[float], unit: str) -> dict[str, object]:
    return {"value": estimate.value, "std_err": estimate.std_err, "unit": unit}


def _all(values: FloatArray, errors: FloatArray, unit: str) -> dict[str, object]:
    return {"value": values.tolist(), "std_err": errors.tolist(), "unit": unit}


def stated_stops(
    lower_rad: Sequence[float] | None, upper_rad: Sequence[float] | None
) -> tuple[FloatArray, FloatArray]:
    """Stops for `run_stops`; a side that is not stated has none."""
    count = len(lower_rad or upper_rad or ())
    none = [np.nan] * count
    return np.array(lower_rad or none, dtype=np.float64), np.array(upper_rad or none, dtype=np.float64)
