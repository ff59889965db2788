"""Puts a probing run together: robot, clock, guard, task, loop, session log, online estimation."""

import sys
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import yaml

from control.arm.dh_check import check_dh_table
from control.arm.rigid_body import RigidBody
from control.laws.gains import TouchGains, gains_of
from control.loop.journal import Observer
from control.loop.loop import run_loop
from control.loop.realtime import realtime
from control.loop.result import LoopResult, Outcome
from control.loop.task import TaskOutput
from control.loop.tick_record import NO_ESTIMATE, Estimates, tick_stream
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from estimation.estimator import OnlineEstimator
from estimation.estimators import ESTIMATORS
from estimation.online import OnlineContactEstimator
from palpate.arm.hiding import hide
from palpate.arm.new_session import new_session
from palpate.arm.opened import opened
from palpate.arm.permission import Permission, without_question
from palpate.arm.wired import DEFAULT_SCENARIO, EMULATED, emulate, is_simulated
from palpate.words import count
from robot_io.calibration import Calibrations, load_calibrations
from robot_io.clock import Clock, MonotonicClock, SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.errors import DeviceError, InputError, PalpateError
from robot_io.guard import Guard
from robot_io.robot import Robot, build_robot
from robot_io.robot_file import RobotFile
from robot_io.session import SessionMetadata
from robot_io.types import Measurement
from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.scenario import Scenario, load_scenario

SIMULATED_DRIVERS = "sim_backend.drivers"
PLAN = "plan"  # key of the plan's text in the session's metadata
MOST_TICKS = 10_000_000  # of up to 400 bytes: a session of more than 4 GiB is not read


@dataclass(frozen=True)
class ProbingJob:
    """What is to be probed, how, and where to.

    Attributes:
        robot_file: the arm.
        plan: speeds, forces, repeats.
        session: the new session file.
        scenario: simulated world instead of the one that the robot file names; None leaves that.
        seed: of all simulated noise instead of the scenario's; None leaves that.
        hidden: what to hide in the simulated world, see `palpate.arm.hiding`; None leaves the scenario's.
        paced: let simulated time pass as fast as real time, not as fast as possible.
        wired: emulate the devices of a robot of hardware drivers, and the world behind them.
        online: name of the online estimator, or None for none.
        drivers: packages or modules with drivers beside palpate's own.
        command_line: how the program was started.
        extra: further texts for the session's metadata.
        permission: called before a real arm is opened, and may refuse by raising.
    """

    robot_file: RobotFile
    plan: ProbingPlan
    session: Path
    scenario: Scenario | None = None
    seed: int | None = None
    hidden: str | None = None
    paced: bool = False
    wired: bool = False
    online: str | None = "rls"
    drivers: tuple[str, ...] = ()
    command_line: str = ""
    extra: dict[str, str] = field(default_factory=dict)
    permission: Permission = without_question


class Watcher:
    """Somebody who looks on; this one does nothing."""

    def started(self) -> None:
        """The arm is ready, and begins to move after this."""

    def tick(self, measurement: Measurement, output: TaskOutput) -> None:
        """A tick has passed. With a real arm, take no time here."""


NOBODY = Watcher()


@dataclass(frozen=True)
class ProbingOutcome:
    """How a probing run ended.

    Attributes:
        session: the session file; it holds what happened until the end, also after a trip.
        loop: how the loop ended.
        failures: one line for each run that failed, such as one that touched nothing.
        sealed: file with what was hidden in the simulated world, None if nothing was.
    """

    session: Path
    loop: LoopResult
    failures: tuple[str, ...]
    sealed: Path | None = None

    def raise_for_failure(self) -> None:
        """Raise if the session does not hold all that was planned.

        Raises:
            SafetyTripError: the torque may still be on, or a limit was exceeded.
            KeyboardInterrupt: the user stopped it.
            PalpateError: the arm was stopped, or a run gave no data.
        """
        if self.loop.outcome is Outcome.STOPPED and not self.loop.deactivation_error:
            raise KeyboardInterrupt
        self.loop.raise_for_trip()
        if self.failures:
            text = count(len(self.failures), "failure")
            raise PalpateError(f"{text} while probing: {self.failures[0]}")


def run_probing(job: ProbingJob, watcher: Watcher = NOBODY) -> ProbingOutcome:
    """Probe, and write the session file; it is complete when this returns.

    Args:
        job: what to do.
        watcher: told how far it is.

    Raises:
        InputError: robot file, plan and scenario do not fit each other, or the session cannot be written;
            nothing has moved then, and no session is left. Or a device could not be opened.
    """
    _check_plan(job.plan, job.robot_file)
    simulated = job.wired or is_simulated(job.robot_file)
    clock = _clock(simulated, job.paced)
    observer = _watched(_online_observer(job.online, gains_of(job.robot_file).touch), watcher)
    calibrations = load_calibrations(job.robot_file, emulated=job.wired)
    task = ProbingTask.from_robot_file(job.robot_file, job.plan, calibrations)
    guard = _guard(job.robot_file, calibrations)
    with ExitStack() as stack:
        robot, scenario = _set_up(job, clock, calibrations, stack)
        if not simulated:
            job.permission()
        stack.enter_context(opened(robot, job.robot_file))
        session = stack.enter_context(
            new_session(
                job.session,
                [tick_stream(robot.joint_count)],
                _metadata(job, scenario, calibrations),
                scenario,
                job.hidden,
                wait_for_room=simulated and not job.paced,
            )
        )
        if not simulated:
            stack.enter_context(realtime())
        rate_hz = job.robot_file.control_rate_hz
        watcher.started()
        # An InputError from here: the plan does not suit where the arm stands, and nothing has moved.
        result = run_loop(robot, guard, task, clock, session.log, rate_hz=rate_hz, observer=observer)
        result = _released(robot, result)  # before the log is closed: that may wait for the disk
    return ProbingOutcome(job.session, result, task.failures, session.sealed)


