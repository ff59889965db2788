"""The follower's targets and their states.

The leader's whole intent is taken in each time it arrives, so a lost or repeated intent changes nothing. A
target's number is its identity; a target that was probed is not probed again.
"""

import threading

from palpate.robot_io.link import Intent, Target, TargetState
from palpate.robot_io.link.messages import MOST_TARGETS

_OVER = (TargetState.DONE, TargetState.REFUSED, TargetState.CANCELLED, TargetState.FAILED)


class TargetQueue:
    """Queue that the link fills and the task empties; safe for two threads.

    Attributes:
        linked: whether the leader is heard; no target is begun while it is not.
        remark: why the newest target was refused or failed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._targets: dict[int, Target] = {}
        self._states: dict[int, TargetState] = {}
        self._newest = -1  # number of the newest target that was taken in; the leader counts up
        self._current: int | None = None
        self._cancelled = False  # of the target that is being probed
        self._ended = False
        self.linked = False
        self.remark = ""

    def take(self, intent: Intent) -> None:
        """Take in the leader's intent; targets beyond the queue's capacity are left for later.

        Args:
            intent: targets, cancellations and whether the leader has ended.
        """
        with self._lock:
            for target in intent.targets:
                if target.number > self._newest:
                    if not self._make_room():
                        break
                    self._newest = target.number
                    self._targets[target.number] = target
                    self._states[target.number] = TargetState.QUEUED
            for number in intent.cancelled:
                if self._states.get(number) is TargetState.QUEUED:
                    self._states[number] = TargetState.CANCELLED
                self._cancelled |= number == self._current
            self._ended = intent.ended

    def clear(self) -> None:
        """Drop the targets of the former leader because another leader begins."""
        with self._lock:
            self._targets, self._states = {}, {}
            self._newest, self._ended = -1, False
            self._cancelled = self._current is not None

    def begin(self) -> Target | None:
        """Begin the next target.

        Returns:
            The target; None if there is none or the link is silent.
        """
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
            state: how it ended.
            remark: why it was refused or failed.
        """
        with self._lock:
            if self._current in self._states:
                self._states[self._current] = state
            self._current, self.remark = None, remark

    @property
    def cancelled(self) -> bool:
        """Whether the target that is being probed is cancelled."""
        return self._cancelled

    @property
    def current(self) -> int:
        """Number of the target that is being probed, -1 for none; it may be a former leader's."""
        return -1 if self._current is None else self._current

    @property
    def done(self) -> bool:
        """Whether the leader has ended, and no target is open."""
        with self._lock:
            return self._ended and set(self._states.values()) <= set(_OVER)

    def states(self) -> dict[int, TargetState]:
        """Copy the states of all remembered targets, by number."""
        with self._lock:
            return dict(self._states)

    def _make_room(self) -> bool:
        """Forget the oldest target that is over if the queue is full; false if there is none."""
        if len(self._states) < MOST_TARGETS:
            return True
        over = next((n for n, state in self._states.items() if state in _OVER), None)
        if over is None:
            return False
        del self._states[over], self._targets[over]
        return True
