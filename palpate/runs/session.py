"""Open a robot and a session file for a run, as the user requested."""

import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import KW_ONLY, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from platform import python_version

from palpate.common.console import as_shell_word
from palpate.control.arm.dh import check_dh_table
from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.loop import run_loop
from palpate.control.loop.realtime import frozen_garbage, realtime
from palpate.control.loop.result import LoopResult, Outcome
from palpate.control.loop.task import Task
from palpate.control.loop.tick_record import Observer, tick_stream
from palpate.robot_io.calibration.applied import Calibrations
from palpate.robot_io.clock import Clock, MonotonicClock, SimulatedClock
from palpate.robot_io.driver import DriverCatalog
from palpate.robot_io.errors import DeviceError, InputError
from palpate.robot_io.extras import missing_package
from palpate.robot_io.guard import Guard, Limits
from palpate.robot_io.robot import Robot, build_robot
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.session import SessionMetadata, SessionWriter, Stream
from palpate.runs.hidden_effects import SEAL, hide
from palpate.runs.options import Permission, without_question
from palpate.runs.robots import DEFAULT_SCENARIO, EMULATED, emulate, is_simulated
from palpate.sim_backend.drivers import SimulatedBus
from palpate.sim_backend.engines import EngineName, installed_engines
from palpate.sim_backend.hidden import SealedAnswer, seal
from palpate.sim_backend.scenario import Scenario, load_scenario
from palpate.sim_backend.world import World

SIMULATED_DRIVERS = "palpate.sim_backend.drivers"
SOURCE = "source"  # key of the samples' source in the session's metadata


@dataclass(frozen=True)
class ArmJob:
    """Settings that all runs of an arm share."""

    robot_file: RobotFile
    session: Path  # the new session file
    _: KW_ONLY
    scenario: Scenario | None = None  # simulated world instead of the one that the robot file names
    engine: EngineName | None = None  # physics engine instead of the scenario's
    seed: int | None = None  # seed of all simulated noise, instead of the scenario's
    again: int = 0  # number of earlier runs of this world: hidden effects stay, noise differs
    hidden: str | None = None  # effects to hide in the simulated world, see `palpate.runs.hidden_effects`
    wired: bool = False  # emulate the devices of a robot of hardware drivers, and the world behind them
    paced: bool = False  # whether simulated time runs in real time rather than as fast as possible
    drivers: tuple[str, ...] = ()  # packages or modules with further drivers
    command_line: str = ""  # command line that started the program
    permission: Permission = without_question  # called before a real arm is opened; may refuse by raising

    def __post_init__(self) -> None:
        """Raise `InputError` at once if the job needs a simulation and no physics engine is installed."""
        if self.simulated and not installed_engines():
            raise InputError(f"simulation is not available: {missing_package('mujoco')}")

    @property
    def simulated(self) -> bool:
        """Whether all devices are simulated or emulated."""
        return self.wired or is_simulated(self.robot_file)


@dataclass(frozen=True)
class ArmSession:
    """Open, unpowered robot and the session being written."""

    job: ArmJob
    robot: Robot
    body: RigidBody  # model of the arm for the guard alone, with the applied calibrations
    clock: Clock
    log: SessionWriter
    sealed: Path | None  # sealed file of the hidden effects; None if nothing is hidden
    world: Callable[[], World] | None  # returns the simulated world; None with hardware

    def unlogged(self) -> str:
        """Reason why a real arm's motion is no longer recorded; empty while it is recorded."""
        failure = None if self.world is not None else self.log.failure
        return "" if failure is None else f"writing the session failed ({failure})"

    def guard(self, limits: Limits | None = None) -> Guard:
        """Make a guard of this arm.

        Args:
            limits: limits of the guard; None for those of the robot file.
        """
        robot_file = self.job.robot_file
        return Guard(
            limits or robot_file.limits, robot_file.safe_state, robot_file.joint_count, self.body.gravity
        )

    def run(self, task: Task, observer: Observer, limits: Limits | None = None) -> LoopResult:
        """Run a task in the loop until it ends or logging ends (see `unlogged`); then release the robot.

        The loop runs at the control rate of the robot file, under a guard.

        With hardware, real-time features are enabled. If the torque could not be switched off, the release
        tries again. The robot is released before the session is closed, because closing may wait for the
        disk.

        Args:
            task: task of the arm.
            observer: called in each tick; returns estimates.
            limits: limits of the guard; None for those of the robot file.

        Raises:
            InputError: the task cannot start from the arm's current pose; nothing has moved.
            DeviceError: the torque is off, but a device could not be released; also states why the arm was
                stopped.
        """
        robot, guard, stop = self.robot, self.guard(limits), self.unlogged
        rate_hz = self.job.robot_file.control_rate_hz
        with realtime() if self.world is None else frozen_garbage(collect=False):
            result = run_loop(
                robot, guard, task, self.clock, self.log, rate_hz=rate_hz, observer=observer, stop=stop
            )
            try:
                robot.deactivate()
            except DeviceError as error:
                with suppress(DeviceError):
                    robot.close()
                return replace(result, deactivation_error=str(error))
            try:
                robot.close()
            except DeviceError as error:
                if not result.cause:
                    raise
                cause = f"the arm was stopped: {result.cause}"
                raise DeviceError(f"{cause}; then the arm's devices failed to close: {error}") from error
        return replace(result, deactivation_error="")


