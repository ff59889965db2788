"""Detection of frozen sensors and of drives that do not obey.

Frozen encoders. A joint at rest also reads one number, and so does one that friction holds. An encoder is
**suspect** when for some time not one of its steps was seen, although the reference of its joint has moved by
several. Every trip then names it, and its joint is not braked against its velocity until a step is seen;
friction makes sound encoders suspect, so the weight is held up as always. It is **stuck**, and trips the
guard, when meanwhile the drive has answered with a change of torque that no friction of a sound joint holds
back. A smaller change suffices where a joint that had followed its reference stands still from one sample to
the next, while the reference goes on the same way and the force stays as it is: friction stops a joint that
creeps or turns round, and an object that is hit is felt. A jammed joint looks the same, and is as good a
reason to stop.

Frozen force sensors. A sound sensor repeats itself too: its steps are coarse, it is filtered, it holds zero
on purpose, or nothing shakes it. So a problem is reported only while the arm moves, and only for an
improbable row of equal samples. With a share p of samples that are equal to the one before, k equal ones in a
row come by chance with a probability of p^k. The share is learnt from the sensor's own samples and noise:
readings on the edge between two steps alternate, and stand still in the middle of one. Noise is a change up
and down by more than one step: a row of ups is a push, and one step is an edge. Filtered readings repeat
themselves in clusters, so a row must also be much longer than any before it. A sensor that has stood still
for the whole time while the arm moved, and then changed again, does so by nature and is not reported any
more.

Drives that still answer, but exert no torque, or the opposite one. A drive that has restarted may report it
in none of its frames; its own measured torque shows it. The torque is compared with everything that was sent
within the time after which a sound drive shows it, so that delays, lags and fast changes of the command are
allowed for; a torque near zero is not judged.

Not every sound drive shows what it was sent: constants are off by tens of percent, zeros drift, amplifiers
saturate, small torques are lost, and some readings are mostly noise or rounding. So half of the torque may
always be missing; a reading may be off by its usual error; a difference within the reading's own jumps is
ignored; and a small torque is not expected of a drive that has never shown so small a torque on that side.
"""

from math import inf, isfinite, log, nan

from palpate.robot_io.guard.limits import Limits, Problem
from palpate.robot_io.types import FloatArray, Measurement, Status, clip

_SAMPLES = 5  # new ones in that time; a drive with fewer measures more slowly than it is read
_STEPS = 4  # of the encoder, that the reference must have moved, and
_TRACKING_SHARE = 0.01  # this share of the tracking limit; or
_UNKNOWN_SHARE = 0.05  # this one, as long as no step has been seen that would tell their size
_TORQUE_SHARE = 0.5  # of the torque limit; friction changes sign with the motion, and so counts twice
_STOPPED_SHARE = 0.1  # the same where the joint was stopped in its motion,
_FORCE_SHARE = 0.02  # and the force has not changed by more than this share of its limit
_FOLLOWED = (0.6, 1.5)  # times the way of its reference: the joint was following
_PACE_SHARE = 0.5  # of the reference's speed before: it has gone on

_Mark = tuple[float, float, float]  # time [s], position and reference [rad]


class _Joint:
    """One joint since its reading last changed."""

    __slots__ = (
        *(
            "before_rad",
            "followed_rad",
            "followed_s",
            "force_n",
            "least_rad",
            "marks",
            "position_rad",
            "reference_rad",
        ),
        *("samples", "since_s", "step_rad", "still_s", "suspect", "torque_nm", "unknown_rad"),
    )
    marks: tuple[_Mark, _Mark]  # up to one and up to two times `still_s` ago
    position_rad: float
    samples: int
    suspect: bool

    def __init__(self, tracking_rad: float, still_s: float) -> None:
        self.still_s = still_s
        self.least_rad = _TRACKING_SHARE * tracking_rad
        self.unknown_rad = _UNKNOWN_SHARE * tracking_rad
        self.step_rad = inf  # smallest one seen

    def begin(
        self, time_s: float, position_rad: float, reference_rad: float, torque_nm: float, force_n: float
    ) -> None:
        """A reading that differs from the one before, or is the first.

        Args:
            time_s: of the sample, robot's clock [s].
            position_rad: positions of the encoder [rad].
            reference_rad: of the controller [rad].
            torque_nm: measured by its drive [N m].
            force_n: force of the force sensor [N].
        """
        if self.samples:
            self.step_rad = min(self.step_rad, abs(position_rad - self.position_rad))
        before_s, before_rad, reference_before_rad = self.marks[1]
        self.before_rad, self.followed_rad = position_rad - before_rad, reference_rad - reference_before_rad
        self.followed_s = time_s - before_s
        self.samples, self.since_s, self.suspect = 1, time_s, False
        self.position_rad, self.reference_rad, self.torque_nm = position_rad, reference_rad, torque_nm
        self.force_n = force_n

    @property
    def most_rad(self) -> float:
        """The way that a sound encoder shows."""
        known = isfinite(self.step_rad)
        return max(self.least_rad, _STEPS * self.step_rad) if known else self.unknown_rad

    def is_suspect(self, time_s: float, moved_rad: float) -> bool:
        """Whether a sound encoder would have shown that the reference has moved so far, friction aside.

        Args:
            time_s: robot's clock [s].
            moved_rad: how far the reference has moved [rad].
        """
        still = self.samples >= _SAMPLES and time_s - self.since_s >= self.still_s - 1e-9
        return still and abs(moved_rad) > self.most_rad

    def was_stopped(self, time_s: float, moved_rad: float) -> bool:
        """Return whether it had followed its reference, which has gone on the same way.

        Args:
            time_s: robot's clock [s].
            moved_rad: how far the reference has moved [rad].
        """
        way_rad = self.followed_rad
        if abs(way_rad) <= self.most_rad or not _FOLLOWED[0] < self.before_rad / way_rad < _FOLLOWED[1]:
            return False
        return moved_rad / way_rad > _PACE_SHARE * (time_s - self.since_s) / self.followed_s


