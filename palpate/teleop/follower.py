"""The follower: an arm that holds still, probes what the leader asks for, and says what it found.

The control loop runs in the main thread, as for `palpate probe`; a second thread talks to the leader, and
processes of their own estimate. Neither can hold the loop up, and only the queue of targets leads into it.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from queue import SimpleQueue
from typing import NamedTuple

import numpy as np
import yaml

from control.arm.rigid_body import RigidBody
from control.laws.gains import gains_of
from control.laws.touch import RunningMean
from control.loop.loop import run_loop
from control.loop.phases import Phase
from control.loop.realtime import realtime
from control.loop.result import LoopResult, Outcome
from control.loop.task import NO_RUN, TaskOutput
from control.loop.tick_record import NO_ESTIMATE, Estimates
from control.loop.way_out import one_line
from control.probing.plan import ProbingPlan
from control.probing.sites import check_against_guard
from control.probing.task import ProbingTask
from control.teleop.follower_task import FollowerTask, OnSilence
from control.teleop.link_record import LINK_STREAM, link_record
from control.teleop.peer import Arrival, Peer, PeerLimits
from control.teleop.target_queue import TargetQueue
from palpate.runs.probing import PLAN
from palpate.runs.session import ArmJob, arm_session, checked_body, released
from palpate.teleop.estimating import Estimator, sample_stream
from palpate.teleop.in_words import in_words
from robot_io.calibration import load_calibrations
from robot_io.clock import Clock
from robot_io.guard import Guard
from robot_io.link import (
    Frame,
    FrameError,
    Intent,
    Line,
    LineSettings,
    ObjectEstimate,
    Report,
    Target,
    TargetState,
)
from robot_io.link.messages import MOST_TEXT
from robot_io.session import RecordArray, Samples, SessionWriter, Stream
from robot_io.types import Measurement

TALK_S = 0.02  # between two reports
_RESEND_S = 0.2  # of an estimate that the leader has not seen
_LINK_RECORD_S = 0.1
_SETTLE_S = 3.0  # that the arm holds still for estimates when all targets are over
_FAREWELLS = 25  # times that the last report is sent
_MOST_SAMPLES = 200_000  # of one target that are kept for its estimate
Say = Callable[[str], None]


@dataclass(frozen=True)
class FollowerJob(ArmJob):
    """Which arm follows, how it probes, and how it is linked."""

    plan: ProbingPlan  # how each target is probed; targets of its own it has none
    _: KW_ONLY
    link: LineSettings = field(default_factory=LineSettings)
    limits: PeerLimits = field(default_factory=PeerLimits)
    on_silence: OnSilence = OnSilence.FINISH
    diagnose: bool = True


@dataclass(frozen=True)
class FollowerOutcome:
    """How it ended."""

    loop: LoopResult
    states: dict[int, TargetState]  # what became of each target
    estimates: int  # how many were made
    talk_error: str  # why the link was given up; empty if it was not

    def raise_for_failure(self) -> None:
        """Raise if the arm was stopped.

        Raises:
            KeyboardInterrupt: the user stopped it.
            PalpateError: a limit was exceeded, a device failed, or the torque may still be on.
        """
        if self.loop.outcome is Outcome.STOPPED and not self.loop.deactivation_error:
            raise KeyboardInterrupt
        self.loop.raise_for_trip()


def run_follower(job: FollowerJob, say: Say) -> FollowerOutcome:
    """Follow until the leader has ended, somebody stops it, or the guard trips; the session is whole then.

    Raises:
        InputError: robot file, plan, link and scenario do not fit each other; nothing has moved.
    """
    robot_file, rate_hz = job.robot_file, job.robot_file.control_rate_hz
    check_against_guard(job.plan, robot_file)
    calibrations = load_calibrations(robot_file, emulated=job.wired)
    guard_body, body = checked_body(robot_file, calibrations), RigidBody.of_robot(robot_file, calibrations)
    guard = Guard(robot_file.limits, robot_file.safe_state, robot_file.joint_count, guard_body.gravity)
    plan_text = yaml.safe_dump(job.plan.model_dump(mode="json"), sort_keys=False)

    def probing(target: Target) -> ProbingTask:
        place = {
            "targets_world_m": (target.position_world_m,),
            "press_direction_world": target.direction_world,
        }
        plan = job.plan.model_copy(update=place)
        return ProbingTask.from_robot_file(robot_file, plan, calibrations, body)

    with ExitStack() as stack:
        arm = stack.enter_context(arm_session(job, calibrations, {PLAN: plan_text}, streams=(LINK_STREAM,)))
        line = stack.enter_context(Line("follower", job.link, arm.clock))
        talk = Talk(line, arm.clock, job, say)
        stack.callback(talk.close)
        axis = np.array(robot_file.sensor_axis_tip)
        task = FollowerTask(
            body, axis, gains_of(robot_file), talk.queue, probing, talk.settled, job.on_silence
        )
        if not job.simulated:
            stack.enter_context(realtime())
        observer = Observer(talk, arm.log, robot_file.joint_count, len(list(job.plan.runs())))
        talk.start()
        say("waiting for a leader; Ctrl-C brings the arm to rest")
        result = run_loop(
            arm.robot, guard, task, arm.clock, arm.log, rate_hz=rate_hz, observer=observer.observe
        )
        result = released(arm.robot, result)
        talk.farewell(result.cause)
    return FollowerOutcome(result, talk.queue.states(), talk.estimates, talk.error)


class Talk(threading.Thread):
    """Listens to the leader and answers it, apart from the control loop.

    Attributes:
        queue: of targets, filled here.
        peer: what is known of the leader.
        line: to it.
        moment: what the arm does and feels; the loop replaces it in every tick.
        notes: for the session, (kind, text), which the loop takes.
        estimates: how many were made.
        error: why talking was given up; empty while it goes on.
    """

    def __init__(self, line: Line, clock: Clock, job: FollowerJob, say: Say) -> None:
        super().__init__(daemon=True)
        self.queue, self.peer, self.line = TargetQueue(), Peer(job.limits), line
        self.moment = _Moment(Phase.IDLE, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, -1.0), 0.0)
        self.notes: deque[tuple[str, str]] = deque()
        self.estimates, self.error = 0, ""
        self._clock, self._say, self._over = clock, say, threading.Event()
        self._work: SimpleQueue[tuple[Stream, RecordArray, int, bool]] = SimpleQueue()
        self._estimator = Estimator(diagnose=job.diagnose)
        # by how many leaders came before, and target: another leader counts from 0 again
        self._newest: dict[tuple[int, int], ObjectEstimate] = {}
        self._seen, self._resend_s, self._restarts = -1, 0.0, 0
        self._asked_s = math.nan

    def settled(self) -> bool:
        """Whether no estimate is still to come or to be seen by a leader who can be heard.

        From the first time that this is asked on, they are waited for `_SETTLE_S`.
        """
        if math.isnan(self._asked_s):
            self._asked_s = self._clock.now_s()
        waiting = self._estimator.busy or not self._work.empty()
        unseen = bool(self._unseen()) and self.queue.linked
        too_long = self._clock.now_s() > self._asked_s + _SETTLE_S
        return bool(self.error) or too_long or not (waiting or unseen)

    def look(self, stream: Stream, records: RecordArray, target: int, *, last: bool) -> None:
        """Have a target's samples estimated; takes no time."""
        self._work.put((stream, records, target, last))

    def run(self) -> None:
        """See `threading.Thread.run`."""
        try:
            while not self._over.wait(TALK_S):
                self._listen()
                self._think()
                self.line.send(self._report())
                self._send_estimates()
        except Exception as error:  # a follower that cannot talk goes on as if the link were silent
            self.error = one_line(error)
            self._say(f"the link was given up, nothing new is begun: {self.error}")
        finally:
            self.queue.linked = False

    def farewell(self, cause: str) -> None:
        """Say that the arm has ended, and why it was stopped if it was."""
        self.close()
        with suppress(Exception):  # nobody needs to hear it
            for _ in range(_FAREWELLS):
                self.line.send(replace(self._report(), remark=cause[:MOST_TEXT], ended=True))
                time.sleep(TALK_S)

    def close(self) -> None:
        """Stop talking; can be called twice."""
        self._over.set()
        if self.is_alive():
            self.join()
        self._estimator.close()

    def _listen(self) -> None:
        for at_s, frame in self.line.receive():
            arrival = self.peer.judge(frame, at_s)
            if self.peer.restarts != self._restarts:
                self._restarts = self.peer.restarts
                self._seen = -1
                self.queue.forget()
                self._say("another leader has begun: the targets of the last one are dropped")
            if arrival is Arrival.FRESH:
                self._take(frame, at_s)
        linked = not self.peer.silent(self._clock.now_s())
        if linked != self.queue.linked:
            self._say("the leader is heard" if linked else "the leader is silent: nothing new is begun")
        self.queue.linked = linked

    def _take(self, frame: Frame, at_s: float) -> None:
        try:
            message = frame.message
        except FrameError:
            self.line.malformed += 1
            return
        self.line.heard(frame, at_s)
        if isinstance(message, Intent):
            self.queue.take(message)
            self._seen = message.estimate_seen

    def _think(self) -> None:
        """Hand samples to the estimator, and take its answers."""
        while not self._work.empty():
            stream, records, target, last = self._work.get()
            columns = {column.name: records[column.name].copy() for column in stream.columns}
            self._estimator.look(Samples(stream, columns), target, last=last)
        for answer in self._estimator.answers():
            if isinstance(answer, str):
                self.notes.append(("no_estimate", answer))
                self._say(answer)
                continue
            key = (self._restarts, answer.target)
            kept = self._newest.get(key)
            if kept is not None and (kept.runs, bool(kept.verdict)) > (answer.runs, bool(answer.verdict)):
                continue  # less, and late
            self._newest[key] = replace(answer, revision=self.estimates)
            self.estimates += 1
            text = f"target {answer.target}: {in_words(answer)}"
            self.notes.append(("estimate", text))
            self._say(text)

    def _unseen(self) -> list[ObjectEstimate]:
        newest = sorted(self._newest.values(), key=lambda one: one.revision)
        return [one for one in newest if one.revision > self._seen]

    def _send_estimates(self) -> None:
        """The oldest that the leader has not seen; it says which is the newest that it has."""
        unseen, now_s = self._unseen(), self._clock.now_s()
        if unseen and now_s >= self._resend_s:
            self._resend_s = now_s + _RESEND_S
            for estimate in unseen:
                self.line.send(estimate)

    def _report(self) -> Report:
        moment, states = self.moment, self.queue.states()
        return Report(
            phase=int(moment.phase),
            target=self.queue.current,
            tip_world_m=moment.tip_world_m,
            speed_m_s=moment.speed_m_s,
            direction_world=moment.direction_world,
            force_n=moment.force_n,
            targets=tuple(states),
            states=tuple(int(state) for state in states.values()),
            remark=self.queue.remark[:MOST_TEXT],
            ended=False,
        )


