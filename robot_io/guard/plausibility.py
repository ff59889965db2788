"""Detection of frozen sensors and of drives that do not execute their commands.

Frozen encoders. The reading of a joint at rest is constant too, even if friction holds the joint. An encoder
is **suspect** if its reading has not changed for some time, although the reference of its joint has moved by
several encoder steps. Every trip then names the encoder, and its joint is not braked by its velocity until
the reading changes. Friction makes working encoders suspect, so the weight is supported as usual. An encoder
is **stuck**, and trips the guard, if meanwhile the drive's torque has changed by more than the friction of a
working joint can hold. A smaller change suffices if a joint that followed its reference stops from one sample
to the next, while the reference continues in the same direction and the force does not change: friction stops
only a joint that creeps or reverses, and a collision changes the force. A jammed joint looks the same, and is
an equally good reason to stop.

Frozen force sensors. A working sensor repeats values too: its resolution is coarse, it is filtered, it holds
zero on purpose, or it has no vibration. So a problem is reported only while the arm moves, and only for an
improbable sequence of equal samples. If a share p of samples equals the previous one, k consecutive equal
samples have a probability of p^k. The share is estimated from the sensor's own samples and noise: readings at
the edge between two quantization steps alternate, and are constant in the middle of a step. Only changes up
and down by more than one step count as noise, because several rises are a push, and a change by one step is
an edge. Filtered readings repeat in clusters, so a sequence must also be much longer than any earlier one. A
sensor whose reading stayed constant while the arm moved, and then changed again, is not reported any more.

Drives that still answer, but exert no torque or the opposite torque. The frames of a drive may not report a
restart, but its measured torque reveals it. The torque is compared with all commands within the response time
of a working drive, which allows for delays, lags and fast changes of the command. Torques near zero are not
checked.

A working drive may not measure the commanded torque: constants have errors of tens of percent, zeros drift,
amplifiers saturate, small torques are lost, and some readings are mostly noise or rounding. So half of the
torque may always be missing, a reading may have its usual error, and a difference within the reading's own
jumps is ignored. A reading that is exactly constant for 0.1 s has no noise, however it jumped before, and its
resolution excuses no more than a twentieth of the torque limit: a drive that no longer measures any torque is
found from an eighth of its limit on. A small torque is not expected of a drive that has never measured so
small a torque of that sign.

A drive whose reading is frozen at some torque may still work, but can no longer be checked. A reading is
frozen if it is exactly constant while the commands that it must have shown change by more than dead band and
resolution of a working drive explain. The reading of a saturated amplifier is constant too, but it
is the largest so far, and the commands are not much smaller.
"""

from math import inf, isfinite, log, nan

from palpate.robot_io.guard.limits import Limits, Problem
from palpate.robot_io.types import FloatArray, Measurement, clip

_SAMPLES = 5  # consecutive equal samples of an encoder before it can be suspect, at any sample rate
_STEPS = 4  # encoder steps by which the reference must have moved, and
_TRACKING_SHARE = 0.01  # share of the tracking limit by which it must have moved; or
_UNKNOWN_SHARE = 0.05  # this share, as long as the size of the encoder's steps is unknown
_TORQUE_SHARE = 0.5  # share of the torque limit; friction changes sign with the motion, and so counts twice
_STOPPED_SHARE = 0.1  # likewise if the joint was stopped in its motion,
_FORCE_SHARE = 0.02  # and the force has not changed by more than this share of its limit
_FOLLOWED = (0.6, 1.5)  # ratio of the joint's motion to that of its reference: the joint was following
_PACE_SHARE = 0.5  # share of the reference's earlier speed: the reference continued

_ENCODER_REMEDY = (
    "turn the joint by hand without power: if it turns freely, check encoder and coupling; if friction holds "
    "it, raise limits.stuck_encoder_s"
)

_Mark = tuple[float, float, float]  # time [s], position and reference [rad]


