"""Assemble a probing or replay run: robot, clock, guard, task, loop, session log, online estimation."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from palpate.common.console import count
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.loop.loop import run_loop
from palpate.control.loop.realtime import frozen_garbage
from palpate.control.loop.result import LoopResult
from palpate.control.loop.task import NO_RUN, Phase, TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, STREAM_NAME, Estimates, tick_stream
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.replay import ReferenceTrajectory, ReplayTask
from palpate.control.probing.task import ProbingTask
from palpate.estimation.contact_estimators import CONTACT_ESTIMATORS
from palpate.estimation.estimator import OnlineContactLaw, OnlineEstimator
from palpate.estimation.estimators import ESTIMATORS
from palpate.estimation.online import OnlineContactEstimator
from palpate.robot_io.calibration.applied import load_calibrations
from palpate.robot_io.clock import SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.guard import Guard
from palpate.robot_io.robot import build_robot
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.session import Samples, Session
from palpate.robot_io.types import Measurement
from palpate.runs.robots import is_simulated
from palpate.runs.session import SIMULATED_DRIVERS, SOURCE, ArmJob, arm_session, raise_for_end
from palpate.sim_backend.drivers import SimulatedBus
from palpate.sim_backend.scenario import Scenario

PLAN = "plan"  # key of the plan's text in the session's metadata
_LOOP_FIELDS = (  # fields of a loop's result in the JSON output
    *("ticks", "overruns", "dropped", "unsent", "log_error", "observer_error", "deactivation_error"),
    *("duration_s", "wall_s"),
)
MOST_TICKS = 10_000_000  # records of up to 400 bytes; sessions above 4 GiB cannot be read


@dataclass(frozen=True)
class ProbingJob(ArmJob):
    """Settings of a probing run: world or arm, plan, and output file."""

    plan: ProbingPlan  # speeds, forces, repeats
    _: KW_ONLY
    online: str | None = "rls"  # name of the online estimator; None for none
    extra: Mapping[str, str] = field(default_factory=dict)  # further texts for the session's metadata


class Watcher:
    """Observer of a run, see `palpate.control.loop.tick_record.Observer`; its methods do nothing."""

    def started(self, duration_s: float = 0.0) -> None:
        """Called when the arm is ready, before it moves.

        Args:
            duration_s: approximate duration of the motion [s]; 0 if a plan determines it.
        """

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """Called after each tick; must return quickly with a real arm.

        Args:
            measurement: measurement of this tick.
            output: the task's output for this measurement.
        """
        return NO_ESTIMATE


NO_WATCHER = Watcher()


@dataclass(frozen=True)
class ProbingOutcome:
    """Result of a probing run."""

    session: Path  # the session file, which is complete up to the end, even after a trip
    loop: LoopResult
    failures: tuple[str, ...]  # one line for each failed run, such as a run without a touch
    sealed: Path | None = None  # sealed file of the hidden effects; None if nothing was hidden
    touched: bool = True  # whether the object was touched

    def raise_for_failure(self) -> None:
        """Raise an error if the session is incomplete.

        Raises:
            KeyboardInterrupt, PalpateError: see `raise_for_end`; or a run gave no data.
        """
        raise_for_end(self.loop)
        if self.failures:
            text = count(len(self.failures), "failure")
            raise PalpateError(f"{text} while probing: {self.failures[0]}")

    def as_data(self) -> dict[str, Any]:
        """Return the outcome as plain data; the keys are stable."""
        loop = self.loop
        return {
            "session": str(self.session),
            "sealed": str(self.sealed) if self.sealed else None,
            "outcome": str(loop.outcome),
            "cause": loop.cause,
            "failed_runs": list(self.failures),
            **{name: getattr(loop, name) for name in _LOOP_FIELDS},
        }


def check_duration(plan: ProbingPlan, rate_hz: float) -> None:
    """Check that a session can hold a plan.

    Args:
        plan: the plan.
        rate_hz: control rate [Hz].

    Raises:
        InputError: the plan takes too long.
    """
    if plan.shortest_s * rate_hz > MOST_TICKS:
        raise InputError(
            f"the plan takes {plan.shortest_s / 3600:.3g} h or more, but a session holds at most "
            f"{MOST_TICKS / rate_hz / 3600:.3g} h at {rate_hz:g} Hz; plan fewer runs, shorter holds "
            "or faster approaches"
        )


def run_probing(job: ProbingJob, watcher: Watcher = NO_WATCHER) -> ProbingOutcome:
    """Run a probing and write the session file, which is complete on return.

    Args:
        job: settings of the probing.
        watcher: observer of the run.

    Raises:
        InputError: robot file, plan and scenario do not fit each other, or the session cannot be written;
            nothing has moved then, and no session is left. Also if a device could not be opened.
    """
    robot_file, rate_hz = job.robot_file, job.robot_file.control_rate_hz
    check_duration(job.plan, rate_hz)
    online = None
    if job.online is not None:
        registry = CONTACT_ESTIMATORS if job.online in CONTACT_ESTIMATORS else ESTIMATORS
        estimator = registry[job.online]()
        if not isinstance(estimator, OnlineEstimator | OnlineContactLaw):
            valid = ", ".join(online_estimators())
            raise InputError(f"estimator '{job.online}' needs all samples at once. Valid online: {valid}")
        online = OnlineContactEstimator(estimator, gains_of(robot_file).touch)
    phases: set[Phase] = set()

    def observe(measurement: Measurement, output: TaskOutput) -> Estimates:
        phases.add(output.phase)
        watched = watcher.observe(measurement, output)
        return online.observe(measurement, output) if online else watched

    calibrations = load_calibrations(robot_file, emulated=job.wired)
    estimated = (lambda: online.estimates) if online else None
    task = ProbingTask.from_robot_file(robot_file, job.plan, calibrations, estimated=estimated)
    with arm_session(job, calibrations, {PLAN: job.plan.to_yaml(), **job.extra}) as arm:
        watcher.started()
        result = arm.run(task, observe)
    # After an error the observer sees no more phases.
    touched = Phase.LOADING in phases or bool(result.observer_error)
    return ProbingOutcome(job.session, result, task.failures, arm.sealed, touched)


def online_estimators() -> list[str]:
    """Return the names of the estimators that can run during a probing."""
    linear = [name for name, estimator in ESTIMATORS.items() if issubclass(estimator, OnlineEstimator)]
    return linear + [name for name, law in CONTACT_ESTIMATORS.items() if issubclass(law, OnlineContactLaw)]


REPLAY_OF = "replay_of"  # key of the session that was repeated, in the session's metadata
_STILL_RAD_S = 1e-3  # slower references count as standing still
_FARTHEST_M = 0.005  # largest distance between this arm's tip and the recorded one, in the same poses


@dataclass(frozen=True)
class ReplayJob(ArmJob):
    """Settings of a replay: session, arm, and output file."""

    recorded: Session


def references_of(session: Session) -> ReferenceTrajectory:
    """Return a session's references up to its last rest between runs, where the torque can safely go off.

    Args:
        session: session of a probing.

    Raises:
        InputError: the session is not a probing, or contains no complete run.
    """
    if STREAM_NAME not in session.stream_names:
        raise InputError(f"{session.path}: was not recorded with an arm, so there is no motion to repeat")
    ticks = session.samples(STREAM_NAME)
    speed_rad_s = np.abs(ticks.vector("reference_velocity_rad_s")).max(axis=1)
    has_reference = np.isfinite(ticks.vector("reference_position_rad")).all(axis=1) & np.isfinite(speed_rad_s)
    before_stop = np.logical_and.accumulate(has_reference)  # there are no references after a stop
    at_rest = before_stop & (ticks["run"] == NO_RUN) & (speed_rad_s < _STILL_RAD_S)
    count = int(np.flatnonzero(at_rest)[-1]) + 1 if at_rest.any() else 0
    repeated = ticks.select(np.arange(len(ticks)) < count)
    if not (repeated["run"] != NO_RUN).any():
        raise InputError(f"{session.path}: holds no complete run that ended at rest and could be repeated")
    return ReferenceTrajectory(
        repeated["time_s"] - repeated["time_s"][0],
        repeated.vector("reference_position_rad"),
        repeated.vector("reference_velocity_rad_s"),
        repeated["run"].astype(np.int64),
        repeated["phase"].astype(np.int64),
        repeated["press_direction_world"],
    )


def run_replay(
    job: ReplayJob, references: ReferenceTrajectory, watcher: Watcher = NO_WATCHER
) -> tuple[LoopResult, Path | None]:
    """Repeat the references and write a session; return the result and the sealed answer.

    Args:
        job: arm and output file.
        references: joint positions and velocities over time.
        watcher: observer of the run.

    Raises:
        InputError: the references are of another arm, or the job's files do not fit each other; nothing
            moved.
    """
    calibrations = load_calibrations(job.robot_file, emulated=job.wired)
    body = RigidBody.of_robot(job.robot_file, calibrations)
    task = ReplayTask(body, gains_of(job.robot_file), references)
    _check_arm(body, job.recorded)
    extra = {REPLAY_OF: f"{job.recorded.path.name}, made {job.recorded.metadata.created_utc}"}
    if SOURCE in job.recorded.metadata.extra:
        extra[REPLAY_OF] += f", {job.recorded.metadata.extra[SOURCE]}"
    with arm_session(job, calibrations, extra) as arm:
        watcher.started(references.duration_s)
        return arm.run(task, watcher.observe), arm.sealed


def _check_arm(body: RigidBody, recorded: Session) -> None:
    """Raise an error if the arm's tip would be elsewhere in the recorded poses."""
    ticks = recorded.samples(STREAM_NAME)
    rows = np.linspace(0, len(ticks) - 1, 20).astype(int)
    recorded_m = ticks.vector("tip_position_world_m")[rows]
    tip_m = np.array([body.tip_pose(q)[0] for q in ticks.vector("joint_position_rad")[rows]])
    distance_m = float(np.nanmax(np.linalg.norm(tip_m - recorded_m, axis=1)))
    if distance_m > _FARTHEST_M:
        raise InputError(
            f"{recorded.path}: was recorded with a different arm: in the same postures, the tip of this arm "
            f"is up to {1e3 * distance_m:.0f} mm from the recorded tip. Name the recorded arm with --robot"
        )


