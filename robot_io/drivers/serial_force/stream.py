"""Readings from a byte stream: the sensor's own time, requests, lines and units."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from math import inf

from palpate.robot_io.errors import ProtocolError

_CLOCKS_DIFFER = 1e-3  # relative: two crystals, and a rate rounded to whole hertz
_WINDOW_S, _WINDOWS = 0.25, 4  # windows whose shortest delays reveal an error of the rate
_STEADY = 0.5  # share of the largest change between two windows by which changes may differ


class SensorClock:
    """Computes sampling times of readings from the shortest delay so far between sampling and arrival.

    A constant delay cannot be detected, but a change of the delay can. A sensor whose clock error exceeds
    0.1 % seems to fall behind. If the rate may be off by more, it is corrected once the shortest delays
    have changed steadily for a second; a single late reading changes them once.

    Args:
        rate_error: Largest relative error of the sensor's clock.
        longest_gap_s: Longest silence after which the advance of the sensor's time is still known [s].
    """

    def __init__(self, rate_error: float = 0.0, longest_gap_s: float = inf) -> None:
        self._rate_error, self._longest_gap_s = rate_error, longest_gap_s
        self._rate = 1.0  # seconds of the host in one of the sensor's
        self.restart()

    def restart(self) -> None:
        """Reset after a restart of the sensor, whose time then has no relation to earlier readings."""
        self._now_s = self._looked_s = 0.0  # on the sensor's clock
        self._arrived_s = inf
        # The shortest delay, which includes the offset between the clocks.
        self._delay_s = self._window_delay_s = inf
        self._window_end_s, self._delays_s = _WINDOW_S, deque[float](maxlen=_WINDOWS)

    def advance(self, elapsed_s: float) -> None:
        """Advance the sensor's time to that of the newest reading.

        Args:
            elapsed_s: time since the previous reading, sensor's clock [s].
        """
        self._now_s += elapsed_s * self._rate

    def sampled_at_s(self, arrived_at_s: float, *, prompt: bool) -> float:
        """Compute the latest possible sampling time of the newest reading, host's clock [s].

        Args:
            arrived_at_s: arrival time, host's clock [s].
            prompt: whether the arrival time is exact; otherwise the reading may have arrived later.
        """
        if arrived_at_s - self._arrived_s > self._longest_gap_s:
            self.restart()
        self._arrived_s = arrived_at_s
        if prompt:
            delay_s = arrived_at_s - self._now_s
            grown_s = self._delay_s + _CLOCKS_DIFFER * (self._now_s - self._looked_s)
            self._delay_s, self._looked_s = min(delay_s, grown_s), self._now_s
            self._follow_rate(delay_s)
        return min(arrived_at_s, self._now_s + self._delay_s)

    def _follow_rate(self, delay_s: float) -> None:
        """Correct the sensor's rate if its delays have changed steadily."""
        self._window_delay_s = min(self._window_delay_s, delay_s)
        if self._now_s < self._window_end_s:
            return
        self._delays_s.append(self._window_delay_s)
        self._window_delay_s, self._window_end_s = inf, self._now_s + _WINDOW_S
        changes = [after_s - before_s for before_s, after_s in pairwise(self._delays_s)]
        if len(changes) < _WINDOWS - 1:
            return
        largest_s = max(map(abs, changes))
        is_steady = max(changes) - min(changes) < _STEADY * largest_s
        if is_steady and _CLOCKS_DIFFER * _WINDOW_S < largest_s <= self._rate_error * _WINDOW_S:
            self._rate *= 1.0 + sum(changes) / len(changes) / _WINDOW_S
            self._delay_s = self._delays_s[-1] + max(changes[-1], 0.0)
            self._delays_s.clear()


_MARGIN_S = 1e-3  # variation of answering times; an unnecessary marker does no harm
_FORGETTING = 0.01  # rate at which the usual answering time follows a shorter one
_PATIENCE_S = 0.1  # time limit for an answer, and for the answer to a marker
_RETRY_PAUSE_S = 0.25  # pause after a missing answer, so that no late answer is taken for the next one


