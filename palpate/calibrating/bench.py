"""Puts a calibration together: robot, clock, guard and session log, simulated or not."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

import numpy as np

from control.arm.rigid_body import RigidBody
from control.loop.journal import Observer
from control.loop.loop import run_loop
from control.loop.realtime import realtime
from control.loop.result import Outcome
from control.loop.task import Task, TaskOutput
from control.loop.tick_record import NO_ESTIMATE, STREAM_NAME, Estimates
from estimation.data.tick_check import checked_ticks
from palpate.arm.arm_session import SOURCE, arm_session, checked_body, released, without_hardware
from palpate.arm.permission import Permission, without_question
from palpate.arm.probing_run import NOBODY, Watcher
from palpate.arm.wired import EMULATED
from palpate.files import open_session
from robot_io.calibration import (
    Calibrations,
    RawData,
    device_identity,
    first_difference,
    load_calibrations,
    parse_calibrations,
    urdf_sha256,
)
from robot_io.clock import Clock
from robot_io.errors import InputError
from robot_io.guard import Guard, Limits
from robot_io.robot import Robot
from robot_io.robot_file import RobotFile, parse_robot_file
from robot_io.session import Session, SessionWriter
from robot_io.types import Measurement
from sim_backend.scenario import Scenario
from sim_backend.world import World

KIND = "calibration_kind"  # key of what was calibrated in the session's metadata
_FAMILY = {"gravity": "torque"}  # kinds whose sessions serve each other


@dataclass(frozen=True)
class CalibrationJob:
    """What is to be calibrated, and where to.

    Attributes:
        kind: force, encoder, torque or gravity.
        robot_file: the robot; its own calibration of this kind is left out meanwhile.
        session: the new session file.
        scenario: simulated world instead of the one that the robot file names.
        seed: of all simulated noise; None leaves the scenario's.
        hidden: what to hide in the simulated world, see `palpate.arm.hiding`.
        wired: emulate the devices of a robot of hardware drivers, and the world behind them.
        paced: let simulated time pass as fast as real time.
        drivers: packages with drivers beside palpate's own.
        command_line: how the program was started.
        permission: called before a real arm is opened, and may refuse by raising.
    """

    kind: str
    robot_file: RobotFile
    session: Path
    scenario: Scenario | None = None
    seed: int | None = None
    hidden: str | None = None
    wired: bool = False
    paced: bool = False
    drivers: tuple[str, ...] = ()
    command_line: str = ""
    permission: Permission = without_question

    @property
    def simulated(self) -> bool:
        """Whether there is no hardware."""
        return without_hardware(self)


@dataclass(frozen=True)
class Bench:
    """A robot ready to be calibrated, and what belongs to it.

    Attributes:
        robot: configured, torque off.
        body: the arm as its robot file and the calibrations that are applied describe it.
        clock: the robot's.
        log: the session's writer.
        world: gives the simulated world, None with hardware.
        calibrations: those that are applied.
    """

    job: CalibrationJob
    robot: Robot
    body: RigidBody
    clock: Clock
    log: SessionWriter
    world: Callable[[], World] | None
    calibrations: Calibrations

    def guard(self, limits: Limits) -> Guard:
        """A guard that holds the arm to these limits."""
        robot_file = self.job.robot_file
        return Guard(limits, robot_file.safe_state, robot_file.joint_count, self.body.gravity)

    def run(self, task: Task, limits: Limits, watcher: Watcher = NOBODY) -> None:
        """Run a task in the loop, under a guard with these limits.

        Raises:
            KeyboardInterrupt: the user stopped it.
            PalpateError: the arm was stopped.
        """

        def observe(measurement: Measurement, output: TaskOutput) -> Estimates:
            watcher.tick(measurement, output)
            return NO_ESTIMATE

        observer: Observer = observe
        watcher.started()
        rate_hz = self.job.robot_file.control_rate_hz
        with ExitStack() as stack:
            if not self.job.simulated:
                stack.enter_context(realtime())
            result = run_loop(
                self.robot, self.guard(limits), task, self.clock, self.log, rate_hz=rate_hz, observer=observer
            )
            result = released(self.robot, result)
        if result.outcome is Outcome.STOPPED and not result.deactivation_error:
            raise KeyboardInterrupt
        result.raise_for_trip()


@contextmanager
def calibration_bench(job: CalibrationJob, now_utc: datetime | None = None) -> Iterator[Bench]:
    """Set everything up; the session file is complete when the context ends.

    Args:
        job: what is wanted.
        now_utc: wall clock; None asks the machine's.

    Raises:
        InputError: robot file, calibrations and scenario do not fit each other, a device could not be opened,
            or the session cannot be written.
    """
    now_utc = now_utc or datetime.now(UTC)
    calibrations = load_calibrations(job.robot_file, now_utc, leave_out=(job.kind,), emulated=job.wired)
    body = checked_body(job.robot_file, calibrations)
    with arm_session(job, calibrations, {KIND: job.kind}, now_utc) as arm:
        yield Bench(job, arm.robot, body, arm.clock, arm.new.log, arm.world, calibrations)


def open_recorded(path: Path, kind: str, robot_file: RobotFile) -> Session:
    """A session to work a calibration out from.

    Args:
        path: the file.
        kind: what is wanted; one motion serves torque and gravity.
        robot_file: the robot that it must be of.

    Raises:
        InputError: it was not made for that, is of another robot or device, or such a calibration was applied
            in it.
    """
    session = open_session(path)
    made_for = session.metadata.extra.get(KIND)
    if made_for is None or _FAMILY.get(made_for, made_for) != _FAMILY.get(kind, kind):
        made = f"palpate calibrate {made_for}" if made_for else "no calibration"
        raise InputError(f"session {path}: is from {made}; palpate calibrate {kind} cannot work on it")
    recorded = parse_robot_file(session.metadata.robot_file, robot_file.path)
    if recorded.name != robot_file.name:
        raise InputError(
            f"session {path}: is of the robot '{recorded.name}', not '{robot_file.name}' (see --robot)"
        )
    if changed := first_difference(device_identity(recorded, kind), device_identity(robot_file, kind)):
        raise InputError(f"session {path}: was recorded with another device: {changed}")
    if kind in parse_calibrations(session.metadata.calibration, f"{path}, its calibration").kinds:
        raise InputError(f"session {path}: a calibration of kind '{kind}' was applied in it already")
    if STREAM_NAME in session.stream_names:
        checked_ticks(session)
    return session


def source_of(raw: Path) -> str | None:
    """What was read for the raw data, as a calibration says it; somebody's data file is taken as measured."""
    if raw.suffix != ".mcap":
        return "measured"
    said = Session.open(raw).metadata.extra.get(SOURCE)
    return "emulated" if said == EMULATED else said if said in ("measured", "simulated") else None