class _Moment(NamedTuple):
    """What a report says of the arm."""

    phase: Phase
    tip_world_m: tuple[float, float, float]
    speed_m_s: float
    direction_world: tuple[float, float, float]
    force_n: float


class Observer:
    """What the loop hands on in each tick: to the leader, to the estimator, and to the log."""

    def __init__(self, talk: Talk, log: SessionWriter, joint_count: int, runs: int) -> None:
        self._talk, self._log, self._runs = talk, log, runs
        self._stream = sample_stream(joint_count)
        self._records = np.zeros(_MOST_SAMPLES, self._stream.dtype)
        self._count, self._target, self._run, self._first_run = 0, -1, NO_RUN, 0
        self._air, self._phase = RunningMean(), Phase.IDLE
        self._record_s = 0.0

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """See `control.loop.journal.Observer`."""
        self._tare(measurement, output)
        self._collect(measurement, output)
        speed_m_s = float(output.tip_velocity_world_m_s.dot(output.press_direction_world))
        tip, direction = output.tip_position_world_m.tolist(), output.press_direction_world.tolist()
        force_n = measurement.force_n - self._air.mean
        self._talk.moment = _Moment(output.phase, tuple(tip), speed_m_s, tuple(direction), force_n)
        if measurement.time_s >= self._record_s:
            self._record_s = measurement.time_s + _LINK_RECORD_S
            record = link_record(self._talk.peer, self._talk.line.malformed, measurement.time_s)
            self._log.append(LINK_STREAM.name, record)
        while self._talk.notes:
            self._log.event(measurement.time_s, *self._talk.notes.popleft())
        return NO_ESTIMATE

    def _tare(self, measurement: Measurement, output: TaskOutput) -> None:
        if output.phase is Phase.FREE_AIR:
            if self._phase is not Phase.FREE_AIR:
                self._air = RunningMean()
            self._air.add(measurement.force_n)
        self._phase = output.phase

    def _collect(self, measurement: Measurement, output: TaskOutput) -> None:
        """Keep the samples of the target under way, and have them looked at whenever a run has ended."""
        if self._run not in {NO_RUN, output.run}:
            last = self._run - self._first_run + 1 == self._runs
            self._talk.look(self._stream, self._records[: self._count].copy(), self._target, last=last)
        self._run = output.run
        if output.run == NO_RUN:
            return
        target = self._talk.queue.current
        if target != self._target:
            self._count, self._target, self._first_run = 0, target, output.run
        if self._count < _MOST_SAMPLES:
            self._records[self._count] = (
                measurement.time_s,
                output.run,
                output.phase,
                measurement.joint_position_rad,
                measurement.force_n,
                output.tip_position_world_m,
                output.press_direction_world,
                measurement.encoder_at_s,
                measurement.force_at_s,
                measurement.encoder_status,
                measurement.force_status,
            )
            self._count += 1