class Poll:
    """One request that is repeated after each answer; a reading gets the time of its request.

    If no answer comes, the request is sent again after a marker (a request whose answer is not a reading).
    Sensors answer in order, so everything after the marker's answer belongs to the request after it. If
    nothing answers, nothing is requested or accepted for a while, so that no late answer is assigned to a
    newer request.

    Args:
        question: Request for a reading.
        marker: Request for something else.
    """

    def __init__(self, question: bytes, marker: bytes) -> None:
        self._question, self._marker = question, marker
        self._asked_s: float | None = None  # time of the request while its answer is pending
        self._silent_since_s = 0.0  # time of the first unanswered request
        self._usual_s: float | None = None  # usual answering time, the longest of recent ones
        self._awaits_marker = False
        self._deaf_until_s = -float("inf")

    def to_send(self, now_s: float) -> bytes:
        """Return the bytes to send now; may be empty.

        Args:
            now_s: robot's clock [s].
        """
        if now_s < self._deaf_until_s:
            return b""
        if self._asked_s is None:
            self._asked_s = self._silent_since_s = now_s
            return self._question
        if now_s - self._silent_since_s > _PATIENCE_S:
            self._asked_s, self._awaits_marker, self._deaf_until_s = None, False, now_s + _RETRY_PAUSE_S
            return b""
        if self._awaits_marker or self._usual_s is None or now_s - self._asked_s <= self._usual_s + _MARGIN_S:
            return b""
        self._asked_s, self._awaits_marker = now_s, True
        return self._marker + self._question

    def marked(self) -> None:
        """Record that the answer to the marker has arrived."""
        self._awaits_marker = False

    def answered(self, arrived_s: float) -> float | None:
        """Return when the reading that has arrived was requested [s]; None if unknown.

        Args:
            arrived_s: robot's clock [s].
        """
        if self._awaits_marker:
            return None
        asked_s, self._asked_s = self._asked_s, None
        if asked_s is not None:
            delay_s = arrived_s - asked_s
            usual_s = delay_s if self._usual_s is None else self._usual_s
            self._usual_s = max(delay_s, usual_s + _FORGETTING * (delay_s - usual_s))
        return asked_s


MAX_LINE = 200  # largest length of a line [bytes]; a longer line is noise
_FIXED_FORMAT = 200  # lines of equal decimals in a row; by chance, trailing zeros left out, 1 in 10^9
_GRAVITY_M_S2 = 9.80665
_POUND_N = 0.45359237 * _GRAVITY_M_S2

# In one unit; exact factors of NIST SP 811, appendix B.
NEWTONS = {
    **{"n": 1.0, "mn": 1e-3, "kn": 1e3},
    **dict.fromkeys(("kgf", "kg"), _GRAVITY_M_S2),
    **dict.fromkeys(("gf", "g"), 1e-3 * _GRAVITY_M_S2),
    **dict.fromkeys(("lbf", "lb", "lbs"), _POUND_N),
    **dict.fromkeys(("ozf", "oz"), _POUND_N / 16),
    "klbf": 1e3 * _POUND_N,
}


def newtons_per(unit: str) -> float:
    """Return the newtons in one unit; case does not matter, except that MN is not mN.

    Args:
        unit: unit, such as "lbF".

    Raises:
        ProtocolError: unknown unit.
    """
    text = unit.strip()
    factor = None if text.startswith("M") and text[1:] in ("N", "n") else NEWTONS.get(text.lower())
    if factor is None:
        raise ProtocolError(f"unit '{text[:20]}' is not a known unit of force. Valid: {', '.join(NEWTONS)}")
    return factor


def check_unit(unit: str | None) -> str | None:
    """Return a unit from a robot file, for pydantic; raise `ValueError` if it is unknown.

    Args:
        unit: unit in the robot file, or None.
    """
    if unit is not None:
        try:
            newtons_per(unit)
        except ProtocolError as error:
            raise ValueError(str(error)) from error
    return unit