class StuckEncoders:
    """Tracks, for each joint, since when its reading has stood still, and the events since then.

    Args:
        limits: `stuck_encoder_s` is how long a joint must stand still; shares of the other limits are
            thresholds.

    Attributes:
        suspicion: which encoder is suspect and why; None if none is.
        is_proven: whether it is stuck.
    """

    def __init__(self, limits: Limits) -> None:
        self._joints = tuple(
            _Joint(tracking_rad, limits.stuck_encoder_s) for tracking_rad in limits.tracking_rad
        )
        self._torques_nm = limits.torque_nm
        self._still_s = limits.stuck_encoder_s
        self._unfelt_n = _FORCE_SHARE * limits.force_n
        self.restart()

    def restart(self) -> None:
        """Forget the history; the known size of the steps stays."""
        self._sampled_at_s = self._marked_at_s = -inf
        self.suspicion: str | None = None
        self.is_proven = False
        for joint in self._joints:
            joint.samples, joint.suspect = 0, False

    def trusted(self, measurement: Measurement) -> list[bool]:
        """Determine for which joints the velocity can be trusted.

        Args:
            measurement: measurement of this tick.

        Returns:
            False for suspect joints that still show no step, shape (n,).
        """
        positions_rad = measurement.joint_position_rad.tolist()
        for joint, position_rad in zip(self._joints, positions_rad, strict=True):
            joint.suspect = joint.suspect and position_rad == joint.position_rad
        return [not joint.suspect for joint in self._joints]

    def update(self, measurement: Measurement, reference_position_rad: FloatArray) -> None:
        """Judge one tick; without a new sample of the encoders nothing changes.

        Args:
            measurement: measurement of this tick.
            reference_position_rad: where the joints should be, shape (n,) [rad].
        """
        if not measurement.encoder_at_s > self._sampled_at_s:
            return
        self._sampled_at_s = time_s = measurement.encoder_at_s
        self.suspicion, self.is_proven = None, False
        positions_rad = measurement.joint_position_rad.tolist()
        references_rad = reference_position_rad.tolist()
        torques_nm = measurement.joint_torque_nm.tolist()
        if time_s - self._marked_at_s >= self._still_s:
            # Store joint positions and references; motion before this says nothing.
            missed = time_s - self._marked_at_s > 2.0 * self._still_s
            self._marked_at_s = time_s
            for joint, position_rad, reference_rad in zip(
                self._joints, positions_rad, references_rad, strict=True
            ):
                mark = (time_s, position_rad, reference_rad)
                joint.marks = (mark, mark if missed else joint.marks[0])
        for i, joint in enumerate(self._joints):
            if not joint.samples or positions_rad[i] != joint.position_rad:
                joint.begin(time_s, positions_rad[i], references_rad[i], torques_nm[i], measurement.force_n)
                continue
            joint.samples += 1
            moved_rad = references_rad[i] - joint.reference_rad
            joint.suspect = joint.is_suspect(time_s, moved_rad)
            if joint.suspect and not self.is_proven:
                changed_nm = abs(torques_nm[i] - joint.torque_nm)
                unfelt = abs(measurement.force_n - joint.force_n) <= self._unfelt_n
                stopped = unfelt and joint.was_stopped(time_s, moved_rad)
                self.is_proven = changed_nm > self._torques_nm[i] * (
                    _STOPPED_SHARE if stopped else _TORQUE_SHARE
                )
                self.suspicion = (
                    f"encoder of joint {i + 1}: stuck at {joint.position_rad:.4g} rad (or the joint is "
                    f"jammed) while its reference moved by {abs(moved_rad):.2g} rad and its torque by "
                    f"{changed_nm:.2g} N m"
                )


