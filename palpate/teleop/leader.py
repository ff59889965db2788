"""Leader: sends the operator's targets to the follower, and the follower's estimates to the haptic loop.

This process handles messages and display; a separate process renders (`palpate.teleop.haptics`), so that
neither a slow network nor a slow terminal affects the felt force.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import dist, nan
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from palpate.common.worker_process import start_worker
from palpate.control.loop.timing import SectionTiming
from palpate.control.teleop.messaging import Messaging
from palpate.robot_io.clock import Clock, MonotonicClock
from palpate.robot_io.errors import InputError, PalpateError
from palpate.robot_io.link import messages
from palpate.robot_io.link.connection import LinkConnection, LinkSettings
from palpate.sim_backend.scenario import Scenario
from palpate.teleop.haptics import HapticCommands, HapticJob, HapticReport, run_haptics
from palpate.teleop.virtual_object import DOWN, TargetStates, summarize_estimate

MESSAGE_PERIOD_S = 0.02  # period of intents
_LINK_RECORD_S, _SHOW_S = 0.1, 0.5
_FINISH_S = 45.0  # time limit for a follower to finish the queued targets
_SAME_PLACE_M = 0.005  # places closer than this are the same target
_START_S = 60.0  # time limit for the haptic process's first message
Say = Callable[[str], None]


@dataclass(frozen=True)
class LeaderOutcome:
    """Result of a leader's run."""

    states: dict[int, str]  # last reported state of each target
    estimates: int  # number of received estimates
    heard: bool  # whether the follower answered
    lateness: SectionTiming | None  # lateness of the haptic loop
    unfinished: tuple[int, ...] = ()  # targets that the follower left, unless the user ended the leader


def run_leader(haptics: HapticJob, link: LinkSettings, say: Say, show: Say) -> LeaderOutcome:
    """Lead until the operator's script ends or Ctrl-C; the session is then complete.

    Args:
        haptics: initial virtual object, device and session.
        link: connection to the follower.
        say: called with each event, as one line.
        show: called with the status line, which replaces the previous one.

    Raises:
        InputError: the link cannot be opened.
        PalpateError: the haptic process has ended; states the reason.
    """
    clock = MonotonicClock()
    with LinkConnection("leader", link, clock) as line:
        process, pipe = start_worker(run_haptics, haptics)
        try:
            leader = _Leader(haptics.scene, line, clock, process, pipe, say, show)
            try:
                leader.run()
            except KeyboardInterrupt:
                say(leader.end())
                leader.run()
                return replace(leader.outcome(), unfinished=())
            return leader.outcome()
        finally:
            pipe.close()  # ends the haptic process
            process.join(_START_S)


