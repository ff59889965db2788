"""The follower's task: hold still, probe all targets of the queue in order, and hold still again.

Each target has its own `ProbingTask`, which starts and ends where the arm holds. Messages change only the
queue. Speeds, forces and distances come from the plan, and the guard may stop the arm at any time.
"""

import threading
from collections.abc import Callable
from enum import StrEnum

import numpy as np

from palpate.control.arm.rigid_body import RigidBody
from palpate.control.laws.gains import Gains
from palpate.control.laws.hybrid import HybridController
from palpate.control.loop.task import NO_RUN, Phase, TaskEvent, TaskOutput, make_output
from palpate.control.paths.trajectory import JointMotion
from palpate.control.probing.task import ProbingTask
from palpate.robot_io.errors import InputError
from palpate.robot_io.link.messages import MOST_TARGETS, Intent, Target, TargetState, short_number
from palpate.robot_io.types import FloatArray, Measurement


class TargetQueue:
    """Thread-safe queue that the link fills and the task empties.

    Attributes:
        linked: whether the leader responds; no target is started while it does not.
        remark: reason why the newest target was refused or failed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._targets: dict[int, Target] = {}
        self._states: dict[int, TargetState] = {}
        self._newest = -1  # number of the newest accepted target; the leader counts up
        self._current: int | None = None
        self._cancelled = False  # whether the current target is canceled
        self._ended = False
        self.linked = False
        self.remark = ""

    def take(self, intent: Intent) -> None:
        """Update the queue from the leader's intent; targets beyond its capacity are left for later.

        Args:
            intent: targets, cancellations and whether the leader has ended.
        """
        with self._lock:
            for target in intent.targets:
                if target.number > self._newest:
                    if len(self._states) >= MOST_TARGETS:  # forget the oldest finished target
                        over = next((n for n, state in self._states.items() if state.is_over), None)
                        if over is None:
                            break
                        del self._states[over], self._targets[over]
                    self._newest = target.number
                    self._targets[target.number] = target
                    self._states[target.number] = TargetState.QUEUED
            for number in intent.cancelled:
                if self._states.get(number) is TargetState.QUEUED:
                    self._states[number] = TargetState.CANCELLED
                self._cancelled |= number == self._current
            self._ended = intent.ended

    def clear(self) -> None:
        """Drop the targets of the previous leader when another leader starts."""
        with self._lock:
            self._targets, self._states = {}, {}
            self._newest, self._ended = -1, False
            self._cancelled = self._current is not None

    def begin(self) -> Target | None:
        """Start and return the next target; None if none waits, one is probed, or the link is silent."""
        with self._lock:
            waiting = (n for n, state in self._states.items() if state is TargetState.QUEUED)
            number = next(waiting, None) if self.linked and self._current is None else None
            if number is None:
                return None
            self._current, self._cancelled = number, False
            self._states[number] = TargetState.PROBING
            return self._targets[number]

    def finish(self, state: TargetState, remark: str = "") -> None:
        """Set the state of the target that was being probed.

        Args:
            state: final state.
            remark: reason why it was refused or failed.
        """
        with self._lock:
            if self._current in self._states:
                self._states[self._current] = state
            self._current, self.remark = None, remark

    @property
    def cancelled(self) -> bool:
        """Whether the current target is canceled."""
        return self._cancelled

    @property
    def current(self) -> int:
        """Number of the current target, -1 for none; it may be a previous leader's."""
        return -1 if self._current is None else self._current

    @property
    def done(self) -> bool:
        """Whether the leader has ended, and no target is open."""
        with self._lock:
            return self._ended and all(state.is_over for state in self._states.values())

    def states(self) -> dict[int, TargetState]:
        """Copy the states of all remembered targets, by number."""
        with self._lock:
            return dict(self._states)


class SilenceAction(StrEnum):
    """Treatment of the current target when the leader falls silent; then the arm holds still."""

    FINISH = "finish"
    RETREAT = "retreat"


