"""Detection of a drive that does not obey: it still answers, but exerts no torque, or the opposite one.

A drive that has restarted may report it in none of its frames; its own measured torque shows it. The torque
is compared with everything that was sent within the time after which a sound drive shows it, so that delays,
lags and fast changes of the command are allowed for; a torque near zero is not judged.

Not every sound drive shows what it was sent: constants are off by tens of percent, zeros drift, amplifiers
saturate, small torques are lost, and some readings are mostly noise or rounding. So half of the torque may
always be missing; a reading may be off by its usual error; a difference within the reading's own jumps is
ignored; and a small torque is not expected of a drive that has never shown so small a torque on that side.
"""

from math import copysign, inf, nan

from robot_io.clip import clip
from robot_io.guard.limits import Limits, Problem
from robot_io.types import Measurement, Status

_MISSING_SHARE = 0.5  # of the torque sent that may always be missing, and
_CLEAR_SHARE = 0.5  # of what may be missing: no more than that is, where a torque is shown clearly
_STEADY = 1.5  # times the least is the most torque of late, where one was shown: not in passing
_SMALLER = 0.8  # times the smallest torque so shown: must be shown as well,
_LARGE_SHARE = 0.1  # and so must this share of the torque limit, whatever was shown
_FLOOR_SHARE = 0.01  # this share of the torque limit, and
_JUMPS = 2.0  # so many of the reading's mean jumps
_JUMP_SHARE = 0.02  # of a new jump in that mean
_SAMPLES = 5  # in a row before it counts, however slowly they come
_HABIT_S = 1.0  # how far a reading is off becomes usual within this time,
_FIRST_S = 0.05  # but after the first command, for so long,
_FIRST_HABIT_S = 0.01  # within this one
_LATE_S = 0.1  # by so much a reading may be late
_PAUSE_S = 0.1  # without a command: what comes then is a first command again

_REMEDY = (
    "check its supply and connectors, and restart it; palpate doctor says whether it is well; if it obeys "
    "and only shows its torque badly, raise limits.deaf_drive_s"
)


class _Drive:
    """One drive: what was sent to it of late, and what it usually shows."""

    __slots__ = (
        *("before_nm", "clear_nm", "count", "floor_nm", "high_nm", "jump_nm", "jumps"),
        *("low_nm", "measured_nm", "obeyed_at_s", "sent_nm", "usually_off_nm"),
    )

    def __init__(self, limit_nm: float) -> None:
        self.floor_nm = _FLOOR_SHARE * limit_nm
        # Lowest and highest: in this stretch of time, in the one before, and in both.
        self.sent_nm = self.before_nm = (inf, -inf)
        self.low_nm, self.high_nm = inf, -inf
        self.measured_nm = nan
        self.jump_nm = inf  # resolution unknown until the reading changes
        # Smallest torques that were clearly shown, by their sign.
        self.clear_nm = dict.fromkeys((1.0, -1.0), _LARGE_SHARE * limit_nm / _SMALLER)
        self.usually_off_nm = self.obeyed_at_s = 0.0
        self.count = self.jumps = 0

    def widen(self, torque_nm: float, *, is_next: bool) -> None:
        """Count a command in, as the first of the next stretch of time or as one more of this one."""
        if is_next:
            self.before_nm, self.sent_nm = self.sent_nm, (torque_nm, torque_nm)
        else:
            self.sent_nm = min(self.sent_nm[0], torque_nm), max(self.sent_nm[1], torque_nm)
        self.low_nm = min(self.sent_nm[0], self.before_nm[0])
        self.high_nm = max(self.sent_nm[1], self.before_nm[1])

    def shows(self, measured_nm: float) -> None:
        """Take the newest reading, and learn how it jumps."""
        jump_nm = abs(measured_nm - self.measured_nm)
        self.measured_nm = measured_nm
        if jump_nm > 0.0:
            self.jumps += 1
            before_nm = self.jump_nm if self.jumps > 1 else 0.0
            self.jump_nm = before_nm + (jump_nm - before_nm) * max(_JUMP_SHARE, 1.0 / self.jumps)

    @property
    def least_sent_nm(self) -> float:
        """The smallest torque of late, where all had one sign [N m]."""
        return min(self.low_nm, self.high_nm, key=abs)

    def is_missing(self) -> bool:
        """Whether the reading says that torque is missing."""
        least_nm, most_nm = max(self.low_nm, -self.high_nm), max(self.high_nm, -self.low_nm)
        if not least_nm > 2.0 * self.floor_nm:
            return False
        sign = copysign(1.0, self.low_nm)
        missing_nm = least_nm - sign * self.measured_nm
        may_be_nm = _MISSING_SHARE * least_nm + self.floor_nm + _JUMPS * self.jump_nm
        if missing_nm <= _CLEAR_SHARE * may_be_nm and most_nm <= _STEADY * least_nm:
            self.clear_nm[sign] = min(self.clear_nm[sign], most_nm)
        missing_nm += min(sign * self.usually_off_nm, 0.0)
        return missing_nm > may_be_nm and least_nm >= _SMALLER * self.clear_nm[sign]

    def get_used_to(self, share: float) -> None:
        """Take how far the reading is off now for a part of what is usual."""
        off_nm = self.measured_nm - clip(self.measured_nm, self.low_nm, self.high_nm)
        self.usually_off_nm += (off_nm - self.usually_off_nm) * share


