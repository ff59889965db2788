"""Limits of an arm, and the checks of a measurement against them."""

from collections.abc import Mapping
from math import inf, isfinite
from typing import Annotated, NamedTuple

from pydantic import Field, model_validator

from palpate.robot_io.files.file_model import FileModel, NotNegative, Number, Positive
from palpate.robot_io.types import FloatArray, Measurement, Status

# Bounds beyond any arm that this guard is for: a limit past them would be no limit.
Position = Annotated[Number, Field(ge=-100.0, le=100.0)]
Torque = Annotated[Positive, Field(le=1e4)]
TorqueRate = Annotated[Positive, Field(le=1e7)]
Speed = Annotated[Positive, Field(le=100.0)]
Distance = Annotated[Positive, Field(le=2.0)]
Force = Annotated[Positive, Field(le=5000.0)]
Age = Annotated[Positive, Field(le=10.0)]
FaultDuration = Annotated[Positive, Field(le=10.0)]


class Limits(FileModel):
    """Limits of one arm; a list holds one value per joint."""

    # Largest torque that is sent; commands are clipped to it [N m].
    torque_nm: Annotated[tuple[Torque, ...], Field(min_length=1)]
    torque_rate_nm_s: tuple[TorqueRate, ...]  # largest change of torque; commands are clipped to it [N m/s]
    position_min_rad: tuple[Position, ...]  # lowest position before a trip [rad]
    position_max_rad: tuple[Position, ...]  # highest position before a trip [rad]
    velocity_rad_s: tuple[Speed, ...]  # largest speed before a trip, either way [rad/s]
    force_n: Force  # largest contact force before a trip, push or pull [N]
    tracking_rad: tuple[Distance, ...]  # largest distance from the reference before a trip [rad]
    encoder_age_s: Age  # oldest position and velocity that are still acted on [s]
    torque_age_s: Age  # oldest measured torque that is still acted on [s]
    force_age_s: Age  # oldest force that is still acted on [s]
    # How long a drive may measure less than half of any recently sent torque [s].
    unresponsive_drive_s: FaultDuration = 0.01
    # How long an encoder may be constant while its reference and its drive's torque change [s].
    stuck_encoder_s: FaultDuration = 0.02
    # How long a force sensor that never did so before may repeat one value while the arm moves [s].
    stuck_force_s: FaultDuration = 0.02

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return len(self.torque_nm)

    @model_validator(mode="before")
    @classmethod
    def _accept_former_key(cls, data: object) -> object:
        if isinstance(data, Mapping) and "deaf_drive_s" in data:
            data = dict(data)
            data = {"unresponsive_drive_s": data.pop("deaf_drive_s")} | data
        return data

    @model_validator(mode="after")
    def _check_consistency(self) -> "Limits":
        names = ("torque_rate_nm_s", "position_min_rad", "position_max_rad", "velocity_rad_s", "tracking_rad")
        for name in names:
            count = len(getattr(self, name))
            if count != self.joint_count:
                raise ValueError(
                    f"{name} has {count} values, but torque_nm has {self.joint_count}; give one per joint"
                )
        ranges_rad = zip(self.position_min_rad, self.position_max_rad, strict=True)
        for joint, (low, high) in enumerate(ranges_rad, 1):
            if low >= high:
                raise ValueError(
                    f"position_min_rad {low} is not below position_max_rad {high} of joint {joint}"
                )
        return self


class SafeState(FileModel):
    """Settings of a safe stop: the arm is braked, then lowered, then the torque is switched off.

    Braking is torque = -damping * velocity, with the arm's weight held up. Keep damping * (tick + age of the
    velocity) below the smallest inertia that the joint moves; from twice that on, the brake itself would
    shake the arm. For an arm with brakes `lower_time_s` can be 0.
    """

    # One value per joint [N m s/rad]; 0 lets a joint go at once.
    damping_nms_rad: Annotated[tuple[NotNegative, ...], Field(min_length=1)]
    stop_time_s: Annotated[NotNegative, Field(le=10)]  # time from the trip for braking [s]
    # Time after it in which the arm sinks, until the torque goes off [s].
    lower_time_s: Annotated[NotNegative, Field(le=10)] = 3.0
    lower_speed_rad_s: Annotated[Positive, Field(le=2.0)] = 0.3  # speed of this lowering [rad/s]


class Problem(NamedTuple):
    """One reason to stop."""

    text: str  # one sentence without its full stop: what is wrong, where, and by how much
    # What the user can do; empty if nothing is known.
    remedy: str = ""


_EXAMINE = "check the device's cable and supply; palpate doctor examines the device"
_LATE = "check cable and supply; palpate doctor shows what rates the buses can carry"
_END_OF_RANGE = "palpate doctor shows the ranges; check that the robot file describes this device"
_LAGS = "is the joint blocked, loaded too much, or weaker than in the robot file? Run palpate doctor --move"
_OUTSIDE = (
    "move the joint back by hand; if it may go there, widen limits.position_min_rad and position_max_rad"
)
_TOO_FAST = "plan slower moves; if the joint may move this fast, raise limits.velocity_rad_s"
_TOO_STRONG = "press with less force, or more slowly; if arm and sensor can carry more, raise limits.force_n"


