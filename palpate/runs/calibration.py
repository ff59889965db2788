"""Record data for calibrations: motions in free air, touches of hard stops, a known pose, and weights."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from palpate.calibration.arm_motion import (
    GRAVITY_MOTION,
    TORQUE_MOTION,
    ExcitationSettings,
    PathTask,
    cap_speed,
    choose_path,
    travel_speed_rad_s,
)
from palpate.calibration.encoder import PUSH_SHARE, StopSettings, StopTask, plan_stops, widen_limits_for_stops
from palpate.calibration.force import EVENT, check_references
from palpate.calibration.standstill import StationaryRobot
from palpate.control.laws.gains import gains_of
from palpate.control.loop.result import Outcome
from palpate.control.loop.task import Task
from palpate.robot_io.calibration.applied import load_calibrations
from palpate.robot_io.errors import InputError
from palpate.robot_io.guard import Limits
from palpate.robot_io.types import FloatArray, Measurement
from palpate.runs.probing import NO_WATCHER, Watcher
from palpate.runs.session import ArmJob, ArmSession, arm_session

KIND = "calibration_kind"  # key of the calibration's kind in the session's metadata
MOTIONS = {"torque": TORQUE_MOTION, "gravity": GRAVITY_MOTION}
SPEED_MARGIN = 1.5  # guard's limit, as a multiple of the motion's speed
STOP_SPEED_RAD_S = 3.0  # guard's speed limit at stops; a light wrist is jerked when the shoulder stops
BEYOND_RAD = 0.05  # distance of the guard's position limit beyond the end of the search for a stop
POSE_S = 1.0
_FAR_RAD = 100.0  # beyond the range of any encoder


@dataclass(frozen=True)
class CalibrationJob(ArmJob):
    """Settings of a calibration run; it does not apply the robot's existing calibration of this kind."""

    kind: str  # force, encoder, torque or gravity


Place = Callable[[ArmSession, int, float], None]


@contextmanager
def _unpowered(job: CalibrationJob) -> Iterator[tuple[ArmSession, StationaryRobot, Measurement]]:
    """Begin the session; yield the arm, the robot without power, and its first sample.

    Raises:
        InputError: robot file, calibrations and scenario do not fit each other, a device could not be opened,
            or the session cannot be written.
        SafetyTripError: a sample is missing or old.
    """
    now_utc, robot_file = datetime.now(UTC), job.robot_file
    calibrations = load_calibrations(robot_file, now_utc, leave_out=(job.kind,), emulated=job.wired)
    n = robot_file.joint_count
    anywhere = {"position_min_rad": (-_FAR_RAD,) * n, "position_max_rad": (_FAR_RAD,) * n}
    with arm_session(job, calibrations, {KIND: job.kind}, now_utc) as arm:
        guard = arm.guard(robot_file.limits.model_copy(update=anywhere))
        stationary = StationaryRobot(arm.robot, guard, arm.clock, arm.log, robot_file.control_rate_hz)
        yield arm, stationary, stationary.await_samples()


def _move(arm: ArmSession, task: Task, limits: Limits, watcher: Watcher, duration_s: float) -> None:
    """Run a task under these limits; raise `KeyboardInterrupt` or `PalpateError` if it was stopped."""
    watcher.started(duration_s)
    result = arm.run(task, watcher.observe, limits)
    if result.outcome is Outcome.STOPPED and not (result.deactivation_error or arm.unlogged()):
        raise KeyboardInterrupt
    result.raise_for_trip()


def describe_motion(kind: str, limits: Limits) -> str:
    """Describe the calibration motion, for the confirmation before it starts."""
    travel_rad_s = travel_speed_rad_s(limits)
    if kind in MOTIONS:
        motion = MOTIONS[kind]
        fastest_rad_s = max(float(cap_speed(motion.speed_rad_s, limits).max()), travel_rad_s)
        return (
            f"all joints move at once in free air, at up to {fastest_rad_s:.3g} rad/s, for "
            f"{motion.duration_s:g} s plus the time to get to its start and back"
        )
    settings = StopSettings.within(limits)
    trips_rad_s = max(_slowed(limits, STOP_SPEED_RAD_S).velocity_rad_s)
    return (
        f"all joints move at up to {settings.travel_rad_s:.3g} rad/s to a place with enough room. Then each "
        f"joint moves at {settings.speed_rad_s:.2g} rad/s against its hard stops and pushes with "
        f"{100 * PUSH_SHARE:g} % of its torque limit. The guard stops the arm beyond {trips_rad_s:.3g} rad/s"
    )