@contextmanager
def arm_session(
    job: ArmJob,
    calibrations: Calibrations,
    extra: Mapping[str, str],
    now_utc: datetime | None = None,
    streams: Sequence[Stream] = (),
) -> Iterator[ArmSession]:
    """Open the robot and begin the session file, which is complete when the context ends.

    Args:
        job: arm and output file.
        calibrations: calibrations of readings and commands.
        extra: further texts for the session's metadata.
        now_utc: current time; None for the machine's wall clock.
        streams: further streams besides the ticks.

    Raises:
        InputError: robot file, drivers and scenario do not fit each other, the URDF lacks the arm's masses or
            does not match the DH table, a device could not be opened, or the session cannot be written;
            nothing has moved then, and no session is left.
        SessionError: the session file already exists.
    """
    body = RigidBody.of_robot(job.robot_file, calibrations)
    if joint := body.weightless_joint:
        raise InputError(
            f"{job.robot_file.urdf_path}: joint '{joint}' moves no mass; give its links an <inertial>"
        )
    check_dh_table(job.robot_file, body)
    if job.simulated:
        clock: Clock = SimulatedClock(MonotonicClock() if job.paced else None)
    else:
        clock = MonotonicClock()
    with ExitStack() as stack:
        drivers = DriverCatalog(SIMULATED_DRIVERS, *job.drivers)
        # Built with --wire too, to check the replaced drivers.
        robot = build_robot(job.robot_file, drivers, clock, calibrations)
        bus = next((bus for bus in robot.buses.values() if isinstance(bus, SimulatedBus)), None)
        scenario: Scenario | None = None
        world: Callable[[], World] | None = None
        if job.wired:
            scenario = _requested_scenario(job.scenario or load_scenario(DEFAULT_SCENARIO), job)
            arm = emulate(job.robot_file, scenario, clock)
            stack.callback(arm.emulator.close)
            robot, world = build_robot(arm.robot_file, drivers, clock, calibrations), lambda: arm.plant.world
        elif bus is not None:
            scenario, world = _requested_scenario(job.scenario or bus.scenario, job), lambda: bus.world
            bus.use_scenario(scenario)
        elif any(option is not None for option in (job.scenario, job.engine, job.seed, job.hidden)):
            raise InputError(
                f"robot '{job.robot_file.name}' is not simulated: scenario, engine, seed and hidden effects "
                "do not apply to it, unless its devices are emulated (--wire)"
            )
        if not job.simulated:
            job.permission()
        try:
            stack.enter_context(robot)
        except DeviceError as error:
            path = job.robot_file.path
            remedy = f"palpate doctor --robot {as_shell_word(str(path))} shows what is connected"
            raise InputError(f"{path}: {error}; {remedy}") from error
        source = EMULATED if job.wired else "simulated" if scenario else "measured"
        hidden = scenario.hidden if scenario else ()
        mark = {SEAL: secrets.token_hex(16)} if hidden else {}
        metadata = SessionMetadata(
            robot_file=job.robot_file.text,
            urdf=job.robot_file.urdf_path.read_text(encoding="utf-8"),
            calibration=calibrations.text,
            scenario=scenario.public_yaml() if scenario else "",
            software_version=version("palpate"),
            seed=scenario.seed if scenario else None,
            created_utc=(now_utc or datetime.now(UTC)).isoformat(timespec="seconds"),
            command_line=job.command_line,
            extra={SOURCE: source, "python": python_version(), **extra, **mark},
        )
        # The session file is created before the sealed answer, and neither replaces a file. If two programs
        # want the same name, one of them fails before it has written anything.
        kept, waits = [tick_stream(robot.joint_count), *streams], job.simulated and not job.paced
        log = stack.enter_context(SessionWriter(job.session, kept, metadata, wait_for_room=waits))
        sealed = None
        try:
            if scenario is not None and hidden:
                drawn = job.hidden is not None and not Path(job.hidden).suffix
                seed = scenario.seed - job.again if drawn else None
                sealed = seal(job.session, SealedAnswer(hidden, seed, metadata.created_utc, mark[SEAL]))
            yield ArmSession(job, robot, body, clock, log, sealed, world)
        except InputError:  # nothing has moved
            log.close()
            for file in filter(None, (job.session, sealed)):
                file.unlink(missing_ok=True)
            raise


def raise_for_end(result: LoopResult) -> None:
    """Raise an error if the arm was stopped before the task was done.

    Args:
        result: result of the loop.

    Raises:
        SafetyTripError: the torque may still be on, or a limit was exceeded.
        KeyboardInterrupt: the user stopped it.
        PalpateError: a device or the task failed.
    """
    if result.outcome is Outcome.STOPPED and not result.deactivation_error:
        raise KeyboardInterrupt
    result.raise_for_trip()


def _requested_scenario(scenario: Scenario, job: ArmJob) -> Scenario:
    """Return the scenario with the requested engine, seed and hidden effects."""
    if job.engine is not None:
        scenario = scenario.with_engine(job.engine)
    if job.seed is not None:
        scenario = scenario.with_seed(job.seed)
    hidden = scenario if job.hidden is None else hide(scenario, job.hidden)
    return hidden.with_seed(scenario.seed + job.again)