class LimitChecks:
    """Checks of measurements against the limits of one arm.

    Every comparison is written so that NaN fails it. Plain floats are several times faster than arrays for a
    few joints, and this runs in every tick.
    """

    def __init__(self, limits: Limits) -> None:
        joints = range(1, limits.joint_count + 1)
        self._motion_limits = tuple(
            zip(joints, limits.position_min_rad, limits.position_max_rad, limits.velocity_rad_s, strict=True)
        )
        self._tracking_limits = tuple(zip(joints, limits.tracking_rad, strict=True))
        self._force_n = limits.force_n
        self._encoder_age_s = limits.encoder_age_s
        self._torque_age_s = limits.torque_age_s
        self._force_age_s = limits.force_age_s

    def violation(self, measurement: Measurement) -> Problem | None:
        """Find the first problem of a measurement; None without one.

        Status and age of the samples come first, then positions and velocities joint by joint, torques, and
        force.

        Args:
            measurement: newest samples of encoders, drives and force sensor; a value of NaN is a problem.
        """
        time_s = measurement.time_s
        problem = (
            _sample_problem(
                "encoder", measurement.encoder_status, time_s - measurement.encoder_at_s, self._encoder_age_s
            )
            or _sample_problem(
                "force sensor", measurement.force_status, time_s - measurement.force_at_s, self._force_age_s
            )
            # A drive at the end of its range is no reason to stop, because its commands are limited anyway.
            or _sample_problem(
                "drives",
                Status.OK if measurement.torque_status is Status.SATURATED else measurement.torque_status,
                time_s - measurement.torque_at_s,
                self._torque_age_s,
            )
        )
        if problem is not None:
            return problem
        positions = measurement.joint_position_rad.tolist()
        velocities = measurement.joint_velocity_rad_s.tolist()
        for (joint, low, high, fastest), position, velocity in zip(
            self._motion_limits, positions, velocities, strict=True
        ):
            if not low <= position <= high:
                limits = f"limits {low:.4g} to {high:.4g} rad"
                return Problem(f"joint {joint} is at {position:.4g} rad, {limits}", _OUTSIDE)
            if not -fastest <= velocity <= fastest:
                limit = f"limit {fastest:.4g} rad/s"
                return Problem(f"joint {joint} moves at {velocity:.4g} rad/s, {limit}", _TOO_FAST)
        for joint, torque in enumerate(measurement.joint_torque_nm.tolist(), 1):
            if not -inf < torque < inf:
                return Problem(f"joint {joint}: its measured torque is {torque} N m, not finite")
        force_n = measurement.force_n
        if not -self._force_n <= force_n <= self._force_n:
            return Problem(f"the contact force is {force_n:.4g} N, limit {self._force_n:.4g} N", _TOO_STRONG)
        return None

    def too_old(self, measurement: Measurement) -> tuple[str, ...]:
        """Describe each device without a recent enough sample in one line, whatever the sample holds.

        Args:
            measurement: measurement to check.
        """
        time_s, ok = measurement.time_s, Status.OK
        problems = (
            _sample_problem("encoder", ok, time_s - measurement.encoder_at_s, self._encoder_age_s),
            _sample_problem("force sensor", ok, time_s - measurement.force_at_s, self._force_age_s),
            _sample_problem("drives", ok, time_s - measurement.torque_at_s, self._torque_age_s),
        )
        return tuple(problem.text for problem in problems if problem)

    def motion_is_known(self, measurement: Measurement) -> bool:
        """Return whether position and velocity are recent, healthy and finite, wherever they are.

        Args:
            measurement: measurement to check.
        """
        values = measurement.joint_velocity_rad_s.tolist() + measurement.joint_position_rad.tolist()
        age_s = measurement.time_s - measurement.encoder_at_s
        problem = _sample_problem("encoder", measurement.encoder_status, age_s, self._encoder_age_s)
        return problem is None and all(map(isfinite, values))

    def tracking_problem(self, measurement: Measurement, reference_rad: FloatArray) -> Problem | None:
        """Find the first joint that is too far from its reference.

        Args:
            measurement: measurement to check.
            reference_rad: shape (n,) [rad].
        """
        positions, references = measurement.joint_position_rad.tolist(), reference_rad.tolist()
        for (joint, limit), position, reference in zip(
            self._tracking_limits, positions, references, strict=True
        ):
            distance = abs(position - reference)
            if not distance <= limit:
                return Problem(
                    f"joint {joint} is {distance:.4g} rad off its reference, limit {limit:.4g} rad", _LAGS
                )
        return None


def _sample_problem(device: str, status: Status, age_s: float, oldest_s: float) -> Problem | None:
    # A sample newer than the start of the tick is no fault, because the robot checks ages after reading.
    is_recent = -inf < age_s <= oldest_s
    if is_recent and status <= Status.STALE:  # as in most ticks
        return None
    if status is Status.FAULT:
        return Problem(f"{device}: reports a fault, or its bus has failed", _EXAMINE)
    if status is Status.SATURATED:
        return Problem(f"{device}: at the end of its range", _END_OF_RANGE)
    if age_s == inf:
        return Problem(f"{device}: no sample yet", _EXAMINE)
    return Problem(f"{device}: newest sample is {age_s:.4g} s old, limit {oldest_s:.4g} s", _LATE)