def anywhere(limits: Limits) -> Limits:
    """The limits but for those of position, for an arm without power."""
    count = limits.joint_count
    far_rad = 100.0  # more than any encoder counts
    return limits.model_copy(
        update={"position_min_rad": (-far_rad,) * count, "position_max_rad": (far_rad,) * count}
    )


def slowed(limits: Limits, speed_rad_s: float) -> Limits:
    """The limits with no joint faster than this."""
    return limits.model_copy(
        update={"velocity_rad_s": tuple(np.minimum(limits.velocity_rad_s, speed_rad_s).tolist())}
    )


@dataclass(frozen=True)
class Stamp:
    """What every calibration file says of where it comes from.

    Attributes:
        robot_file: of the robot that it is for.
        raw: session or data file that it was worked out from.
        now_utc: date of the calibration.
        valid_days: how long it may be used.
        made_with: calibrations that were applied meanwhile.
    """

    robot_file: RobotFile
    raw: Path
    now_utc: datetime
    valid_days: float
    made_with: tuple[str, ...] = field(default=())

    def content(self, kind: str) -> dict[str, object]:
        """Everything but the values.

        Raises:
            InputError: the raw data or the URDF cannot be read.
        """
        content: dict[str, object] = {
            "palpate_calibration": 1,
            "kind": kind,
            "robot": self.robot_file.name,
            "device": device_identity(self.robot_file, kind),
            "source": source_of(self.raw),
            "made_utc": self.now_utc.isoformat(timespec="seconds"),
            "valid_until_utc": (self.now_utc + timedelta(days=self.valid_days)).isoformat(timespec="seconds"),
            "software_version": version("palpate"),
            "raw_data": RawData(file=self.raw.name, sha256=_sha256(self.raw)).model_dump(),
            "made_with": self.made_with,
        }
        if kind in ("torque", "gravity"):
            content["urdf_sha256"] = urdf_sha256(self.robot_file)
        return content


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