def decode_text(line: bytes) -> str:
    """Decode a line as text, stripped; raise `ProtocolError` if it is not printable ASCII.

    Args:
        line: received line.
    """
    if not all(32 <= byte < 127 or byte == 9 for byte in line):
        raise ProtocolError(f"not a line of text: {line[:40]!r}")
    return line.decode("ascii").strip()


class ReadingStream(ABC):
    """Parser of force samples from bytes, in any portions. Damaged samples are counted and ignored.

    Attributes:
        rejected: number of received items that were not samples.
        fault_text: error that the device has reported since its last sample; empty if there is none.
        has_checksums: whether each sample has a checksum.
        held_back_s: time for which the stream waits for the confirmation of a sample [s].
        sensor_clock: dates samples by the sensor's own time; None if it sends none.
        poll: requests each sample; None if the sensor sends them by itself.
    """

    rejected = 0
    fault_text = ""
    has_checksums = False
    held_back_s = 0.0
    sensor_clock: SensorClock | None = None
    poll: Poll | None = None

    @abstractmethod
    def feed(self, data: bytes) -> list[float]:
        """Process received bytes; return the forces that are now complete, oldest first [N].

        Args:
            data: bytes since the last call, which may begin and end within a sample.

        Returns:
            Forces in the sensor's sign; possibly none.
        """


class LineSplitter:
    """Splits bytes at CR and LF; empty lines are dropped, and a line that is too long becomes empty."""

    def __init__(self) -> None:
        self._unfinished = b""
        self._skipping = False  # while skipping a line whose beginning was missing or too long

    def feed(self, data: bytes) -> list[bytes]:
        """Process received bytes; return the lines that are now complete, without their ends."""
        *lines, self._unfinished = (self._unfinished + data).replace(b"\r", b"\n").split(b"\n")
        if lines and self._skipping:
            lines, self._skipping = lines[1:], False
        lines = [line if len(line) <= MAX_LINE else b"" for line in lines if line]
        if len(self._unfinished) > MAX_LINE:
            self._unfinished, self._skipping = b"", True
            lines.append(b"")
        return lines

    def resynchronize(self) -> None:
        """Discard an incomplete line, including its remaining bytes."""
        self._unfinished, self._skipping = b"", True


class LineStream(ReadingStream):
    """Readings from lines of text, none beyond `largest_n` [N].

    If all lines so far have the same number of decimals, a line with another number is rejected, because a
    byte is missing ("0.65" without its point is 65). The first line may have lost its beginning, and is
    ignored unless `from_beginning`.

    `parse` returns the number as written in a line, and the newtons per unit. It raises `ProtocolError`
    if the line is not a reading.
    """

    def __init__(
        self, parse: Callable[[str], tuple[str, float]], largest_n: float, *, from_beginning: bool = False
    ) -> None:
        self._parse, self._largest_n = parse, largest_n
        self._lines = LineSplitter()
        if not from_beginning:
            self._lines.resynchronize()
        self._decimals, self._same_count = 0, 0  # number of decimals, and consecutive lines with it

    def feed(self, data: bytes) -> list[float]:
        samples: list[float] = []
        for line in self._lines.feed(data):
            self._parse_line(line, samples)
        return samples

    def _parse_line(self, line: bytes, samples: list[float]) -> None:
        """Append the reading of a line to the samples."""
        try:
            samples.append(self._force_n(decode_text(line)))
        except ProtocolError:
            self.rejected += 1

    def _force_n(self, line: str) -> float:
        text, newtons = self._parse(line)
        try:
            force_n = float(text) * newtons
        except ValueError as error:
            raise ProtocolError(f"not a number: '{text[:40]}'") from error
        decimals = len(text.lower().partition("e")[0].partition(".")[2])
        if decimals == self._decimals:
            self._same_count += 1
        elif self._same_count < _FIXED_FORMAT:
            self._decimals, self._same_count = decimals, 0
        else:
            self._same_count //= 2  # adapts to a lasting change of the format
            raise ProtocolError(f"{decimals} decimals, but all earlier lines had {self._decimals}")
        if not abs(force_n) <= self._largest_n:  # true for NaN as well
            raise ProtocolError(f"{force_n:g} N is beyond {self._largest_n:g} N")
        return force_n
