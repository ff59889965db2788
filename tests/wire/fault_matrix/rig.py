"""Run one row of the fault matrix: a probing run in lock-step, the fault, and its outcome."""

import math
import resource
import signal
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

from palpate.control.loop.loop import run_loop
from palpate.control.loop.result import LoopResult, Outcome
from palpate.control.loop.tick_record import NO_ESTIMATE, STREAM_NAME, tick_stream
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.task import ProbingTask
from palpate.robot_io import Session, SessionMetadata, SessionWriter
from palpate.robot_io.drivers.can.line import Timestamps
from palpate.robot_io.drivers.can.motors import MotorBus
from palpate.robot_io.errors import SessionError
from palpate.robot_io.guard import Guard
from palpate.sim_backend.emulators import Fault
from tests.log_in_process import LogInProcess
from tests.wire.fault_matrix.rows import FAMILIES, ProgramFault, Row
from tests.wire.parts import EmulatedRobot

SESSION = "session.mcap"
CHUNK_BYTES = 65_536
GOES_ON_S = 0.05  # a fault that the arm survives for so long stops nothing,
DISK_S = 0.4  # unless it is only seen when so much has been logged
PATIENCE_S = 5.0  # for those that must stop it
SILENT_S = 0.2  # looked at the drives for so long after the end
STEP_BACK_S = 0.02
HELD_UP_S = 0.5
NO_TORQUE_NM = 0.02  # zero on an MIT motor's wire is half a step off
ENOUGH = "the rig has seen enough"
REQUESTED = f"stopped: {ENOUGH}"  # by the rig, as nothing else has stopped the arm


@dataclass
class Observed:
    """What came of a fault."""

    trips: bool  # whether the guard tripped
    ticks: int | None  # from the fault to the safe state; None if there was no trip
    torque_off_ms: float  # from the fault to the last torque of the drives [ms]
    reads: str  # what the user reads
    last_tick_s: float  # of the session's records, on the robot's clock [s]
    fastest_rad_s: float  # how fast a joint still is at the end [rad/s]
    session_events: list[str]  # texts of the session's events