class FollowerTask:
    """Task that probes the targets of a `TargetQueue`; see `palpate.control.loop.task.Task`.

    It is done when the leader has ended.

    Args:
        body: model of the arm.
        sensor_axis_tip: direction in which the tool pushes, tip frame, shape (3,).
        gains: gains of all laws.
        queue: queue of targets.
        probing: makes the probing task of a target.
        settled: returns whether the arm need not wait for anything but the queue, such as an estimate.
        on_silence: treatment of the current target when the leader falls silent.
    """

    def __init__(  # noqa: PLR0917
        self,
        body: RigidBody,
        sensor_axis_tip: FloatArray,
        gains: Gains,
        queue: TargetQueue,
        probing: Callable[[Target], ProbingTask],
        settled: Callable[[], bool] = lambda: True,
        on_silence: SilenceAction = SilenceAction.FINISH,
    ) -> None:
        self._hold = HybridController(body, sensor_axis_tip, gains)
        self._queue, self._make_probing_task = queue, probing
        self._settled, self._on_silence = settled, on_silence
        self._probing_task: ProbingTask | None = None
        self._runs = self._base = 0  # runs so far; runs of the targets before the current one
        self._linked = False
        self._events: list[TaskEvent] = []

    def start(self, measurement: Measurement) -> None:
        """Hold the measured posture.

        Args:
            measurement: state of the arm.
        """
        still = np.zeros_like(measurement.joint_position_rad)
        self._posture = JointMotion(measurement.joint_position_rad.copy(), still, still)
        self._direction = np.array((0.0, 0.0, -1.0))
        self._hold.start(measurement)

    def step(self, measurement: Measurement, dt_s: float) -> TaskOutput:
        """Compute one tick; see `palpate.control.loop.task.Task.step`.

        Raises:
            Exception: any exception of a `ProbingTask`.
        """
        self._events = []
        if self._queue.linked != self._linked:
            self._linked = self._queue.linked
            text = (
                "the leader responds" if self._linked else "the leader is silent, so no new target is started"
            )
            self._events.append(TaskEvent("link_up" if self._linked else "link_silent", text))
        if self._probing_task is None:
            self._begin(measurement)
        task = self._probing_task
        if task is None:
            hold = self._hold.step_joints(measurement, self._posture, dt_s)
            return make_output(
                hold.command,
                hold.motion,
                hold.tip,
                self._direction,
                Phase.IDLE,
                done=self._queue.done and self._settled(),
                events=tuple(self._events),
            )
        if self._queue.cancelled:
            task.cancel("canceled by the operator")
        elif not self._linked and self._on_silence is SilenceAction.RETREAT:
            task.cancel("the leader is silent")
        output = task.step(measurement, dt_s)
        # Continue run numbers from target to target; the end of a target does not end the loop.
        if output.run != NO_RUN:
            output = output._replace(run=self._base + output.run)
            self._runs = output.run + 1
        events = []
        for event in output.events:
            data = event.data or {}
            if "run" in data:
                run = self._base + int(str(data["run"]))
                data = {**data, "run": run, "target": self._queue.current}
            events.append(TaskEvent(event.kind, event.text, data) if "run" in data else event)
        if output.done:
            number, failed = short_number(self._queue.current), "; ".join(task.failures)
            if task.cancelled:
                self._finish(TargetState.CANCELLED, f"target {number} left: {failed}")
            elif task.runs_done == 0:
                self._finish(TargetState.FAILED, f"target {number}: {failed}")
            else:
                self._finish(TargetState.DONE, failed)
            self._probing_task = None
            self._hold.start(measurement)
        return output._replace(done=False, events=(*events, *self._events))

    def _begin(self, measurement: Measurement) -> None:
        target = self._queue.begin()
        if target is None:
            return
        try:
            task = self._make_probing_task(target)
            task.start(measurement)
        except InputError as error:
            self._finish(TargetState.REFUSED, f"target {short_number(target.number)} refused: {error}")
            return
        self._probing_task, self._base = task, self._runs
        self._direction = np.array(target.direction_world)
        text = f"target {short_number(target.number)} begun"
        self._events.append(TaskEvent("target", text, {"target": target.number}))

    def _finish(self, state: TargetState, remark: str) -> None:
        number = self._queue.current
        self._queue.finish(state, remark)
        text = remark or f"target {short_number(number)} {state.name.lower()}"
        self._events.append(TaskEvent("target", text, {"target": number, "state": state.name}))