_LEAST_KNOWN = 100  # samples, before anything is said
_LEAST_SHARE = 0.05  # the least share assumed of any sensor
_IMPROBABLE = -log(1e-9)
_LONGER = 3  # times the longest row so far
# Times a step, over what a sample goes up and down beyond one: no less than p in the middle of a step, for
# normal noise of any size.
_NOISE_SHARE = 0.25
_MOST_STEPS = 8.0  # larger jumps are blows, and count as no more noise than this
_MOVED_RAD = 0.002  # least motion of a joint since the row began; more than a coarse encoder's noise

_SENSOR_REMEDY = (
    "check the load cell's cable and amplifier, and switch it off and on again; if it shows one number by "
    "nature, raise limits.stuck_force_s"
)


class StuckForce:
    """Tracks how often the force repeats itself.

    Args:
        time_s: least duration of a row that counts [s].
    """

    def __init__(self, time_s: float) -> None:
        self._time_s = time_s
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self._sampled_at_s = self._since_s = -inf
        self._force_n = nan
        self._since_rad: list[float] = []
        self._row = self._longest = 0  # samples in a row that were equal to the one before
        self._equal = self._known = 0  # samples that were, and all samples, before this row
        self._jump_n = nan  # the last change
        self._step_n = inf  # smallest change so far
        self._noise_n = 0.0  # sum of the changes that went back, each beyond one step
        self._enough: float = inf  # such a row is no chance
        self._rests = False  # it is known to stand still by nature

    def problem(self, measurement: Measurement) -> Problem | None:
        """Judge one tick; a repeated sample is ignored.

        Args:
            measurement: measurement of this tick.

        Returns:
            The problem of a stuck force, or None.
        """
        sampled_at_s, force_n = measurement.force_at_s, measurement.force_n
        if not sampled_at_s > self._sampled_at_s:
            return None
        lasted_s = self._sampled_at_s - self._since_s
        self._sampled_at_s = sampled_at_s
        if force_n != self._force_n:
            self._learn(lasted_s >= self._time_s, measurement)
            self._since_s, self._since_rad = sampled_at_s, measurement.joint_position_rad.tolist()
            self._jump_n, self._force_n = force_n - self._force_n, force_n
            return None
        self._row += 1
        if self._row > self._enough and sampled_at_s - self._since_s >= self._time_s - 1e-9:
            if self._rests or not self._has_moved(measurement):
                return None
            return Problem(
                f"force sensor: stuck at {force_n:.4g} N, {self._row + 1} equal samples in a row while the "
                "arm moved",
                _SENSOR_REMEDY,
            )
        return None

    def _has_moved(self, measurement: Measurement) -> bool:
        """Return whether the arm has, since the row began."""
        positions_rad = zip(measurement.joint_position_rad.tolist(), self._since_rad, strict=True)
        return any(abs(now - then) > _MOVED_RAD for now, then in positions_rad)

    def _learn(self, was_long: bool, measurement: Measurement) -> None:
        """From the row that has ended with this measurement."""
        jump_n = measurement.force_n - self._force_n
        self._step_n = min(self._step_n, abs(jump_n))
        if jump_n * self._jump_n < 0.0:
            self._noise_n += min(abs(jump_n), _MOST_STEPS * self._step_n) - self._step_n
        row, self._row = self._row, 0
        if was_long:  # a long run of equal samples at rest says nothing about motion
            self._rests |= self._has_moved(measurement)
            return
        self._equal += row
        self._known += row + 1
        self._longest = max(self._longest, row)
        if self._known >= _LEAST_KNOWN:
            self._enough = self._improbable_count()

    def _improbable_count(self) -> float:
        """Return the number of equal samples in a row that is none."""
        if not self._noise_n:
            return inf
        noise_n = self._noise_n / self._known
        share = max(self._equal / self._known, _LEAST_SHARE, _NOISE_SHARE * self._step_n / noise_n)
        return max(_IMPROBABLE / -log(share), _LONGER * self._longest) if share < 1.0 else inf