def _released(robot: Robot, result: LoopResult) -> LoopResult:
    """Let go of the robot; where its torque could not be switched off, this is the next try.

    Raises:
        DeviceError: the torque is off, but a device could not be released.
    """
    try:
        robot.deactivate()
    except DeviceError as error:
        with suppress(DeviceError):
            robot.close()
        return replace(result, deactivation_error=str(error))
    robot.close()
    return replace(result, deactivation_error="")


def _check_plan(plan: ProbingPlan, robot_file: RobotFile) -> None:
    """Refuse a plan that would write more than can be read; what else it may not ask, its task says.

    Raises:
        InputError: it would.
    """
    if plan.shortest_s * robot_file.control_rate_hz > MOST_TICKS:
        longest_s = MOST_TICKS / robot_file.control_rate_hz
        raise InputError(
            f"the plan takes {plan.shortest_s / 3600:.3g} h or more, and a session holds "
            f"{longest_s / 3600:.3g} h at {robot_file.control_rate_hz:g} Hz: plan fewer runs, shorter holds "
            "or faster approaches"
        )


def _guard(robot_file: RobotFile, calibrations: Calibrations) -> Guard:
    """The arm's guard, with a model of its own of the arm's weight.

    Raises:
        InputError: the URDF is not valid, says nothing of the arm's masses, or is not the DH table's arm.
    """
    body = RigidBody.of_robot(robot_file, calibrations)
    if joint := body.weightless_joint:
        raise InputError(
            f"{robot_file.urdf_path}: joint '{joint}' moves no mass; give its links an <inertial>"
        )
    check_dh_table(robot_file, body)
    return Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count, body.gravity)


def online_estimators() -> list[str]:
    """Names of the estimators that can run while the arm is probing."""
    return [name for name, estimator in ESTIMATORS.items() if issubclass(estimator, OnlineEstimator)]


def _clock(simulated: bool, paced: bool) -> Clock:
    if not simulated:
        return MonotonicClock()
    return SimulatedClock(MonotonicClock() if paced else None)


def _watched(estimate: Observer, watcher: Watcher) -> Observer:
    def observe(measurement: Measurement, output: TaskOutput) -> Estimates:
        watcher.tick(measurement, output)
        return estimate(measurement, output)

    return observe


def _online_observer(name: str | None, touch: TouchGains) -> Observer:
    if name is None:
        return lambda _measurement, _output: NO_ESTIMATE
    estimator = ESTIMATORS[name]()
    if not isinstance(estimator, OnlineEstimator):
        valid = ", ".join(online_estimators())
        raise InputError(f"estimator '{name}' needs all samples at once. Online: {valid}")
    return OnlineContactEstimator(estimator, touch).observe


def _set_up(
    job: ProbingJob, clock: Clock, calibrations: Calibrations, stack: ExitStack
) -> tuple[Robot, Scenario | None]:
    """The robot, and the world that is simulated for it, which ends with `stack`; None with hardware."""
    drivers = DriverCatalogue(SIMULATED_DRIVERS, *job.drivers)
    drivers.check_names(job.robot_file)
    if job.wired:
        scenario = _altered(job.scenario or load_scenario(DEFAULT_SCENARIO), job)
        arm = emulate(job.robot_file, scenario, clock)
        stack.callback(arm.bench.close)
        return build_robot(arm.robot_file, drivers, clock, calibrations), scenario
    robot = build_robot(job.robot_file, drivers, clock, calibrations)
    return robot, _use_scenario(robot, job)


def _use_scenario(robot: Robot, job: ProbingJob) -> Scenario | None:
    """Hand the scenario to the simulated world; the one that will be simulated, or None with hardware."""
    worlds = [bus for bus in robot.buses.values() if isinstance(bus, PyBulletBus)]
    if not worlds:
        if any(wish is not None for wish in (job.scenario, job.seed, job.hidden)):
            raise InputError(
                f"robot '{robot.name}' is not simulated: scenario, seed and hidden effects mean nothing to "
                "it, unless its devices are emulated (--wire)"
            )
        return None
    world = worlds[0]
    scenario = _altered(job.scenario or world.scenario, job)
    world.use_scenario(scenario)
    return scenario


def _altered(scenario: Scenario, job: ProbingJob) -> Scenario:
    """The scenario with the seed and the hidden effects that are asked for."""
    if job.seed is not None:
        scenario = scenario.with_seed(job.seed)
    return scenario if job.hidden is None else hide(scenario, job.hidden)


def _metadata(job: ProbingJob, scenario: Scenario | None, calibrations: Calibrations) -> SessionMetadata:
    plan = yaml.safe_dump(job.plan.model_dump(mode="json"), sort_keys=False)
    python = ".".join(str(part) for part in sys.version_info[:3])
    return SessionMetadata(
        robot_file=job.robot_file.text,
        urdf=job.robot_file.urdf_path.read_text(encoding="utf-8"),
        calibration=calibrations.text,
        scenario=scenario.public_yaml() if scenario else "",
        software_version=version("palpate"),
        seed=scenario.seed if scenario else None,
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        command_line=job.command_line,
        extra={"source": _source(job, scenario), PLAN: plan, "python": python} | job.extra,
    )


def _source(job: ProbingJob, scenario: Scenario | None) -> str:
    """Where the samples come from."""
    if job.wired:
        return EMULATED
    return "simulated" if scenario else "measured"