class TickRecords:
    """Log of ticks in memory; see `palpate.control.loop.tick_record.TickLog`."""

    dropped = 0
    failure = None

    def __init__(self) -> None:
        self.records: list[tuple[object, ...]] = []

    def append(self, stream_name: str, record: tuple[object, ...]) -> None:
        """Keep a tick's record.

        Args:
            stream_name: name of the stream; not used.
            record: record of one tick.
        """
        self.records.append(record)

    def event(self, time_s: float, kind: str, text: str, data: Mapping[str, object] | None = None) -> None:
        """Discard the event."""

    def samples(self, joint_count: int) -> Samples:
        """Return all ticks in the form in which a session returns them.

        Args:
            joint_count: number of joints of the arm.
        """
        stream = tick_stream(joint_count)
        return Samples.from_records(stream, np.array(self.records, stream.dtype))


def probe_in_memory(robot_file: RobotFile, scenario: Scenario, plan: ProbingPlan) -> Samples:
    """Probe a simulated object as fast as possible; return the stream "tick".

    Args:
        robot_file: robot file of a simulated arm.
        scenario: the world.
        plan: speeds, forces, repeats.

    Raises:
        InputError: robot file, scenario and plan do not fit each other, or the robot is not simulated.
        PalpateError: the arm was stopped, or a run gave no data.
    """
    if not is_simulated(robot_file):
        raise InputError(f"robot '{robot_file.name}' is not simulated")
    clock, log = SimulatedClock(), TickRecords()
    task = ProbingTask.from_robot_file(robot_file, plan)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count)
    robot = build_robot(robot_file, DriverCatalog(SIMULATED_DRIVERS), clock)
    for bus in robot.buses.values():
        if isinstance(bus, SimulatedBus):
            bus.use_scenario(scenario)
    with robot, frozen_garbage(collect=False):
        run_loop(robot, guard, task, clock, log, rate_hz=robot_file.control_rate_hz).raise_for_trip()
    if task.failures:
        raise PalpateError(f"while probing: {task.failures[0]}")
    return log.samples(robot.joint_count)
