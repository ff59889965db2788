"""The guard: trips are latched; the safe stop lowers the arm, then the torque is off."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan, sqrt

import numpy as np

from palpate.robot_io.errors import InputError, SafetyTripError
from palpate.robot_io.guard.limits import LimitChecks, Limits, Problem, SafeState
from palpate.robot_io.guard.plausibility import StuckEncoders, StuckForce, UnresponsiveDrives
from palpate.robot_io.types import Command, FloatArray, Measurement, clip

GravityModel = Callable[[FloatArray], FloatArray]
"""Joint positions (n,) [rad] to the torques (n,) [N m] that hold the arm still there."""

_MOST_SUPPORT = 1.25  # multiple of the modeled weight: the arm may be heavier than its model, but not by more
_FADE_SHARE = 0.5  # share of the lowering time in which the torque fades on a support
_LAST_SHARE = 0.25  # share of the lowering time, at its end, in which the rest fades anywhere


class SafeStop:
    """Torques of a stop: damping, and support of the arm's weight while it is braked and lowered.

        tau = s g(q) - D v

    s is 1 while braking. Then it falls at a rate of (1 - u / u_set) / T, where u = -g.v / |g| is how fast the
    arm sinks: in the air the arm sinks at u_set, and on a support the torque fades in T, half of the lowering
    time. In the last quarter of that time the rest fades, wherever the arm is. Without a gravity model, or
    after an invalid value of it, s is 0.

    The braking torque is limited to its value at the velocity limit, so that a wrong velocity causes no jerk.
    It is not rate-limited, so that a wrong torque ends at once.

    Attributes:
        duration_s: time from the trip until the torque must go off [s].
    """

    def __init__(self, limits: Limits, safe_state: SafeState, gravity_nm: GravityModel | None) -> None:
        damping_nms_rad = safe_state.damping_nms_rad
        self._brakes = tuple(zip(damping_nms_rad, limits.velocity_rad_s, limits.torque_nm, strict=True))
        self._brake_time_s = safe_state.stop_time_s
        self._fade_s = _FADE_SHARE * safe_state.lower_time_s
        self._last_s = _LAST_SHARE * safe_state.lower_time_s
        self._sink_rad_s = safe_state.lower_speed_rad_s
        self._model = gravity_nm
        self.duration_s = safe_state.stop_time_s + (safe_state.lower_time_s if gravity_nm else 0.0)

    def restart(self) -> None:
        """Begin a stop; to be called before each stop, the first included."""
        self._gravity_nm = self._model
        self._support = 1.0

    def torque_nm(
        self, measurement: Measurement, trusted: Sequence[bool], stopping_s: float, dt_s: float
    ) -> list[float]:
        """Compute the torques of one tick, shape (n,), within the limits [N m].

        Args:
            measurement: measurement with valid joint positions and velocities.
            trusted: for each joint whether its velocity is usable for braking; else it counts as zero, shape
                (n,).
            stopping_s: time since the trip [s].
            dt_s: time since the last tick [s].
        """
        pairs = zip(measurement.joint_velocity_rad_s.tolist(), trusted, strict=True)
        velocities = [velocity if is_trusted else 0.0 for velocity, is_trusted in pairs]
        weights_nm = self._weights_nm(measurement.joint_position_rad)
        if stopping_s > self._brake_time_s:
            # The support for this tick.
            size_nm = sqrt(sum(weight * weight for weight in weights_nm))
            power_w = sum(weight * speed for weight, speed in zip(weights_nm, velocities, strict=True))
            sinking_rad_s = -power_w / (size_nm or inf)
            rate = (1.0 - sinking_rad_s / self._sink_rad_s) / self._fade_s
            largest_support = min(_MOST_SUPPORT, max(self.duration_s - stopping_s, 0.0) / self._last_s)
            self._support = min(max(self._support - rate * dt_s, 0.0), largest_support)
        support = self._support
        return [
            min(max(support * weight - damping * min(max(velocity, -fastest), fastest), -largest), largest)
            for weight, velocity, (damping, fastest, largest) in zip(
                weights_nm, velocities, self._brakes, strict=True
            )
        ]

    def _weights_nm(self, position_rad: FloatArray) -> list[float]:
        """Compute the torques that hold the arm still; zeros without a valid gravity model."""
        if self._gravity_nm is not None:
            try:
                weights_nm: list[float] = self._gravity_nm(position_rad).tolist()
                if len(weights_nm) == len(self._brakes) and all(map(isfinite, weights_nm)):
                    return weights_nm
            except Exception:  # noqa: S110, whatever is wrong with the model: the stop continues without it
                pass
            self._gravity_nm = None
        return [0.0] * len(self._brakes)


# After a longer time without a command, the rate limit starts from the measured torque.
PAUSE_S = 0.1


@dataclass(frozen=True, slots=True)
class Trip:
    """Cause and time of a trip."""

    cause: str  # one sentence
    # Time of the measurement at which it happened, on the robot's clock [s]; NaN before the first.
    time_s: float
    tick: int  # number of that measurement, from 0; -1 before the first
    remedy: str = ""  # what its user can do about it; empty if nothing is known


class Guard:
    """Checks every measurement and limits or replaces every command.

    A trip stays until `rearm`. The arm is braked for `safe_state.stop_time_s`, with its weight held up if
    `gravity_nm` is given; then it is lowered for `safe_state.lower_time_s`; then the torque goes off. Without
    `gravity_nm` it goes off after braking, and an arm without brakes falls. Where position and velocity
    cannot be trusted there is nothing to brake against: the torque is zero.

    Args:
        gravity_nm: gives the torques that hold the arm still at joint positions, both shape (n,); called
            while stopping only.

    Attributes:
        longest_hold_up_s: longest time after its measurement for which a command is valid [s].

    Raises:
        InputError: the limits are for another number of joints.
    """

    def __init__(
        self, limits: Limits, safe_state: SafeState, joint_count: int, gravity_nm: GravityModel | None = None
    ) -> None:
        if limits.joint_count != joint_count or len(safe_state.damping_nms_rad) != joint_count:
            raise InputError(
                f"the arm has {joint_count} joints, but its limits have {limits.joint_count} "
                f"and its safe state {len(safe_state.damping_nms_rad)}"
            )
        self._checks = LimitChecks(limits)
        self.longest_hold_up_s = max(PAUSE_S, limits.encoder_age_s)
        self._stuck_encoders = StuckEncoders(limits)
        self._unresponsive_drives = UnresponsiveDrives(limits)
        self._stuck_force = StuckForce(limits.stuck_force_s)
        self._torque_limits = tuple(zip(limits.torque_nm, limits.torque_rate_nm_s, strict=True))
        self._safe_stop = SafeStop(limits, safe_state, gravity_nm)
        self._shape = (joint_count,)
        self._tick = -1
        self._watched: Measurement | None = None
        self._trip: Trip | None = None
        self._stopping_s = 0.0  # sum of the time steps since the trip
        self._finished = False
        self._previous_nm: list[float] = []  # torques of the last command [N m]
        self._previous_s = -inf  # time of the last command [s]

    @property
    def tripped(self) -> Trip | None:
        """The latched trip, or None."""
        return self._trip

    @property
    def finished(self) -> bool:
        """Whether the stop has ended: the torque is off."""
        return self._finished

    def too_old(self, measurement: Measurement) -> tuple[str, ...]:
        """Describe each device without a recent enough sample, one line each; never trips.

        Args:
            measurement: measurement to check.
        """
        return self._checks.too_old(measurement)

    def watch(self, measurement: Measurement, reference_position_rad: FloatArray | None = None) -> None:
        """Check one tick's measurement, and trip on a problem.

        The same measurement can be checked again, for instance once its reference is known.

        Args:
            measurement: measurement to check.
            reference_position_rad: where the joints should be, shape (n,) [rad]; None to skip the tracking
                checks.
        """
        problem = self._time_problem(measurement)
        if measurement is not self._watched:
            self._watched = measurement
            self._tick += 1
        if self._trip is not None:
            return
        # The last two find contradictions between samples that are each plausible.
        problem = (
            problem
            or self._checks.violation(measurement)
            or self._unresponsive_drives.problem(measurement)
            or self._stuck_force.problem(measurement)
        )
        if problem is None and reference_position_rad is not None:
            problem = self._stuck_encoders.problem(
                measurement, reference_position_rad
            ) or self._checks.tracking_problem(measurement, reference_position_rad)
        if problem is not None:
            self.trip(problem.text, problem.remedy)

    def trip(self, cause: str, remedy: str = "") -> Trip:
        """Latch a trip from outside, such as Ctrl-C or an exception; an earlier one stays.

        An encoder that is suspect at this time is named as well.

        Args:
            cause: one sentence.
            remedy: what the user can do.
        """
        if self._trip is None:
            suspicion = self._stuck_encoders.suspicion
            if suspicion and suspicion != cause:
                cause = f"{cause}; {suspicion}"
            self._trip = Trip(cause, self._watched.time_s if self._watched else nan, self._tick, remedy)
            self._safe_stop.restart()
        return self._trip

    def limit(self, command: Command, measurement: Measurement, dt_s: float) -> Command:
        """Limit a command, or replace it with the safe state once tripped; return what may be sent.

        Trips on a command that is not finite. A measurement that was not checked yet is checked first.

        Args:
            command: command of the controller.
            measurement: measurement of this tick.
            dt_s: time since the previous tick [s].
        """
        if measurement is not self._watched:
            self.watch(measurement)
        if self._trip is None:
            shape, text = command.joint_torque_nm.shape, ""
            if shape != self._shape:
                text = f"the controller's command has shape {shape}, expected {self._shape}"
            elif bad := [k for k in enumerate(command.joint_torque_nm.tolist(), 1) if not -inf < k[1] < inf]:
                text = f"the controller's torque for joint {bad[0][0]} is {bad[0][1]}"
            elif not 0 <= dt_s < inf:
                text = f"the time step is {dt_s} s"
            if text:
                self.trip(text)
        if self._trip is not None:
            return self._stop(measurement, dt_s)
        previous_nm = self._previous_nm
        if measurement.time_s - self._previous_s > PAUSE_S:
            measured_nm = zip(measurement.joint_torque_nm.tolist(), self._torque_limits, strict=True)
            previous_nm = [clip(torque, -largest, largest) for torque, (largest, _) in measured_nm]
        torques = zip(command.joint_torque_nm.tolist(), previous_nm, self._torque_limits, strict=True)
        sent_nm = [
            clip(clip(torque, -largest, largest), previous - rate * dt_s, previous + rate * dt_s)
            for torque, previous, (largest, rate) in torques
        ]
        self._previous_nm, self._previous_s = sent_nm, measurement.time_s
        self._unresponsive_drives.sent(measurement.time_s, sent_nm)
        return _command(sent_nm)

    def rearm(self, measurement: Measurement) -> None:
        """Let commands through again, starting from the measured state and torque.

        Args:
            measurement: measurement of this tick.

        Raises:
            SafetyTripError: the stop is not over, or a problem persists; the trip stays.
        """
        if self._trip is not None and not self._finished and self._clock_says_stopping(measurement):
            raise SafetyTripError(f"not re-armed: the arm is still being stopped ({self._trip.cause})")
        problem = self._time_problem(measurement) or self._checks.violation(measurement)
        if problem is not None:
            raise SafetyTripError(f"not re-armed: {problem.text}")
        self._trip = None
        self._finished = False
        self._stuck_encoders.restart()
        self._unresponsive_drives.restart()
        self._stuck_force.restart()
        self._stopping_s = 0.0
        self._watched = measurement
        self._previous_s = -inf

    def _time_problem(self, measurement: Measurement) -> Problem | None:
        last_s = self._watched.time_s if self._watched else -inf
        if measurement.time_s >= last_s:
            return None
        return Problem(f"time went from {last_s:.6f} s to {measurement.time_s:.6f} s")

    def _stop(self, measurement: Measurement, dt_s: float) -> Command:
        self._stopping_s += dt_s if dt_s > 0 else inf
        # The first of two clocks ends the stop, and so does NaN, because the time itself may be wrong.
        if not (self._stopping_s < self._safe_stop.duration_s and self._clock_says_stopping(measurement)):
            self._finished = True
        if self._finished or not self._checks.motion_is_known(measurement):
            return _command([0.0] * self._shape[0])
        trusted = self._stuck_encoders.trusted(measurement)
        return _command(self._safe_stop.torque_nm(measurement, trusted, self._stopping_s, dt_s))

    def _clock_says_stopping(self, measurement: Measurement) -> bool:
        return self._trip is not None and measurement.time_s - self._trip.time_s < self._safe_stop.duration_s


def _command(torque_nm: list[float]) -> Command:
    torque = np.array(torque_nm)
    torque.setflags(write=False)
    return Command(torque)