class FaultRig:
    """An arm on emulated wires, its probing run, and the row's fault.

    Args:
        row: what goes wrong.
        folder: for the session.
    """

    def __init__(self, row: Row, folder: Path) -> None:
        self.row, self.path = row, folder / SESSION
        family = FAMILIES[row.family]
        self.setup = EmulatedRobot(family.robot, (*family.changes, *row.changes))
        self.robot, self.clock = self.setup.robot, self.setup.clock
        self.log: LogInProcess | SessionWriter = LogInProcess(self.path, [tick_stream(3)], SessionMetadata())
        self.robot_file = self.setup.arm.robot_file
        self.guard = Guard(self.robot_file.limits, self.robot_file.safe_state, 3)
        self.tick_s = 1e-3 * family.tick_ms
        plan = ProbingPlan(speeds_m_s=(family.speed_m_s,), hold_s=0.1, free_air_s=0.1)
        self._task = ProbingTask.from_robot_file(self.robot_file, plan)
        self._torque_until_s = -math.inf
        self._struck = False
        self._killed = threading.Event()
        self._observer_fails = False
        self._wall_ahead_s = 1.7e9  # of the robot's clock
        if row.fault is ProgramFault.CLOCK_BACK:
            self._stamp_by_wall_clock()
        if isinstance(row.fault, Fault):
            self.setup.faults[family.bus].add(row.fault)
        self.clock.subscribe(self._watch_drives)

    def run(self) -> Observed:
        """Probe until the fault has had its way."""
        with patch("time.time", self._wall_s):
            result = self._run_loop()
        self._let_pass(SILENT_S)
        return self._observed(result, self._close_log(result))

    def _run_loop(self) -> LoopResult | None:
        self.robot.configure()
        if self.row.fault is ProgramFault.DISK_FULL:
            self.log = SessionWriter(self.path, [tick_stream(3)], SessionMetadata(), wait_for_room=True)
        loop = partial(
            run_loop,
            self.robot,
            self.guard,
            self,
            self.clock,
            self.log,
            rate_hz=1.0 / self.tick_s,
            observer=self._observe,
            stop=self._survived,
        )
        if self.row.fault is not ProgramFault.KILLED:
            return loop()
        threading.Thread(target=loop, daemon=True).start()
        assert self._killed.wait(PATIENCE_S)
        return None

    # What the loop sees.

    def start(self, measurement):
        self._task.start(measurement)

    def step(self, measurement, dt_s):
        if (
            not self._struck
            and self.clock.now_s() >= self.row.at_s
            and isinstance(self.row.fault, ProgramFault)
        ):
            self._struck = True
            self._strike(self.row.fault)
        return self._task.step(measurement, dt_s)

    def _observe(self, _measurement, _output):
        if self._observer_fails:
            raise BrokenPipeError("the viewer has gone")
        return NO_ESTIMATE

    def _survived(self) -> str:
        row = self.row
        patience_s = DISK_S if row.fault is ProgramFault.DISK_FULL else GOES_ON_S
        late = self.clock.now_s() > row.at_s + (patience_s if row.ticks is None else PATIENCE_S)
        return ENOUGH if late else ""

    # What goes wrong in the program itself.

    def _strike(self, what: ProgramFault) -> None:
        match what:
            case ProgramFault.EXCEPTION:
                raise ZeroDivisionError("float division by zero")
            case ProgramFault.CTRL_C:
                signal.raise_signal(signal.SIGINT)
            case ProgramFault.TERMINATED:
                signal.raise_signal(signal.SIGTERM)
            case ProgramFault.KILLED:
                self._killed.set()
                threading.Event().wait()  # nothing runs any more
            case ProgramFault.HELD_UP:
                self._let_pass(HELD_UP_S)
            case ProgramFault.CLOCK_BACK:
                self._wall_ahead_s -= STEP_BACK_S
            case ProgramFault.DISK_FULL:
                self._fill_the_disk()
            case ProgramFault.VIEWER_GONE:
                self._observer_fails = True

    def _fill_the_disk(self) -> None:
        """Once something is on it: no file of the writer process may grow much more."""
        give_up_s = time.monotonic() + 30.0
        while self.path.stat().st_size < CHUNK_BYTES / 2 and time.monotonic() < give_up_s:
            time.sleep(0.001)
        most = self.path.stat().st_size + CHUNK_BYTES // 2
        resource.prlimit(self.log._process.pid, resource.RLIMIT_FSIZE, (most, most))

    def _let_pass(self, duration_s: float) -> None:
        for _ in range(round(duration_s / self.tick_s)):
            self.clock.sleep_until(self.clock.now_s() + self.tick_s)

    def _wall_s(self) -> float:
        return self.clock.now_s() + self._wall_ahead_s

    def _stamp_by_wall_clock(self) -> None:
        """Let a CAN adapter stamp its frames by the wall clock, as real ones do."""
        bus, wire = self.robot.buses["motors"], self.setup.arm.wires["motors"]
        if isinstance(bus, MotorBus):
            bus.line._settings = bus.line._settings.model_copy(update={"timestamps": Timestamps.WALL})
            put = wire._put
            wire._put = lambda frame, _: put(frame, self._wall_s())

    # What came of it.

    def _watch_drives(self, time_s: float) -> None:
        if np.abs(self.setup.drive_torque_nm).max() > NO_TORQUE_NM:
            self._torque_until_s = time_s

    def _close_log(self, result: LoopResult | None) -> str:
        reads = "" if result is None else result.one_line()
        try:
            self.log.close()
        except SessionError as error:
            reads += f"; {error}"
        return reads

    def _observed(self, result: LoopResult | None, reads: str) -> Observed:
        session = Session.open(self.path)
        ticks = session.samples(STREAM_NAME)
        tripped = result is not None and result.outcome is not Outcome.FINISHED
        tripped = tripped and result.cause != REQUESTED
        trip_s = ticks["time_s"][np.argmax(ticks["guard_tripped"])] if tripped else np.nan
        return Observed(
            trips=tripped,
            ticks=math.ceil((trip_s - self.row.at_s) / self.tick_s - 1e-6) if tripped else None,
            torque_off_ms=1e3 * (self._torque_until_s - self.row.at_s),
            reads=reads,
            last_tick_s=ticks["time_s"][-1],
            fastest_rad_s=np.abs(self.setup.arm.plant.world.truth().joint_velocity_rad_s).max(),
            session_events=[event.text for event in session.events],
        )