class _Joint:
    """State of one joint since its reading last changed."""

    __slots__ = (
        *("before_rad", "followed_rad", "followed_s", "force_n", "least_rad", "marks", "position_rad"),
        *("reference_rad", "samples", "since_s", "step_rad", "still_s", "suspect"),
        *("torque_nm", "unknown_rad"),
    )
    marks: tuple[_Mark, _Mark]  # up to one and up to two times `still_s` ago
    position_rad: float
    samples: int  # number of equal samples so far
    suspect: bool

    def __init__(self, tracking_rad: float, still_s: float) -> None:
        self.still_s = still_s
        self.least_rad = _TRACKING_SHARE * tracking_rad
        self.unknown_rad = _UNKNOWN_SHARE * tracking_rad
        self.step_rad = inf  # smallest change of the reading so far

    def begin(
        self, time_s: float, position_rad: float, reference_rad: float, torque_nm: float, force_n: float
    ) -> None:
        """Store a changed or first reading.

        Args:
            time_s: time of the reading [s].
            position_rad: the reading [rad].
            reference_rad: reference of the joint at this time [rad].
            torque_nm: measured torque of the joint [N m].
            force_n: contact force [N].
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
    def visible_rad(self) -> float:
        """Motion of the reference that a working encoder must show [rad]."""
        known = isfinite(self.step_rad)
        return max(self.least_rad, _STEPS * self.step_rad) if known else self.unknown_rad

    def is_suspect(self, time_s: float, moved_rad: float) -> bool:
        """Return whether a reading stays constant although a working encoder would have shown this motion.

        Args:
            time_s: present time [s].
            moved_rad: motion of the reference since the reading last changed [rad].
        """
        still = self.samples >= _SAMPLES and time_s - self.since_s >= self.still_s - 1e-9
        return still and abs(moved_rad) > self.visible_rad

    def was_stopped(self, time_s: float, moved_rad: float) -> bool:
        """Return whether the joint followed until it stopped, while the reference continued.

        Args:
            time_s: present time [s].
            moved_rad: motion of the reference since the reading last changed [rad].
        """
        way_rad = self.followed_rad
        if abs(way_rad) <= self.visible_rad or not _FOLLOWED[0] < self.before_rad / way_rad < _FOLLOWED[1]:
            return False
        return moved_rad / way_rad > _PACE_SHARE * (time_s - self.since_s) / self.followed_s


class StuckEncoders:
    """Tracks for each joint how long its reading has been constant, and the events in that time.

    Args:
        limits: `stuck_encoder_s` is the time without a change; thresholds are shares of the other limits.

    Attributes:
        suspicion: the suspect encoder and the reason; None if there is none.
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
        """Reset the history; the known size of the steps is kept."""
        self._sampled_at_s = self._marked_at_s = -inf
        self.suspicion: str | None = None
        for joint in self._joints:
            joint.samples, joint.suspect = 0, False

    def trusted(self, measurement: Measurement) -> list[bool]:
        """Return for each joint (n,) whether its velocity can be trusted: not while suspect and unchanged.

        Args:
            measurement: measurement of this tick.
        """
        positions_rad = measurement.joint_position_rad.tolist()
        for joint, position_rad in zip(self._joints, positions_rad, strict=True):
            joint.suspect = joint.suspect and position_rad == joint.position_rad
        return [not joint.suspect for joint in self._joints]

    def problem(self, measurement: Measurement, reference_position_rad: FloatArray) -> Problem | None:
        """Return the problem of a stuck encoder, or None; a repeated sample is ignored.

        Args:
            measurement: measurement of this tick.
            reference_position_rad: reference positions of the joints, shape (n,) [rad].
        """
        if not measurement.encoder_at_s > self._sampled_at_s:
            return None
        self._sampled_at_s = time_s = measurement.encoder_at_s
        problem = self.suspicion = None
        positions_rad = measurement.joint_position_rad.tolist()
        references_rad = reference_position_rad.tolist()
        torques_nm = measurement.joint_torque_nm.tolist()
        if time_s - self._marked_at_s >= self._still_s:
            # Store joint positions and references; earlier motion is not evidence.
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
            if joint.suspect and problem is None:
                changed_nm = abs(torques_nm[i] - joint.torque_nm)
                unfelt = abs(measurement.force_n - joint.force_n) <= self._unfelt_n
                stopped = unfelt and joint.was_stopped(time_s, moved_rad)
                share = _STOPPED_SHARE if stopped else _TORQUE_SHARE
                self.suspicion = (
                    f"encoder of joint {i + 1}: stuck at {joint.position_rad:.4g} rad (or the joint is "
                    f"jammed) while its reference moved by {abs(moved_rad):.2g} rad and its torque changed "
                    f"by {changed_nm:.2g} N m"
                )
                if changed_nm > self._torques_nm[i] * share:
                    problem = Problem(self.suspicion, _ENCODER_REMEDY)
        return problem


