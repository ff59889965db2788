"""Asks a sensor that speaks only when it is asked, one question at a time."""

_PATIENCE_S = 0.1  # for an answer
_DEAF_S = 0.25  # after one that did not come: until nothing late can be taken for the next one


class Poll:
    """One question, asked again once it is answered.

    An answer is as old as its question can make it. One that is missing is waited for; then nothing is asked
    or believed for a while, so that no late answer belongs to a younger question.
    """

    def __init__(self, question: bytes) -> None:
        self._question = question
        self._asked_s: float | None = None  # while the answer is out
        self._deaf_until_s = -float("inf")

    def to_send(self, now_s: float) -> bytes:
        """What to send now, which may be nothing."""
        if self._asked_s is not None and now_s - self._asked_s > _PATIENCE_S:
            self._asked_s, self._deaf_until_s = None, now_s + _DEAF_S
        if self._asked_s is not None or now_s < self._deaf_until_s:
            return b""
        self._asked_s = now_s
        return self._question

    def answered(self) -> float | None:
        """When what has come now was asked for [s]; None if it was not."""
        asked_s, self._asked_s = self._asked_s, None
        return asked_s