def run_motion(
    job: CalibrationJob, settings: ExcitationSettings | None = None, watcher: Watcher = NO_WATCHER
) -> None:
    """Excite the arm in free air and log the motion, for a torque or gravity calibration.

    Args:
        job: the calibration run.
        settings: settings of the motion; None for the usual one of the kind.
        watcher: observer of the run.

    Raises:
        InputError: the robot cannot be opened, the session not written, or no motion is clear of the ground.
        PalpateError: the arm was stopped.
        KeyboardInterrupt: the user stopped the run.
    """
    settings, robot_file = settings or MOTIONS[job.kind], job.robot_file
    limits = robot_file.limits
    with _unpowered(job) as (arm, _, first):
        rng = np.random.default_rng(0)
        path = choose_path(arm.body, first.joint_position_rad, limits, settings=settings, rng=rng)
        task = PathTask(arm.body, gains_of(robot_file).tracking, path, travel_speed_rad_s(limits))
        guarded = _slowed(limits, SPEED_MARGIN * max(settings.speed_rad_s, 1.0))
        _move(arm, task, guarded, watcher, settings.duration_s + 10.0)


def run_stops(
    job: CalibrationJob,
    stops_rad: tuple[FloatArray, FloatArray] | None = None,
    watcher: Watcher = NO_WATCHER,
) -> None:
    """Touch the joints' hard stops and log the motion.

    Args:
        job: the calibration run.
        stops_rad: lower and upper stops, (n,) each [rad]; None for the URDF's.
        watcher: observer of the run.

    Raises:
        InputError: the robot cannot be opened, the session not written, or a stop not reached.
        PalpateError: the arm was stopped.
        KeyboardInterrupt: the user stopped the run.
    """
    limits = job.robot_file.limits
    settings = StopSettings.within(limits)
    with _unpowered(job) as (arm, _, first):
        start_rad, stops_rad = first.joint_position_rad, stops_rad or arm.body.position_limits_rad
        up_rad, approaches = plan_stops(arm.body, start_rad, limits, stops_rad, settings.reach_rad)
        task = StopTask(arm.body, gains_of(job.robot_file).tracking, up_rad, approaches, settings)
        widened = widen_limits_for_stops(limits, approaches, settings.reach_rad + BEYOND_RAD)
        _move(arm, task, _slowed(widened, STOP_SPEED_RAD_S), watcher, 12.0 * len(approaches))


def run_pose(job: CalibrationJob) -> None:
    """Read and log the encoders of an unpowered arm that is held in a known pose.

    Raises:
        InputError: the robot cannot be opened, or the session not written.
        SafetyTripError: a sample is missing or old.
    """
    with _unpowered(job) as (_, stationary, _):
        stationary.record(POSE_S, 0)


def run_weighing(
    job: CalibrationJob,
    forces_n: Sequence[float],
    place: Place,
    *,
    settle_s: float = 1.0,
    measure_s: float = 1.0,
) -> None:
    """Apply known forces to the sensor of an unpowered arm, one after the other, and log the readings.

    Args:
        job: the calibration run.
        forces_n: forces on the sensor in order [N], positive in compression.
        place: called with the arm, the force's number from 0 and the force [N]; applies the force.
        settle_s: time before each measurement [s].
        measure_s: time of each measurement [s].

    Raises:
        InputError: the robot cannot be opened, the session not written, there are too few forces, or one
            exceeds the robot's limit.
        SafetyTripError: a sample is missing, old or beyond a limit.
        KeyboardInterrupt: the user stopped the run.
    """
    check_references(forces_n)
    limit_n = job.robot_file.limits.force_n
    if max(map(abs, forces_n)) >= limit_n:
        raise InputError(
            f"{max(forces_n, key=abs):.4g} N: must be below limits.force_n of '{job.robot_file.name}', which "
            f"is {limit_n:g} N"
        )
    with _unpowered(job) as (arm, stationary, _):
        for number, force_n in enumerate(forces_n):
            place(arm, number, force_n)
            stationary.settle(settle_s)
            text = f"{force_n:.4f} N on the sensor"
            arm.log.event(arm.clock.now_s(), EVENT, text, {"run": number, "force_n": force_n})
            stationary.record(measure_s, number)


def put_simulated_weight(arm: ArmSession, number: int, force_n: float) -> None:
    """Apply a force to the simulated sensor."""
    if arm.world is not None:
        arm.world().sensor_load_n = force_n


def _slowed(limits: Limits, speed_rad_s: float) -> Limits:
    """Return the limits with all joint speeds capped."""
    velocity_rad_s = np.minimum(limits.velocity_rad_s, speed_rad_s).tolist()
    return limits.model_copy(update={"velocity_rad_s": tuple(velocity_rad_s)})
