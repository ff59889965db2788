"""The follower's targets: what is to be probed, what is being probed, and what became of the rest.

The leader's intent is taken in as a whole each time it arrives, so an intent that was lost or came twice
changes nothing. A target's number is its identity; what was probed once is not probed again.
"""

import threading

from robot_io.link import Intent, Target, TargetState
from robot_io.link.messages import MOST_TARGETS

_OVER = (TargetState.DONE, TargetState.REFUSED, TargetState.CANCELLED, TargetState.FAILED)


class TargetQueue:
    """Filled by whoever listens to the leader, emptied by the task; may be used from two threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._targets: dict[int, Target] = {}
        self._states: dict[int, TargetState] = {}
        self._newest = -1  # number of the newest target that was taken in; the leader counts up
        self._current: int | None = None
        self._unwanted = False  # what is being probed is cancelled
        self._ended = False
        self.linked = False  # whether the leader is heard; nothing new is begun while it is not
        self.remark = ""  # why the newest target was refused or failed

    def take(self, intent: Intent) -> None:
        """Take in what the leader wants now; more targets than the queue holds are left for later."""
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
                self._unwanted |= number == self._current
            self._ended = intent.ended

    def forget(self) -> None:
        """Another leader begins: nothing of the last one's is wanted any more."""
        with self._lock:
            self._targets, self._states = {}, {}
            self._newest, self._ended = -1, False
            self._unwanted = self._current is not None

    def begin(self) -> Target | None:
        """The next target, which is being probed from now on; None if there is none or the link is silent."""
        with self._lock:
            waiting = (n for n, state in self._states.items() if state is TargetState.QUEUED)
            number = next(waiting, None) if self.linked and self._current is None else None
            if number is None:
                return None
            self._current, self._unwanted = number, False
            self._states[number] = TargetState.PROBING
            return self._targets[number]

    def finish(self, state: TargetState, remark: str = "") -> None:
        """Say what became of the target that was being probed."""
        with self._lock:
            if self._current in self._states:
                self._states[self._current] = state
            self._current, self.remark = None, remark

    @property
    def unwanted(self) -> bool:
        """Whether the target that is being probed is cancelled."""
        return self._unwanted

    @property
    def current(self) -> int:
        """Number of the target that is being probed, -1 for none; it may be another leader's."""
        return -1 if self._current is None else self._current

    @property
    def done(self) -> bool:
        """Whether the leader has ended, and nothing is left to do."""
        with self._lock:
            open_ones = set(self._states.values()) - set(_OVER)
            return self._ended and not open_ones

    def states(self) -> dict[int, TargetState]:
        """What became of each target that is remembered, by number."""
        with self._lock:
            return dict(self._states)

    def _make_room(self) -> bool:
        """Forget the oldest that is over where all places are taken; false if none is."""
        if len(self._states) < MOST_TARGETS:
            return True
        over = next((n for n, state in self._states.items() if state in _OVER), None)
        if over is None:
            return False
        del self._states[over], self._targets[over]
        return True
