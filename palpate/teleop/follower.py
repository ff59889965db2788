"""Follower: an arm that rests, probes the leader's targets, and reports its measurements.

The control loop runs in the main thread, as for `palpate probe`. A second thread exchanges messages with the
leader, and estimates are made in separate processes. Only the queue of targets leads into the loop.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import NamedTuple

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import gains_of
from palpate.control.laws.touch import RunningMean
from palpate.control.loop.result import LoopResult
from palpate.control.loop.task import NO_RUN, Phase, TaskOutput
from palpate.control.loop.tick_record import NO_ESTIMATE, Estimates
from palpate.control.probing.plan import ProbingPlan
from palpate.control.probing.sites import check_against_guard
from palpate.control.probing.task import ProbingTask
from palpate.control.teleop.follower_task import FollowerTask, SilenceAction, TargetQueue
from palpate.control.teleop.messaging import LINK_STREAM, Messaging
from palpate.robot_io.calibration.applied import load_calibrations
from palpate.robot_io.clock import Clock
from palpate.robot_io.errors import error_text
from palpate.robot_io.link import messages
from palpate.robot_io.link.connection import LinkConnection, LinkSettings
from palpate.robot_io.session import RecordArray, Samples, SessionWriter, Stream
from palpate.robot_io.types import Measurement
from palpate.runs.probing import PLAN
from palpate.runs.session import ArmJob, arm_session
from palpate.teleop.estimating import ObjectEstimator, sample_stream
from palpate.teleop.virtual_object import summarize_estimate

_MESSAGE_PERIOD_S = 0.02  # period of reports
_RESEND_S = 0.2  # period of sending an unconfirmed estimate [s]
_SETTLE_S = 25.0  # longest wait for estimates and verdicts when all targets are over
_SEEN_S = 3.0  # longest wait for the leader to confirm the newest estimate
_END_REPORTS = 25  # number of repeats of the last report
ESTIMATE = "estimate"  # kind of an estimate's event
Say = Callable[[str], None]


class ArmState(NamedTuple):
    """State of the arm at one time, for a report."""

    phase: Phase
    tip_world_m: tuple[float, float, float]
    speed_m_s: float
    direction_world: tuple[float, float, float]
    force_n: float


class FollowerMessaging(threading.Thread):
    """Thread that exchanges messages with the leader, independent of the control loop.

    Attributes:
        queue: queue of targets, filled by this thread.
        arm_state: state of the arm and measured force; the loop replaces it in every tick.
        notes: entries for the session, (kind, text, data), which the loop logs.
        samples: samples to estimate, (stream, records, target, whether its last run is over), from the loop.
        estimates: number of estimates made.
        link: exchange of messages, whose state the loop logs.
        error: reason why the exchange ended; empty while it continues.
    """

    def __init__(self, line: LinkConnection, clock: Clock, say: Say, *, diagnose: bool) -> None:
        super().__init__(daemon=True)
        self.queue = TargetQueue()
        self.arm_state = ArmState(Phase.IDLE, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, -1.0), 0.0)
        self.notes = deque[tuple[str, str, dict[str, object]]]()
        self.estimates, self.error = 0, ""
        self._clock, self._say, self._over = clock, say, threading.Event()
        self.samples = deque[tuple[Stream, RecordArray, int, bool]]()
        self._is_idle = True  # whether no estimate was pending at the thread's last check
        self._estimator = ObjectEstimator(diagnose=diagnose)
        self._newest: dict[int, messages.ObjectEstimate] = {}  # newest estimate by target
        self._seen: tuple[int, ...] = ()  # revisions that the leader has received
        self._resend_s, self._settling_since_s, self._newest_s = 0.0, math.nan, -math.inf

        def take(message: messages.Message, _sent_s: float) -> None:
            if isinstance(message, messages.Intent):
                self.queue.take(message)
                self._seen = message.seen

        def drop_targets() -> None:
            self._seen = ()
            self.queue.clear()
            say("another leader has started, so the targets of the previous leader are dropped")

        self.link = Messaging(line, clock, take=take, on_new_peer=drop_targets)

    def settled(self) -> bool:
        """Return whether no estimate is pending, and a reachable leader has received all estimates.

        Pending estimates are awaited for `_SETTLE_S` from the first call, the last one for `_SEEN_S`.
        """
        now_s = self._clock.now_s()
        if math.isnan(self._settling_since_s):
            self._settling_since_s = now_s
        waiting = bool(self.samples) or not self._is_idle
        unseen = self.queue.linked and bool(self._unseen()) and now_s < self._newest_s + _SEEN_S
        return bool(self.error) or not ((waiting and now_s < self._settling_since_s + _SETTLE_S) or unseen)

    def run(self) -> None:
        """See `threading.Thread.run`."""
        try:
            while not self._over.wait(_MESSAGE_PERIOD_S):
                self._exchange()
        except Exception as error:  # a follower that cannot send continues as if the leader were silent
            self.error = error_text(error)
            self._say(f"the link failed, so no further target is probed: {self.error}")
        finally:
            self.queue.linked = False

    def report_end(self, cause: str) -> None:
        """Report that the arm has ended, and the reason if it was stopped.

        Args:
            cause: reason of the stop; empty if the arm was not stopped.
        """
        self.close()
        with suppress(Exception):  # errors no longer matter
            for _ in range(_END_REPORTS):
                self.link.send(replace(self._report(), remark=cause[: messages.MOST_TEXT], ended=True))
                time.sleep(_MESSAGE_PERIOD_S)

    def close(self) -> None:
        """Stop the exchange; can be called twice."""
        self._over.set()
        if self.is_alive():
            self.join()
        self._estimator.close()

    def _exchange(self) -> None:
        """Receive the leader's messages, estimate, and report the estimates that the leader lacks."""
        changed, self.queue.linked = self.link.receive(), self.link.linked
        if changed and self.queue.linked:
            self._say("the leader responds")
        elif changed:
            self._say("the leader is silent, so no further target is probed")
        if problem := self.link.problem():
            self.notes.append(("link", problem, {}))
            self._say(problem)
        self._exchange_estimates()
        self.link.send(self._report())
        now_s = self._clock.now_s()
        if now_s >= self._resend_s:  # a lost estimate is sent until the leader confirms it
            self._resend_s = now_s + _RESEND_S
            for estimate in self._unseen():
                self.link.send(estimate)
        self._is_idle = not self._estimator.busy  # set last, after all new estimates are stored

    def _exchange_estimates(self) -> None:
        """Give samples to the estimator, and collect its answers."""
        while self.samples:
            self._is_idle = False
            stream, records, target, last = self.samples[0]
            columns = {column.name: records[column.name].copy() for column in stream.columns}
            self._estimator.request(Samples(stream, columns), target, last=last)
            self.samples.popleft()
        for answer in self._estimator.answers():
            if isinstance(answer, str):
                self.notes.append(("no_estimate", answer, {}))
                self._say(answer)
                continue
            kept = self._newest.pop(answer.target, None)
            if kept is not None and _rank(kept) > _rank(answer):  # a worse one arrives late
                self._newest[answer.target] = kept
                continue
            self._newest[answer.target] = replace(answer, revision=self.estimates)
            self.estimates += 1
            self._newest_s = self._clock.now_s()
            text = f"target {messages.short_number(answer.target)}: {summarize_estimate(answer)}"
            self.notes.append((ESTIMATE, text, {"target": answer.target, "verdict": answer.verdict}))
            self._say(text)
            if len(self._newest) > messages.MOST_TARGETS:
                del self._newest[next(iter(self._newest))]

    def _unseen(self) -> list[messages.ObjectEstimate]:
        return [made for made in list(self._newest.values()) if made.revision not in self._seen]

    def _report(self) -> messages.Report:
        arm, states = self.arm_state, self.queue.states()
        return messages.Report(
            phase=int(arm.phase),
            target=self.queue.current,
            tip_world_m=arm.tip_world_m,
            speed_m_s=arm.speed_m_s,
            direction_world=arm.direction_world,
            force_n=arm.force_n,
            targets=tuple(states),
            states=tuple(int(state) for state in states.values()),
            remark=self.queue.remark[: messages.MOST_TEXT],
            ended=False,
        )


