"""Haptic loop in a separate process: hand position in, force out, at 1 kHz.

The process owns the operator's device, the virtual arm and object, and the leader's session. It receives only
estimates that the leader's main process has checked. If that process dies, the loop switches the force off,
closes the session and ends.
"""

from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from math import inf
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.loop.realtime import realtime
from palpate.control.loop.timing import Histogram, SectionTiming, TickGrid
from palpate.control.teleop.leader_arm import build_operator
from palpate.control.teleop.messaging import LINK_STREAM
from palpate.control.teleop.virtual_object import VirtualArm, VirtualObject
from palpate.robot_io.clock import Clock, MonotonicClock
from palpate.robot_io.errors import InputError, PalpateError, error_text
from palpate.robot_io.link.messages import ObjectEstimate, short_number
from palpate.robot_io.operator.device import OperatorDevice
from palpate.robot_io.robot_file import RobotFile
from palpate.robot_io.session import Column, SessionMetadata, SessionWriter, Stream
from palpate.runs.robots import find_robot
from palpate.sim_backend.scenario import Scenario
from palpate.teleop.virtual_object import estimate_data, force_law, summarize_estimate, terms_of

_DOWN = np.array((0.0, 0.0, -1.0))  # press direction of the scene's object
GUESS = -1  # revision of the scene's own object, before anything was probed
_PERIOD_S = 1e-3
_REPORT_TICKS = 20
_SPIN_S = 1e-4  # the loop polls the clock for this time before a tick, because waking up takes 50 us
_MOST_UNREAD = 50  # largest number of unread reports; the loop never waits for the main process
STREAM_NAME, FEEL = "haptic", "feel"


@dataclass(frozen=True)
class HapticJob:
    """Settings of the haptic loop: virtual object, device and session file."""

    robot: str  # file or name of the virtual arm
    operator: str  # file or name of the operator's device
    scene: Scenario  # virtual object before the first estimate
    session: Path
    metadata: SessionMetadata
    largest_jump_n: float = 0.05  # largest change of force per tick after an update of the object [N]

    def __post_init__(self) -> None:
        if not 0.0 < self.largest_jump_n < inf:
            raise InputError(f"--jump-n {self.largest_jump_n}: must be above 0 and finite")


@dataclass(frozen=True)
class HapticCommands:
    """Message from the main process to the haptic process."""

    read: int  # number of reports read
    render: ObjectEstimate | None = None  # new estimate of the object
    notes: tuple[tuple[str, str], ...] = ()  # for the session, kind and text
    link: tuple[object, ...] | None = None  # for the session, a record of `LINK_STREAM`
    end: bool = False


@dataclass(frozen=True)
class HapticReport:
    """Message from the haptic process to the main process."""

    tip_world_m: tuple[float, ...]  # shape (3,)
    force_n: float
    selected: tuple[tuple[float, ...], ...] = ()  # places that the operator chose, (3,) each [m]
    refused: tuple[str, ...] = ()  # estimates that could not be rendered
    finished: bool = False  # whether the script has ended
    lateness: SectionTiming | None = None  # of the whole run, in the last report
    failure: str = ""  # reason of an early end, in the last report
    opened: bool = True  # whether the operator's device could be opened; without it there is no session


_NOTHING = HapticReport((0.0, 0.0, 0.0), 0.0)


def haptic_stream(joint_count: int) -> Stream:
    """Return the columns of a haptic tick.

    Args:
        joint_count: number of joints of the virtual arm.
    """
    return Stream(
        STREAM_NAME,
        (
            Column("time_s", "s", 1, "start of the tick, on the leader's clock"),
            Column("lateness_s", "s", 1, "how late the tick began"),
            Column("step_s", "s", 1, "time spent in the previous tick"),
            Column("tip_position_world_m", "m", 3, "of hand and virtual arm"),
            Column("tip_velocity_world_m_s", "m/s", 3, "of hand and virtual arm"),
            Column("joint_position_rad", "rad", joint_count, "of the virtual arm"),
            Column("reached", "1", 1, "whether the virtual arm reaches the hand", "bool"),
            Column("depth_m", "m", 1, "of the tip below the virtual surface; negative above it"),
            Column("force_n", "N", 1, "rendered, along the surface's normal"),
            Column("felt_n", "N", 1, "part of it that the device can exert"),
            Column("withheld_n", "N", 1, "withheld from the model's force, for passivity and continuity"),
            Column("energy_j", "J", 1, "work done by the hand since touch"),
            Column("revision", "1", 1, "revision of the rendered estimate; -1: the scene's guess", "int32"),
        ),
    )