_LEAST_KNOWN = 100  # samples before a problem can be reported
_LEAST_SHARE = 0.05  # smallest share assumed for any sensor
_IMPROBABLE = -log(1e-9)
_LONGER = 3  # multiple of the longest sequence so far
# This times a step, divided by the mean noise beyond one step, is at least p in the middle of a step, for
# normal noise of any size.
_NOISE_SHARE = 0.25
_MOST_STEPS = 8.0  # larger jumps are impacts, and count as this much noise
_MOVED_RAD = 0.002  # smallest motion of a joint since the sequence began; more than a coarse encoder's noise

_SENSOR_REMEDY = (
    "check the load cell's cable and amplifier, and switch the amplifier off and on again; if a constant "
    "reading is normal, raise limits.stuck_force_s"
)


class StuckForce:
    """Detects a force sensor that repeats one value.

    Args:
        time_s: shortest duration of a sequence that counts [s].
    """

    def __init__(self, time_s: float) -> None:
        self._time_s = time_s
        self.restart()

    def restart(self) -> None:
        """Reset all state."""
        self._sampled_at_s = self._since_s = -inf
        self._force_n = nan
        self._since_rad: list[float] = []
        self._row = self._longest = 0  # consecutive samples that were equal to the previous one
        self._equal = self._known = 0  # number of equal samples, and of all samples, before this sequence
        self._jump_n = nan  # last change
        self._step_n = inf  # smallest change so far
        self._noise_n = 0.0  # sum of the changes that reversed, each beyond one step
        self._rests = False  # whether the sensor is known to repeat values

    def problem(self, measurement: Measurement) -> Problem | None:
        """Return the problem of a stuck force in this tick, or None; a repeated sample is ignored.

        Args:
            measurement: measurement of this tick.
        """
        sampled_at_s, force_n = measurement.force_at_s, measurement.force_n
        if not sampled_at_s > self._sampled_at_s:
            return None
        lasted_s = self._sampled_at_s - self._since_s
        self._sampled_at_s = sampled_at_s
        if force_n != self._force_n:
            jump_n = force_n - self._force_n
            self._step_n = min(self._step_n, abs(jump_n))
            if jump_n * self._jump_n < 0.0:
                self._noise_n += min(abs(jump_n), _MOST_STEPS * self._step_n) - self._step_n
            row, self._row = self._row, 0
            if lasted_s >= self._time_s:  # a long sequence at rest is no evidence about motion
                self._rests |= self._has_moved(measurement)
            else:
                self._equal += row
                self._known += row + 1
                self._longest = max(self._longest, row)
            self._since_s, self._since_rad = sampled_at_s, measurement.joint_position_rad.tolist()
            self._jump_n, self._force_n = jump_n, force_n
            return None
        self._row += 1
        is_long = sampled_at_s - self._since_s >= self._time_s - 1e-9 and self._row > self._improbable_count()
        if not is_long or self._rests or not self._has_moved(measurement):
            return None
        count = self._row + 1
        problem = f"force sensor: stuck at {force_n:.4g} N, {count} equal samples while the arm moved"
        return Problem(problem, _SENSOR_REMEDY)

    def _has_moved(self, measurement: Measurement) -> bool:
        """Return whether the arm has moved since the sequence began."""
        positions_rad = zip(measurement.joint_position_rad.tolist(), self._since_rad, strict=True)
        return any(abs(now - then) > _MOVED_RAD for now, then in positions_rad)

    def _improbable_count(self) -> float:
        """Return the number of consecutive equal samples that is not due to chance."""
        if self._known < _LEAST_KNOWN or not self._noise_n:
            return inf
        noise_n = self._noise_n / self._known
        share = max(self._equal / self._known, _LEAST_SHARE, _NOISE_SHARE * self._step_n / noise_n)
        return max(_IMPROBABLE / -log(share), _LONGER * self._longest) if share < 1.0 else inf