def _rank(estimate: messages.ObjectEstimate) -> tuple[int, bool]:
    """Rank an estimate by its number of runs, then by whether it was diagnosed."""
    return estimate.runs, bool(estimate.verdict)


_LINK_RECORD_S = 0.1
_MOST_SAMPLES = 200_000  # largest number of samples stored for a target's estimate


class Observer:
    """Observer of one run; `runs` is the number of presses per target."""

    def __init__(self, messaging: FollowerMessaging, log: SessionWriter, joint_count: int, runs: int) -> None:
        self._messaging, self._log, self._runs = messaging, log, runs
        self._stream = sample_stream(joint_count)
        self._records = np.zeros(_MOST_SAMPLES, self._stream.dtype)
        self._count, self._target, self._run, self._first_run = 0, -1, NO_RUN, 0
        self._air, self._phase = RunningMean(), Phase.IDLE
        self._record_s = 0.0

    def observe(self, measurement: Measurement, output: TaskOutput) -> Estimates:
        """See `palpate.control.loop.tick_record.Observer`."""
        if output.phase is Phase.FREE_AIR:
            if self._phase is not Phase.FREE_AIR:
                self._air = RunningMean()
            self._air.add(measurement.force_n)
        self._phase = output.phase
        self._collect(measurement, output)
        speed_m_s = float(output.tip_velocity_world_m_s.dot(output.press_direction_world))
        tip, direction = output.tip_position_world_m.tolist(), output.press_direction_world.tolist()
        force_n = measurement.force_n - self._air.mean
        self._messaging.arm_state = ArmState(output.phase, tuple(tip), speed_m_s, tuple(direction), force_n)
        if measurement.time_s >= self._record_s:
            self._record_s = measurement.time_s + _LINK_RECORD_S
            self._log.append(LINK_STREAM.name, self._messaging.link.record(measurement.time_s))
        while self._messaging.notes:
            self._log.event(measurement.time_s, *self._messaging.notes.popleft())
        return NO_ESTIMATE

    def _collect(self, measurement: Measurement, output: TaskOutput) -> None:
        """Collect the current target's samples, and request an estimate after each run."""
        if self._run not in {NO_RUN, output.run}:
            last = self._run - self._first_run + 1 == self._runs
            records = self._records[: self._count].copy()
            self._messaging.samples.append((self._stream, records, self._target, last))
        self._run = output.run
        if output.run == NO_RUN:
            return
        target = self._messaging.queue.current
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