def run_haptics(pipe: Connection, job: HapticJob) -> None:
    """Render until the script ends, the main process requests the end, or its pipe closes.

    Args:
        pipe: connection to the main process.
        job: settings of the loop.
    """
    clock, lateness, failure, opened = MonotonicClock(), Histogram(), "", False
    try:
        with build_operator(job.operator, clock) as device:
            opened = True
            robot_file = find_robot(job.robot)
            streams = [haptic_stream(robot_file.joint_count), LINK_STREAM]
            with ExitStack() as stack:
                log = stack.enter_context(SessionWriter(job.session, streams, job.metadata))
                # Before the session is closed, because closing may take long.
                stack.callback(device.deactivate)
                log.event(clock.now_s(), "realtime", str(stack.enter_context(realtime())))
                haptics = _Haptics(job, robot_file, device, log, pipe)
                device.activate()
                haptics.run(clock, lateness)
    # The main process is gone, and everything is closed.
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except PalpateError as error:
        failure = str(error)
    except Exception as error:  # the main process prints it
        failure = error_text(error)
    with suppress(OSError):
        last = replace(_NOTHING, finished=True, lateness=lateness.summary(), failure=failure, opened=opened)
        pipe.send(last)


class _Haptics:
    """State and loop of one run."""

    def __init__(
        self,
        job: HapticJob,
        robot_file: RobotFile,
        device: OperatorDevice,
        log: SessionWriter,
        pipe: Connection,
    ) -> None:
        self._device, self._log, self._pipe = device, log, pipe
        body, home_rad = RigidBody.of_robot(robot_file), np.array(robot_file.home_rad)
        self._arm = VirtualArm(body, np.array(robot_file.sensor_axis_tip), _DOWN, home_rad)
        surface_m = np.array((0.0, 0.0, job.scene.object.surface_height_m))
        self._object = VirtualObject(force_law(terms_of(job.scene)), surface_m, -_DOWN, job.largest_jump_n)
        self._revision, self._ticks, self._sent, self._read = GUESS, 0, 0, 0
        self._selected: list[tuple[float, ...]] = []
        self._refused: list[str] = []
        self._was_selected = self._end = False

    def run(self, clock: Clock, lateness: Histogram) -> None:
        """Run all ticks until the end, and collect how late they began."""
        grid = TickGrid(clock.now_s() + _PERIOD_S, _PERIOD_S)
        periods, busy_s = 1, 0.0
        late_s = np.zeros(_REPORT_TICKS)
        while not self._end:
            clock.sleep_until(grid.due_s - _SPIN_S)
            while (now_s := clock.now_s()) < grid.due_s:
                pass
            late_s[grid.index % _REPORT_TICKS] = now_s - grid.due_s
            self._tick(now_s, now_s - grid.due_s, busy_s, periods * _PERIOD_S)
            if grid.index % _REPORT_TICKS == _REPORT_TICKS - 1:
                lateness.add(late_s)
            ended_s = clock.now_s()
            busy_s = ended_s - now_s
            periods = grid.advance(ended_s)

    def _tick(self, now_s: float, late_s: float, busy_s: float, dt_s: float) -> None:
        hand = self._device.read()
        touch = self._object.step(hand.position_world_m, hand.velocity_world_m_s, dt_s)
        felt_n = self._device.set_force(touch.force_world_n)
        self._arm.follow(hand.position_world_m)
        if hand.select and not self._was_selected:  # the button went down: at the surface below the tip
            place = self._arm.tip_world_m - touch.depth_m * _DOWN
            self._selected.append(tuple(place.tolist()))
        self._was_selected = hand.select
        self._log.append(
            STREAM_NAME,
            (
                now_s,
                late_s,
                busy_s,
                hand.position_world_m,
                hand.velocity_world_m_s,
                self._arm.position_rad,
                self._arm.reached,
                touch.depth_m,
                touch.force_n,
                -float(felt_n.dot(_DOWN)),
                touch.withheld_n,
                touch.energy_j,
                self._revision,
            ),
        )
        while self._pipe.poll():
            commands = self._pipe.recv()
            self._read, self._end = commands.read, self._end or commands.end
            for kind, text in commands.notes:
                self._log.event(now_s, kind, text)
            if commands.link is not None:
                self._log.append(LINK_STREAM.name, commands.link)
            if commands.render is not None:
                estimate = commands.render
                try:
                    self._object.update(force_law(estimate.model), np.array(estimate.surface_world_m))
                except InputError as error:  # the current target continues
                    self._refused.append(f"estimate {estimate.revision}: {error}")
                    continue
                self._revision = estimate.revision
                target, summary = short_number(estimate.target), summarize_estimate(estimate)
                text = f"estimate {estimate.revision}, target {target}: {summary}"
                self._log.event(now_s, FEEL, text, estimate_data(estimate))
        self._ticks += 1
        if self._ticks % _REPORT_TICKS == 0 and self._sent - self._read < _MOST_UNREAD:
            tip = tuple(hand.position_world_m.tolist())
            finished = getattr(self._device, "finished", False)
            chosen, refused = tuple(self._selected), tuple(self._refused)
            self._pipe.send(HapticReport(tip, touch.force_n, chosen, refused, finished))
            self._sent += 1
            self._selected.clear()
            self._refused.clear()
