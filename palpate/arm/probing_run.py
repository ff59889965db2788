"""Puts a probing run together: robot, clock, guard, task, loop, session log, online estimation."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from control.laws.gains import TouchGains, gains_of
from control.loop.journal import Observer
from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.loop.realtime import realtime
from control.loop.result import LoopResult, Outcome
from control.loop.task import TaskOutput
from control.loop.tick_record import NO_ESTIMATE, Estimates
from control.probing.plan import ProbingPlan
from control.probing.task import ProbingTask
from estimation.estimator import OnlineEstimator
from estimation.estimators import ESTIMATORS
from estimation.online import OnlineContactEstimator
from palpate.arm.arm_session import arm_session, checked_body, released, without_hardware
from palpate.arm.permission import Permission, without_question
from palpate.words import count
from robot_io.calibration import Calibrations, load_calibrations
from robot_io.errors import InputError, PalpateError
from robot_io.guard import Guard
from robot_io.robot_file import RobotFile
from robot_io.types import Measurement
from sim_backend.scenario import Scenario

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
        touched: whether the object was met: else there is nothing to estimate.
    """

    session: Path
    loop: LoopResult
    failures: tuple[str, ...]
    sealed: Path | None = None
    touched: bool = True

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
    estimate = _online_observer(job.online, gains_of(job.robot_file).touch)
    phases: set[Phase] = set()
    observer = _watched(estimate, watcher, phases)
    calibrations = load_calibrations(job.robot_file, emulated=job.wired)
    task = ProbingTask.from_robot_file(job.robot_file, job.plan, calibrations)
    guard = _guard(job.robot_file, calibrations)
    plan = yaml.safe_dump(job.plan.model_dump(mode="json"), sort_keys=False)
    with ExitStack() as stack:
        arm = stack.enter_context(arm_session(job, calibrations, {PLAN: plan} | job.extra))
        if not without_hardware(job):
            stack.enter_context(realtime())
        rate_hz = job.robot_file.control_rate_hz
        watcher.started()
        # An InputError from here: the plan does not suit where the arm stands, and nothing has moved.
        result = run_loop(arm.robot, guard, task, arm.clock, arm.new.log, rate_hz=rate_hz, observer=observer)
        result = released(arm.robot, result)
    touched = Phase.LOADING in phases or bool(result.observer_error)  # who sees nothing more says nothing
    return ProbingOutcome(job.session, result, task.failures, arm.new.sealed, touched)


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
        InputError: as `checked_body`.
    """
    body = checked_body(robot_file, calibrations)
    return Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count, body.gravity)


def online_estimators() -> list[str]:
    """Names of the estimators that can run while the arm is probing."""
    return [name for name, estimator in ESTIMATORS.items() if issubclass(estimator, OnlineEstimator)]


def _watched(estimate: Observer, watcher: Watcher, phases: set[Phase]) -> Observer:
    """The estimate, with somebody who looks on, and with the phases remembered."""

    def observe(measurement: Measurement, output: TaskOutput) -> Estimates:
        phases.add(output.phase)
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