class _Leader:
    """State and loop of one run of a leader."""

    def __init__(  # noqa: PLR0917 (what a leader is made of)
        self,
        scene: Scenario,
        line: LinkConnection,
        clock: Clock,
        process: BaseProcess,
        pipe: Connection,
        say: Say,
        show: Say,
    ) -> None:
        self._clock, self._process, self._pipe = clock, process, pipe
        self._say, self._show = say, show
        self._target_states = TargetStates(scene)

        def drop_follower() -> None:
            self._target_states.on_new_peer()
            self._note("link", "another follower has started")

        self._messaging = Messaging(line, clock, take=self._handle_message, on_new_peer=drop_follower)
        self._sender = line.sender
        self._targets: dict[int, messages.Target] = {}
        self._cancelled: list[int] = []
        self._states: dict[int, messages.TargetState] = {}
        self._remark = ""
        self._read = 0
        self._notes: list[tuple[str, str]] = []
        self._report: HapticReport | None = None
        self._ending_s = self._link_s = self._show_s = nan
        self._over = False
        self._lateness: SectionTiming | None = None

    def run(self) -> None:
        """Exchange messages until the end."""
        begun_s = self._clock.now_s()
        while not self._over:
            now_s = self._clock.now_s()
            self._receive_reports()
            if self._report is None and now_s - begun_s > _START_S:
                raise PalpateError(f"the haptic process did not respond within {_START_S:g} s")
            self._exchange()
            # Render the estimate of the nearest probed place.
            chosen = self._target_states.choose(self._report.tip_world_m) if self._report else None
            if chosen is not None:
                self._send(HapticCommands(self._read, render=chosen))
            # Send entries to the process that writes the session.
            if self._report is not None and (self._notes or not now_s < self._link_s + _LINK_RECORD_S):
                self._link_s, notes = now_s, tuple(self._notes)
                self._send(HapticCommands(self._read, notes=notes, link=self._messaging.record(now_s)))
                self._notes.clear()
            if not now_s < self._show_s + _SHOW_S:
                self._show_s, status, rendered = now_s, "starting", self._target_states.rendered
                if self._report is not None:  # reliability of the virtual object
                    age_s = (
                        nan if rendered is None else self._messaging.peer.since_s(rendered.measured_s, now_s)
                    )
                    trust = self._target_states.summary(self._report.tip_world_m, age_s)
                    link = "linked" if self._messaging.linked else "NO LINK"
                    status = f"{self._report.force_n:5.2f} N felt; {trust}; {link}"
                self._show(status)
            if now_s > self._ending_s + _FINISH_S or (self._ending and not self._messaging.linked):
                self._over = True
            self._clock.sleep_until(now_s + MESSAGE_PERIOD_S)
        # Request the end of the session, and receive the loop's timing.
        if self._lateness is None:
            self._send(HapticCommands(self._read, notes=tuple(self._notes), end=True))
        while self._lateness is None:
            self._receive_reports()
            self._clock.sleep_until(self._clock.now_s() + MESSAGE_PERIOD_S)

    def end(self) -> str:
        """Accept no further targets; describe the remaining steps for the queued ones."""
        if not self._ending:
            self._ending_s = self._clock.now_s()
        if not self._messaging.linked:
            return "ending: no follower is connected to finish the queued targets"
        return "ending: the follower finishes the queued targets; Ctrl-C again ends without waiting"

    @property
    def _ending(self) -> bool:
        return self._ending_s == self._ending_s  # false for NaN

    def outcome(self) -> LeaderOutcome:
        """Return the result of the run."""
        states = {messages.short_number(number): state.name.lower() for number, state in self._states.items()}
        heard = self._messaging.peer.offset is not None
        left = tuple(messages.short_number(target.number) for target in self._queued())
        return LeaderOutcome(states, self._target_states.received, heard, self._lateness, left)

    def _receive_reports(self) -> None:
        try:
            while self._pipe.poll():
                report: HapticReport = self._pipe.recv()
                if report.lateness is not None:  # the last report
                    self._lateness = report.lateness
                    if not report.opened:
                        raise InputError(f"the operator's device cannot be opened: {report.failure}")
                    if report.failure:
                        raise PalpateError(f"the haptic loop has ended: {report.failure}")
                    self._over = True
                    continue
                self._report, self._read = report, self._read + 1
                for place in report.selected:
                    self._select(place)
                for text in report.refused:
                    self._note("refused", f"not rendered: {text}")
                if report.finished and not self._ending:
                    self.end()
        except (EOFError, OSError) as error:
            raise self._lost() from error

    def _select(self, place: tuple[float, ...]) -> None:
        """Add a target or, if a target at this place is waiting or being probed, cancel that target."""
        waiting = [
            target for target in self._queued() if dist(target.position_world_m, place) < _SAME_PLACE_M
        ]
        for target in waiting:
            self._cancelled.append(target.number)
            self._note("target", f"target {messages.short_number(target.number)} canceled")
        if not waiting:
            number = messages.target_number(self._sender, len(self._targets))
            self._targets[number] = messages.Target(number, place, DOWN)
            place_mm = ", ".join(f"{1e3 * value:.0f}" for value in place)
            self._note("target", f"target {messages.short_number(number)} chosen at ({place_mm}) mm")

    def _exchange(self) -> None:
        """Exchange messages with the follower: reports in, targets out."""
        if self._messaging.receive():
            is_heard = self._messaging.linked
            self._note("link", "the follower responds" if is_heard else "the follower is silent")
        if self._report is not None and (problem := self._messaging.problem()):  # both sides have started
            self._note("link", problem)
        queued, cancelled = self._queued()[: messages.MOST_TARGETS], self._cancelled[-messages.MOST_TARGETS :]
        self._messaging.send(
            messages.Intent(tuple(queued), tuple(cancelled), self._target_states.seen, self._ending)
        )

    def _handle_message(self, message: messages.Message, sent_s: float) -> None:
        if isinstance(message, messages.ObjectEstimate):
            try:
                is_new = self._target_states.take(message)
            except InputError as error:
                self._note("refused", f"estimate {message.revision} cannot be rendered: {error}")
                return
            if is_new:
                why = f" ({message.words})" if message.words else ""
                target = messages.short_number(message.target)
                self._note("estimate", f"target {target}: {summarize_estimate(message)}{why}")
        elif isinstance(message, messages.Report):
            # A follower may report targets of the previous leader until it receives this leader's messages.
            states = zip(message.targets, map(messages.TargetState, message.states), strict=True)
            self._states.update((number, state) for number, state in states if number in self._targets)
            if message.remark and message.remark != self._remark:
                self._note("follower", message.remark)
            self._remark = message.remark
            for text in self._target_states.compare(message, sent_s):
                self._note("disagreement", text)
            if message.ended and not self._over:
                self._note("follower", "the follower has ended")
                self.end()
                self._over = True

    def _queued(self) -> list[messages.Target]:
        """Return targets that are neither finished by the follower nor canceled."""
        over = {number for number, state in self._states.items() if state.is_over}.union(self._cancelled)
        return [target for target in self._targets.values() if target.number not in over]

    def _send(self, commands: HapticCommands) -> None:
        try:
            self._pipe.send(commands)
        except OSError as error:
            raise self._lost() from error

    def _lost(self) -> PalpateError:
        return PalpateError(f"the haptic process has ended (exit code {self._process.exitcode})")

    def _note(self, kind: str, text: str) -> None:
        self._notes.append((kind, text))
        self._say(text)