_MISSING_SHARE = 0.5  # share of the sent torque that may be missing, in addition to
_FLOOR_SHARE = 0.01  # this share of the torque limit, and
_JUMPS = 2.0  # this multiple of the reading's mean jump
_CLEAR_SHARE = 0.5  # a torque is clearly measured if at most this share of that sum is missing,
_STEADY = 1.5  # and if recent commands differ by no more than this factor
_SMALLER = 0.8  # a torque is expected from this multiple of the smallest clearly measured one on,
_LARGE_SHARE = 0.1  # or from this share of the torque limit on
_JUMP_SHARE = 0.02  # weight of a new jump in that mean
_CONSTANT_S = 0.1  # time without a jump after which they excuse
_COARSEST_SHARE = 0.05  # no more than this share of the torque limit
_DISOBEYED_SAMPLES = 5  # consecutive samples before it counts, at any sample rate
# Largest change of the commands, beyond the resolution, that leaves a reading constant; share of the limit.
_FROZEN_SHARE = 0.05
_DEAD_SHARE = 0.05  # share of the torque limit that may be lost around zero
_FROZEN_INTERVALS = 3  # once so many have begun without a change, the second last should have been shown
_LARGEST_GAIN = 4.0  # ratio of a reading to its torque, at most
_HABIT_S = 1.0  # time constant with which a deviation becomes usual;
_FIRST_S = 0.05  # for this time after the first command,
_FIRST_HABIT_S = 0.01  # this time constant
_LATE_S = 0.1  # largest delay of a reading
_PAUSE_S = 0.1  # time without a command after which the next command counts as the first

_DRIVE_REMEDY = (
    "check the drive's supply and connectors, restart the drive, and run palpate doctor; if the drive "
    "follows commands and only reports a wrong torque, raise limits.unresponsive_drive_s"
)


def _joined(one_nm: tuple[float, float], two_nm: tuple[float, float]) -> tuple[float, float]:
    """Return the smallest range (low, high) that contains two ranges."""
    return min(one_nm[0], two_nm[0]), max(one_nm[1], two_nm[1])