@dataclass(frozen=True)
class FollowerJob(ArmJob):
    """Settings of a follower: arm, probing plan and link."""

    plan: ProbingPlan  # how each target is probed; the plan has no targets of its own
    _: KW_ONLY
    link: LinkSettings = field(default_factory=LinkSettings)
    on_silence: SilenceAction = SilenceAction.FINISH
    diagnose: bool = True


@dataclass(frozen=True)
class FollowerOutcome:
    """Result of a follower's run."""

    loop: LoopResult
    states: dict[int, messages.TargetState]  # final state of each target, by number
    estimates: int  # number of estimates
    messaging_error: str  # why the link failed; empty if it did not


def run_follower(job: FollowerJob, say: Say) -> FollowerOutcome:
    """Follow until the leader ends, the user stops it, or the guard trips; the session is then complete.

    Args:
        job: the job.
        say: called with each event, as one line.

    Raises:
        InputError: robot file, plan, link and scenario do not fit each other; nothing has moved.
    """
    robot_file = job.robot_file
    check_against_guard(job.plan, robot_file)
    calibrations = load_calibrations(robot_file, emulated=job.wired)
    body = RigidBody.of_robot(robot_file, calibrations)

    def probing(target: messages.Target) -> ProbingTask:
        place = {"targets_world_m": (target.position_world_m,)}
        plan = job.plan.model_copy(update=place | {"press_direction_world": target.direction_world})
        return ProbingTask.from_robot_file(robot_file, plan, calibrations, body)

    with ExitStack() as stack:
        extra = {PLAN: job.plan.to_yaml()}
        arm = stack.enter_context(arm_session(job, calibrations, extra, streams=(LINK_STREAM,)))
        line = stack.enter_context(LinkConnection("follower", job.link, arm.clock))
        messaging = FollowerMessaging(line, arm.clock, say, diagnose=job.diagnose)
        stack.callback(messaging.close)
        axis = np.array(robot_file.sensor_axis_tip)
        task = FollowerTask(
            body, axis, gains_of(robot_file), messaging.queue, probing, messaging.settled, job.on_silence
        )
        observer = Observer(messaging, arm.log, robot_file.joint_count, len(job.plan.runs()))
        messaging.start()
        if line.is_open_here:
            say("without --key, any program on this machine can command the arm; other machines cannot")
        say("waiting for a leader; Ctrl-C brings the arm to rest")
        result = arm.run(task, observer.observe)
        messaging.report_end(result.cause)
    states = {messages.short_number(number): state for number, state in messaging.queue.states().items()}
    return FollowerOutcome(result, states, messaging.estimates, messaging.error)