_MISSING_SHARE = 0.5  # of the torque sent that may always be missing, and
_CLEAR_SHARE = 0.5  # of what may be missing: no more than that is, where a torque is shown clearly
_STEADY = 1.5  # times the least is the most torque of late, where one was shown: not in passing
_SMALLER = 0.8  # times the smallest torque so shown: must be shown as well,
_LARGE_SHARE = 0.1  # and so must this share of the torque limit, whatever was shown
_FLOOR_SHARE = 0.01  # this share of the torque limit, and
_JUMPS = 2.0  # in mean jumps of the reading
_JUMP_SHARE = 0.02  # of a new jump in that mean
_DISOBEYED_SAMPLES = 5  # in a row before it counts, however slowly they come
_HABIT_S = 1.0  # how far a reading is off becomes usual within this time,
_FIRST_S = 0.05  # but after the first command, for so long,
_FIRST_HABIT_S = 0.01  # within this one
_LATE_S = 0.1  # largest delay of a reading
_PAUSE_S = 0.1  # without a command, after which the next one counts as the first

_DRIVE_REMEDY = (
    "check its supply and connectors, and restart it; palpate doctor says whether it is well; if it obeys "
    "and only shows its torque badly, raise limits.deaf_drive_s"
)


class _Drive:
    """One drive: its recent commands, and its usual readings."""

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
        """Count a command in, as the first of the next stretch of time or as one more of this one.

        Args:
            torque_nm: that was commanded [N m].
            is_next: whether a new stretch of time begins with it.
        """
        if is_next:
            self.before_nm, self.sent_nm = self.sent_nm, (torque_nm, torque_nm)
        low_nm, high_nm = self.sent_nm
        low_nm = torque_nm if torque_nm < low_nm else low_nm
        high_nm = torque_nm if torque_nm > high_nm else high_nm
        self.sent_nm = low_nm, high_nm
        before_low_nm, before_high_nm = self.before_nm
        self.low_nm = low_nm if low_nm < before_low_nm else before_low_nm
        self.high_nm = high_nm if high_nm > before_high_nm else before_high_nm

    def shows(self, measured_nm: float) -> None:
        """Take the newest reading, and learn how it jumps.

        Args:
            measured_nm: of the drive [N m].
        """
        jump_nm = abs(measured_nm - self.measured_nm)
        self.measured_nm = measured_nm
        if jump_nm > 0.0:
            self.jumps += 1
            if self.jumps == 1:
                self.jump_nm = jump_nm
            else:
                share = max(_JUMP_SHARE, 1.0 / self.jumps)
                self.jump_nm += (jump_nm - self.jump_nm) * share

    @property
    def least_sent_nm(self) -> float:
        """The smallest torque of late, where all had one sign [N m]."""
        return min(self.low_nm, self.high_nm, key=abs)

    def is_missing(self) -> bool:
        """Return whether the reading indicates a missing torque."""
        low_nm, high_nm = self.low_nm, self.high_nm
        sign, least_nm, most_nm = (1.0, low_nm, high_nm) if low_nm > 0.0 else (-1.0, -high_nm, -low_nm)
        if not least_nm > 2.0 * self.floor_nm:
            return False
        missing_nm = least_nm - sign * self.measured_nm
        may_be_nm = _MISSING_SHARE * least_nm + self.floor_nm + _JUMPS * self.jump_nm
        if missing_nm <= _CLEAR_SHARE * may_be_nm and most_nm <= _STEADY * least_nm:
            self.clear_nm[sign] = min(self.clear_nm[sign], most_nm)
        usually_nm = sign * self.usually_off_nm
        missing_nm += 0.0 if usually_nm > 0.0 else usually_nm
        return missing_nm > may_be_nm and least_nm >= _SMALLER * self.clear_nm[sign]

    def get_used_to(self, share: float) -> None:
        """Include the present deviation of the reading in its usual deviation.

        Args:
            share: share of the difference, 0 to 1.
        """
        off_nm = self.measured_nm - clip(self.measured_nm, self.low_nm, self.high_nm)
        self.usually_off_nm += (off_nm - self.usually_off_nm) * share


class UnresponsiveDrives:
    """Tracks the commands of each drive, and since when its readings contradict them.

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
            measurement: measurement of this tick.

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
            if drive.count >= _DISOBEYED_SAMPLES and sampled_at_s - drive.obeyed_at_s >= self._time_s - 1e-9:
                return Problem(
                    f"joint {joint}: its drive exerts {measured_nm:.2f} N m where {drive.least_sent_nm:.2f} "
                    "N m was sent: it may have restarted, or lost its mode",
                    _DRIVE_REMEDY,
                )
        return None