class _Drive:
    """Recent commands and usual readings of one drive."""

    __slots__ = (
        *("before_nm", "changed_at_s", "clear_nm", "coarsest_nm", "count", "expected_nm", "floor_nm"),
        *("high_nm", "jump_nm", "jumps", "limit_nm", "low_nm", "measured_nm", "obeyed_at_s", "range_nm"),
        *("sent_nm", "unchanged", "usually_off_nm"),
    )

    def __init__(self, limit_nm: float) -> None:
        self.limit_nm = limit_nm
        self.floor_nm, self.coarsest_nm = _FLOOR_SHARE * limit_nm, _COARSEST_SHARE * limit_nm
        # Lowest and highest command: in this interval, in the previous one, and in both.
        self.sent_nm = self.before_nm = (inf, -inf)
        # Lowest and highest reading; lowest and highest command that the present reading should show.
        self.range_nm = self.expected_nm = (inf, -inf)
        self.unchanged = 0  # intervals that have begun since the reading changed
        self.measured_nm = nan
        self.jump_nm = inf  # resolution unknown until the reading changes
        # Smallest torques that were clearly measured, by sign.
        self.clear_nm = dict.fromkeys((1.0, -1.0), _LARGE_SHARE * limit_nm / _SMALLER)
        self.usually_off_nm = self.obeyed_at_s = self.changed_at_s = 0.0
        self.count = self.jumps = 0

    def widen(self, torque_nm: float, *, is_next: bool) -> None:
        """Include a command in the range of commands that a reading may show.

        Args:
            torque_nm: commanded torque [N m].
            is_next: whether it is the first command of the next interval; the range covers this interval and
                the one before.
        """
        if is_next:
            self.unchanged += 1
            if self.unchanged >= _FROZEN_INTERVALS:
                self.expected_nm = _joined(self.expected_nm, self.before_nm)
            self.before_nm, self.sent_nm = self.sent_nm, (torque_nm, torque_nm)
        low_nm, high_nm = self.sent_nm
        low_nm = torque_nm if torque_nm < low_nm else low_nm
        high_nm = torque_nm if torque_nm > high_nm else high_nm
        self.sent_nm = low_nm, high_nm
        before_low_nm, before_high_nm = self.before_nm
        self.low_nm = low_nm if low_nm < before_low_nm else before_low_nm
        self.high_nm = high_nm if high_nm > before_high_nm else before_high_nm

    def shows(self, measured_nm: float, at_s: float) -> None:
        """Store the newest reading, and update the mean jump.

        Args:
            measured_nm: measured torque [N m]; an equal reading is no jump.
            at_s: time of the reading [s].
        """
        jump_nm = abs(measured_nm - self.measured_nm)
        self.measured_nm = measured_nm
        if jump_nm > 0.0:
            self.jumps += 1
            self.changed_at_s, self.unchanged, self.expected_nm = at_s, 0, (inf, -inf)
            self.range_nm = _joined(self.range_nm, (measured_nm, measured_nm))
            mean_nm = self.jump_nm if self.jumps > 1 else jump_nm
            self.jump_nm = mean_nm + (jump_nm - mean_nm) * max(_JUMP_SHARE, 1.0 / self.jumps)

    @property
    def least_sent_nm(self) -> float:
        """Smallest recent torque if all had one sign [N m]."""
        return min(self.low_nm, self.high_nm, key=abs)

    def is_missing(self, at_s: float, *, is_bound: bool) -> bool:
        """Return whether the reading of a time [s] indicates a missing torque.

        Args:
            at_s: time of the reading [s].
            is_bound: whether the reading is the end of the drive's range, which the torque may exceed.
        """
        low_nm, high_nm = self.low_nm, self.high_nm
        sign, least_nm, most_nm = (1.0, low_nm, high_nm) if low_nm > 0.0 else (-1.0, -high_nm, -low_nm)
        if not least_nm > 2.0 * self.floor_nm:
            return False
        if is_bound and sign * self.measured_nm > 0.0:
            return False
        missing_nm = least_nm - sign * self.measured_nm
        jumps_nm = _JUMPS * self.jump_nm
        if self.jumps and at_s - self.changed_at_s >= _CONSTANT_S:
            jumps_nm = min(jumps_nm, self.coarsest_nm)
        may_be_nm = _MISSING_SHARE * least_nm + self.floor_nm + jumps_nm
        if missing_nm <= _CLEAR_SHARE * may_be_nm and most_nm <= _STEADY * least_nm:
            self.clear_nm[sign] = min(self.clear_nm[sign], most_nm)
        missing_nm += min(sign * self.usually_off_nm, 0.0)
        return missing_nm > may_be_nm and least_nm >= _SMALLER * self.clear_nm[sign]

    def is_frozen(self) -> bool:
        """Return whether the reading is constant although a working drive would have changed it."""
        if not self.jumps:
            return False
        low_nm, high_nm = self.expected_nm
        dead_nm = _DEAD_SHARE * self.limit_nm
        may_be_nm = _FROZEN_SHARE * self.limit_nm + 2.0 * min(_JUMPS * self.jump_nm, self.coarsest_nm)
        may_be_nm += 2.0 * dead_nm if abs(self.measured_nm) <= dead_nm else 0.0
        if not high_nm - low_nm > may_be_nm:
            return False
        if self.range_nm[0] < self.measured_nm < self.range_nm[1]:
            return True
        least_nm = low_nm if self.measured_nm >= 0.0 else -high_nm  # in the direction of the reading
        return least_nm < abs(self.measured_nm) / _LARGEST_GAIN


