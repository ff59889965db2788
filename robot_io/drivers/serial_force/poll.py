"""Asks a sensor that speaks only when it is asked, one question at a time."""

_MARGIN_S = 1e-3  # by which answering times vary; a marker that was not needed does no harm
_FORGETTING = 0.01  # how far the usual answering time follows a shorter one
_PATIENCE_S = 0.1  # for an answer, and for that to a marker
_DEAF_S = 0.25  # after one that did not come: until nothing late can be taken for the next one


class Poll:
    """One question, asked again once it is answered; an answer is as old as its question can make it.

    Where an answer is missing, the question is asked again behind a marker: a question whose answer is no
    reading. Sensors answer in the order of the questions, so what comes after the marker's answer belongs to
    the question behind it. Where nothing answers, nothing is asked or believed for a while, so that no late
    answer belongs to a younger question.

    Args:
        question: What asks for a reading.
        marker: What asks for something else.
    """

    def __init__(self, question: bytes, marker: bytes) -> None:
        self._question, self._marker = question, marker
        self._asked_s: float | None = None  # while the answer is out
        self._silent_since_s = 0.0  # when the first question was asked that has no answer
        self._usual_s: float | None = None  # answering time, the longest of late
        self._awaits_marker = False
        self._deaf_until_s = -float("inf")

    def to_send(self, now_s: float) -> bytes:
        """What to send now [s], which may be nothing."""
        if now_s < self._deaf_until_s:
            return b""
        if self._asked_s is None:
            self._asked_s = self._silent_since_s = now_s
            return self._question
        if now_s - self._silent_since_s > _PATIENCE_S:
            self._asked_s, self._awaits_marker, self._deaf_until_s = None, False, now_s + _DEAF_S
            return b""
        if self._awaits_marker or self._usual_s is None or now_s - self._asked_s <= self._usual_s + _MARGIN_S:
            return b""
        self._asked_s, self._awaits_marker = now_s, True
        return self._marker + self._question

    def marked(self) -> None:
        """Note that the answer to the marker has come."""
        self._awaits_marker = False

    def answered(self, arrived_s: float) -> float | None:
        """When what arrived at `arrived_s` [s] was asked for [s]; None if it was not, or nobody knows."""
        if self._awaits_marker:
            return None
        asked_s, self._asked_s = self._asked_s, None
        if asked_s is not None:
            delay_s = arrived_s - asked_s
            usual_s = delay_s if self._usual_s is None else self._usual_s
            self._usual_s = max(delay_s, usual_s + _FORGETTING * (delay_s - usual_s))
        return asked_s