class UnresponsiveDrives:
    """Tracks for each drive what was sent to it, and since when it shows something else.

    Args:
        limits: `deaf_drive_s` is the time; shares of the arm's torques are thresholds.
    """

    def __init__(self, limits: Limits) -> None:
        self._time_s = limits.deaf_drive_s
        self._torques_nm = limits.torque_nm
        self.restart()

    def restart(self) -> None:
        """Forget everything, as after the torque was off."""
        self._sampled_at_s = self._sent_at_s = self._begun_s = self._stretch_s = -inf
        self._drives = tuple(map(_Drive, self._torques_nm))

    def sent(self, time_s: float, torque_nm: list[float]) -> None:
        """Remember a command that is sent now.

        Args:
            time_s: now, on the robot's clock [s].
            torque_nm: shape (n,) [N m].
        """
        if time_s - self._sent_at_s > _PAUSE_S:
            self.restart()
            self._begun_s = self._stretch_s = time_s
        self._sent_at_s = time_s
        is_next = time_s - self._stretch_s >= _LATE_S
        if is_next:
            self._stretch_s = time_s
        for drive, torque in zip(self._drives, torque_nm, strict=True):
            drive.widen(torque, is_next=is_next)

    def problem(self, measurement: Measurement) -> Problem | None:
        """Judge one tick; a repeated sample is ignored.

        Args:
            measurement: of this tick.

        Returns:
            The problem of the first drive that has not obeyed for `deaf_drive_s`, or None.
        """
        sampled_at_s = measurement.torque_at_s
        if not (sampled_at_s > self._sampled_at_s and sampled_at_s - self._sent_at_s <= _PAUSE_S):
            return None
        dt_s = min(sampled_at_s - self._sampled_at_s, _PAUSE_S)
        self._sampled_at_s = sampled_at_s
        is_first = sampled_at_s - self._begun_s < _FIRST_S
        is_judged = not is_first and measurement.torque_status is not Status.SATURATED
        share = dt_s / (dt_s + (_FIRST_HABIT_S if is_first else _HABIT_S))
        for joint, (drive, measured_nm) in enumerate(
            zip(self._drives, measurement.joint_torque_nm.tolist(), strict=True), 1
        ):
            drive.shows(measured_nm)
            if not (is_judged and drive.is_missing()):
                drive.count, drive.obeyed_at_s = 0, sampled_at_s
                drive.get_used_to(share)
                continue
            drive.count += 1
            if drive.count >= _SAMPLES and sampled_at_s - drive.obeyed_at_s >= self._time_s - 1e-9:
                return Problem(
                    f"joint {joint}: its drive exerts {measured_nm:.2f} N m where {drive.least_sent_nm:.2f} "
                    "N m was sent: it may have restarted, or lost its mode",
                    _REMEDY,
                )
        return None