class UnresponsiveDrives:
    """Tracks each drive's commands, and how long its readings have contradicted them.

    Args:
        limits: `unresponsive_drive_s` is the time; thresholds are shares of the torque limits.
    """

    def __init__(self, limits: Limits) -> None:
        self._time_s = limits.unresponsive_drive_s
        self._torques_nm = limits.torque_nm
        self.restart()

    def restart(self) -> None:
        """Reset all state, for example after the torque was off."""
        # Times of the newest sample and command, of the first command, and of the present interval.
        self._sampled_at_s = self._sent_at_s = self._begun_s = self._interval_s = -inf
        self._drives = tuple(map(_Drive, self._torques_nm))

    def sent(self, time_s: float, torque_nm: list[float]) -> None:
        """Store a command that is sent now.

        Args:
            time_s: now, on the robot's clock [s].
            torque_nm: shape (n,) [N m].
        """
        if time_s - self._sent_at_s > _PAUSE_S:
            self.restart()
            self._begun_s = self._interval_s = time_s
        self._sent_at_s = time_s
        is_next = time_s - self._interval_s >= _LATE_S
        if is_next:
            self._interval_s = time_s
        for drive, torque in zip(self._drives, torque_nm, strict=True):
            drive.widen(torque, is_next=is_next)

    def problem(self, measurement: Measurement) -> Problem | None:
        """Check one tick; a repeated sample is ignored.

        Args:
            measurement: measurement of this tick.

        Returns:
            The problem of the first drive that has not obeyed for `unresponsive_drive_s`, or None.
        """
        sampled_at_s = measurement.torque_at_s
        if not (sampled_at_s > self._sampled_at_s and sampled_at_s - self._sent_at_s <= _PAUSE_S):
            return None
        dt_s = min(sampled_at_s - self._sampled_at_s, _PAUSE_S)
        self._sampled_at_s = sampled_at_s
        is_first = sampled_at_s - self._begun_s < _FIRST_S
        share = dt_s / (dt_s + (_FIRST_HABIT_S if is_first else _HABIT_S))
        torques_nm = measurement.joint_torque_nm.tolist()
        are_bounds = measurement.torque_saturated or (False,) * len(torques_nm)
        drives = zip(self._drives, torques_nm, are_bounds, strict=True)
        for joint, (drive, measured_nm, is_bound) in enumerate(drives, 1):
            drive.shows(measured_nm, sampled_at_s)
            if not is_first and sampled_at_s - drive.changed_at_s >= self._time_s and drive.is_frozen():
                low_nm, high_nm = drive.expected_nm
                return Problem(
                    f"joint {joint}: its measured torque is stuck at {measured_nm:.2f} N m while "
                    f"{low_nm:.2f} to {high_nm:.2f} N m were sent",
                    _DRIVE_REMEDY,
                )
            if is_first or not drive.is_missing(sampled_at_s, is_bound=is_bound):
                drive.count, drive.obeyed_at_s = 0, sampled_at_s
                off_nm = measured_nm - clip(measured_nm, drive.low_nm, drive.high_nm)
                drive.usually_off_nm += (off_nm - drive.usually_off_nm) * share
                continue
            drive.count += 1
            if drive.count >= _DISOBEYED_SAMPLES and sampled_at_s - drive.obeyed_at_s >= self._time_s - 1e-9:
                return Problem(
                    f"joint {joint}: its drive exerts {measured_nm:.2f} N m although "
                    f"{drive.least_sent_nm:.2f} N m was sent; the drive may have restarted, or left its "
                    "torque mode",
                    _DRIVE_REMEDY,
                )
        return None
