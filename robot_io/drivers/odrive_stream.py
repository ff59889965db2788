"""Checks of one ODrive axis: the delay of its answers, and estimates of a second axis with its node id."""

from collections import deque
from math import inf

# A delay counts if so many consecutive answers are all later than usual by more than this: a jitter of the
# link that delays some answers does not delay all of many [s].
_LATER_S = {2: 3e-3, 24: 1e-3}
ASK_PERIOD_S = 13e-3  # between requests to one axis; no multiple of a usual batching period [s]
_LOST_SHARE = 4  # multiple of the age limit after which an answer is lost
_REPEATED = 3  # consecutive requests with two different answers that show two axes

_MOST_RATE_HZ = 1400.0  # of one axis, whose shortest period is 1 ms, with a margin
_SPARE_COUNT = 30.0  # estimates by which a stream may exceed this rate at once
_PAUSE_S = 0.03  # without a poll, after which estimates have piled up [s]
_RECOVERY_S = 0.1  # by when they have been read [s]
_SPARE_SPEED = 1.5  # multiple of the reported speed that still explains a change of position
_SPARE_S = 5e-3  # delay that may have changed since the last estimate [s]
_SPARE_REV = 0.03  # change of position that needs no explanation, such as noise [turns]
_JUMPS = 3  # jumps that show two axes, each within `_RECOVERY_S` of the last


class AnswerDelay:
    """Delay of the answers of one axis, by requests of which at most one is open.

    Cyclic frames carry neither time nor number, so a link whose delay grows would pass old samples as new.
    An answer takes the same way as they do. A delay beyond the jitter of a healthy link counts in full: of
    more than 3 ms after two requests (26 ms), of more than 1 ms after 24 (0.3 s). Samples may thus be older
    than stated by 1 ms, for 0.3 s by 3 ms, and for 30 ms by any step that is no gap. A heartbeat shows
    no less: its period has the same jitter, is longer, and drifts with the axis's clock.

    Attributes:
        latency_s: delay of newly arrived samples [s].
        repeated: consecutive requests that were answered twice, differently.
    """

    def __init__(self, usual_s: float, start_s: float, age_limit_s: float) -> None:
        self.latency_s = self.usual_s = usual_s
        self._next_s, self._lost_s = start_s, _LOST_SHARE * age_limit_s + usual_s
        self._asked_s, self._is_open = -inf, False
        self._answer, self._was_repeated, self.repeated = b"", False, 0
        self._recent_s: deque[float] = deque(maxlen=max(_LATER_S))

    def is_due(self, now_s: float) -> bool:
        """Return whether to send a request now.

        Args:
            now_s: robot's clock [s].
        """
        return now_s >= self._next_s and not (self._is_open and now_s - self._asked_s < self._lost_s)

    def ask(self, now_s: float) -> None:
        """Note a request that is sent now.

        Args:
            now_s: robot's clock [s].
        """
        self.repeated = self.repeated if self._was_repeated else 0
        self._asked_s, self._is_open, self._was_repeated = now_s, True, False
        self._next_s = now_s + ASK_PERIOD_S

    def answer(self, data: bytes, arrived_s: float) -> None:
        """Measure the delay of an answer.

        Args:
            data: content of the answer; a frame that repeats it is no second answer.
            arrived_s: when it arrived, robot's clock [s].
        """
        if self._is_open:
            self._is_open, self._answer = False, data
            self._recent_s.append(max(arrived_s - self._asked_s, 0.0))
            self.latency_s = self.usual_s
            for count, later_s in _LATER_S.items():
                delay_s = min(list(self._recent_s)[-count:])
                if len(self._recent_s) >= count and delay_s > self.usual_s + later_s:
                    self.latency_s = max(self.latency_s, delay_s)
        elif data != self._answer and not self._was_repeated:
            self._was_repeated = True
            self.repeated += 1

    @property
    def problem(self) -> str:
        """Two axes, or an empty string."""
        return "answers requests twice" if self.repeated >= _REPEATED else ""


class EstimateStream:
    """Encoder estimates under one node id, in turns of the motor.

    Two axes with one id send at twice the rate, and positions that no motion connects. Such a position is
    withheld; the third one within a short time shows that there are two axes, or that the encoder jumps.

    Attributes:
        problem: evidence of two axes; empty if there is none. It remains until the next configuration.
    """

    def __init__(self, start_s: float) -> None:
        self.problem = ""
        self._position_rev = self._velocity_rev_s = 0.0
        self._accepted_s, self._jumped_s, self._jumps = -inf, -inf, 0
        self._count, self._spare = 0, _SPARE_COUNT
        self._counted_s, self._unsure_until_s = start_s, start_s

    def accept(self, position_rev: float, velocity_rev_s: float, now_s: float) -> bool:
        """Return whether an estimate continues the motion.

        Args:
            position_rev: position [turns].
            velocity_rev_s: velocity [turns/s].
            now_s: when it is read, robot's clock [s].
        """
        change_rev, age_s = abs(position_rev - self._position_rev), now_s - self._accepted_s
        if change_rev or velocity_rev_s != self._velocity_rev_s:  # a frame sent twice counts once
            self._count += 1
        if age_s < _RECOVERY_S:
            speed_rev_s = max(abs(velocity_rev_s), abs(self._velocity_rev_s))
            if change_rev > _SPARE_SPEED * speed_rev_s * (age_s + _SPARE_S) + _SPARE_REV:
                self._jumps = self._jumps + 1 if now_s - self._jumped_s < _RECOVERY_S else 1
                self._jumped_s = now_s
                if self._jumps >= _JUMPS:
                    self.problem = (
                        f"the position jumps by {change_rev:.2f} turns; if only one axis has this id, the "
                        "encoder of this axis fails"
                    )
                return False
        self._position_rev, self._velocity_rev_s, self._accepted_s = position_rev, velocity_rev_s, now_s
        return not self.problem

    def check_rate(self, now_s: float) -> None:
        """Compare the number of estimates since the last check with the highest rate of one axis.

        Args:
            now_s: robot's clock [s].
        """
        elapsed_s, self._counted_s = now_s - self._counted_s, now_s
        if elapsed_s > _PAUSE_S:
            self._unsure_until_s = now_s + _RECOVERY_S
        if now_s < self._unsure_until_s:
            self._spare = _SPARE_COUNT
        else:
            self._spare = min(self._spare + _MOST_RATE_HZ * elapsed_s - self._count, _SPARE_COUNT)
            if self._spare < 0.0:
                self.problem = f"more than {_MOST_RATE_HZ:.0f} estimates per second arrive"
        self._count = 0
