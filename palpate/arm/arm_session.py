"""From what a user asked for to an open robot with a session: the same for probing and for calibrating."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

from control.arm.dh import check_dh_table
from control.arm.rigid_body import RigidBody
from control.loop.result import LoopResult
from control.loop.tick_record import tick_stream
from palpate.arm.hiding import hide
from palpate.arm.new_session import NewSession, new_session
from palpate.arm.opened import opened
from palpate.arm.permission import Permission
from palpate.arm.wired import DEFAULT_SCENARIO, EMULATED, emulate, is_simulated
from robot_io.calibration import Calibrations
from robot_io.clock import Clock, MonotonicClock, SimulatedClock
from robot_io.driver import DriverCatalogue
from robot_io.errors import DeviceError, InputError
from robot_io.robot import Robot, build_robot
from robot_io.robot_file import RobotFile
from robot_io.session import SessionMetadata
from sim_backend.drivers.pybullet_bus import PyBulletBus
from sim_backend.scenario import Scenario, load_scenario
from sim_backend.world import World

SIMULATED_DRIVERS = "sim_backend.drivers"
SOURCE = "source"  # key of where the samples come from, in the session's metadata


class ArmJob(Protocol):
    """What every job with an arm says; see `palpate.arm.probing_run.ProbingJob`."""

    @property
    def robot_file(self) -> RobotFile: ...  # noqa: D102
    @property
    def session(self) -> Path: ...  # noqa: D102
    @property
    def scenario(self) -> Scenario | None: ...  # noqa: D102
    @property
    def seed(self) -> int | None: ...  # noqa: D102
    @property
    def hidden(self) -> str | None: ...  # noqa: D102
    @property
    def wired(self) -> bool: ...  # noqa: D102
    @property
    def paced(self) -> bool: ...  # noqa: D102
    @property
    def drivers(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def command_line(self) -> str: ...  # noqa: D102
    @property
    def permission(self) -> Permission: ...  # noqa: D102


@dataclass(frozen=True)
class ArmSession:
    """A robot whose devices are open and without power, and the session that is being written.

    Attributes:
        robot: configured.
        clock: the robot's.
        new: the session file that is begun.
        world: gives the simulated world, None with hardware.
    """

    robot: Robot
    clock: Clock
    new: NewSession
    world: Callable[[], World] | None


def without_hardware(job: ArmJob) -> bool:
    """Whether nothing but simulated or emulated devices stand behind a job."""
    return job.wired or is_simulated(job.robot_file)


def checked_body(robot_file: RobotFile, calibrations: Calibrations) -> RigidBody:
    """The arm, once it is known that its masses and its DH table can be relied on.

    Raises:
        InputError: the URDF is not valid, says nothing of the arm's masses, or is not the DH table's arm.
    """
    body = RigidBody.of_robot(robot_file, calibrations)
    if joint := body.weightless_joint:
        raise InputError(
            f"{robot_file.urdf_path}: joint '{joint}' moves no mass; give its links an <inertial>"
        )
    check_dh_table(robot_file, body)
    return body


@contextmanager
def arm_session(
    job: ArmJob, calibrations: Calibrations, extra: Mapping[str, str], now_utc: datetime | None = None
) -> Iterator[ArmSession]:
    """Open the robot and begin the session file, which is complete when the context ends.

    Args:
        job: what is wanted.
        calibrations: what is applied.
        extra: further texts for the session's metadata.
        now_utc: wall clock; None asks the machine's.

    Raises:
        InputError: robot file, drivers and scenario do not fit each other, a device could not be opened, or
            the session cannot be written; nothing has moved then, and no session is left.
    """
    simulated = without_hardware(job)
    clock = _clock(simulated, job.paced)
    with ExitStack() as stack:
        robot, scenario, world = _set_up(job, clock, calibrations, stack)
        if not simulated:
            job.permission()
        stack.enter_context(opened(robot, job.robot_file))
        new = stack.enter_context(
            new_session(
                job.session,
                [tick_stream(robot.joint_count)],
                _metadata(job, scenario, calibrations, extra, now_utc or datetime.now(UTC)),
                scenario,
                job.hidden,
                wait_for_room=simulated and not job.paced,
            )
        )
        yield ArmSession(robot, clock, new, world)


def released(robot: Robot, result: LoopResult) -> LoopResult:
    """Let go of the robot; where its torque could not be switched off, this is the next try.

    To be called before the session is closed, which may wait for its disk.

    Raises:
        DeviceError: the torque is off, but a device could not be released; says why the arm was stopped, too.
    """
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
        raise DeviceError(f"the arm was stopped: {result.cause}; then: {error}") from error
    return replace(result, deactivation_error="")


def _clock(simulated: bool, paced: bool) -> Clock:
    if not simulated:
        return MonotonicClock()
    return SimulatedClock(MonotonicClock() if paced else None)


def _set_up(
    job: ArmJob, clock: Clock, calibrations: Calibrations, stack: ExitStack
) -> tuple[Robot, Scenario | None, Callable[[], World] | None]:
    """The robot, and what is simulated for it, which ends with `stack`; None with hardware."""
    drivers = DriverCatalogue(SIMULATED_DRIVERS, *job.drivers)
    drivers.check_names(job.robot_file)
    if job.wired:
        scenario = _altered(job.scenario or load_scenario(DEFAULT_SCENARIO), job)
        arm = emulate(job.robot_file, scenario, clock)
        stack.callback(arm.bench.close)
        return build_robot(arm.robot_file, drivers, clock, calibrations), scenario, lambda: arm.plant.world
    robot = build_robot(job.robot_file, drivers, clock, calibrations)
    bus = next((bus for bus in robot.buses.values() if isinstance(bus, PyBulletBus)), None)
    return robot, _use_scenario(bus, job), (lambda: bus.world) if bus else None


def _use_scenario(bus: PyBulletBus | None, job: ArmJob) -> Scenario | None:
    """Hand the scenario to the simulated world; the one that will be simulated, or None with hardware."""
    if bus is None:
        if any(wish is not None for wish in (job.scenario, job.seed, job.hidden)):
            raise InputError(
                f"robot '{job.robot_file.name}' is not simulated: scenario, seed and hidden effects mean "
                "nothing to it, unless its devices are emulated (--wire)"
            )
        return None
    scenario = _altered(job.scenario or bus.scenario, job)
    bus.use_scenario(scenario)
    return scenario


def _altered(scenario: Scenario, job: ArmJob) -> Scenario:
    """The scenario with the seed and the hidden effects that are asked for."""
    if job.seed is not None:
        scenario = scenario.with_seed(job.seed)
    return scenario if job.hidden is None else hide(scenario, job.hidden)


def _metadata(
    job: ArmJob,
    scenario: Scenario | None,
    calibrations: Calibrations,
    extra: Mapping[str, str],
    now_utc: datetime,
) -> SessionMetadata:
    source = EMULATED if job.wired else "simulated" if scenario else "measured"
    python = ".".join(str(part) for part in sys.version_info[:3])
    return SessionMetadata(
        robot_file=job.robot_file.text,
        urdf=job.robot_file.urdf_path.read_text(encoding="utf-8"),
        calibration=calibrations.text,
        scenario=scenario.public_yaml() if scenario else "",
        software_version=version("palpate"),
        seed=scenario.seed if scenario else None,
        created_utc=now_utc.isoformat(timespec="seconds"),
        command_line=job.command_line,
        extra={SOURCE: source, "python": python, **extra},
    )
