"""Says what is wrong with a measurement, in words. Every comparison is written so that NaN fails it.

Plain floats instead of arrays: for a few joints that is several times faster, and this runs in every tick.
"""

from math import inf, isfinite

from robot_io.guard.limits import Limits, Problem
from robot_io.types import FloatArray, Measurement, Status

_EXAMINE = "check its cable and its supply; palpate doctor examines it"
_LATE = "check cable and supply; palpate doctor shows what rates the buses can carry"
_END_OF_RANGE = "palpate doctor shows the ranges; does the robot file say what the device is?"
_LAGS = "is it blocked, too heavily loaded, or weaker than the robot file says? See palpate doctor --move"
_OUTSIDE = "bring it back by hand; if it may go there, widen limits.position_min_rad and position_max_rad"
_TOO_FAST = "plan slower moves; if it may go as fast, raise limits.velocity_rad_s"
_TOO_STRONG = "press less or more slowly; if arm and sensor bear it, raise limits.force_n"


class LimitChecks:
    """The limits of one arm, ready to be held against measurements."""

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
        """The first thing that is wrong, or None."""
        return self._sample_problem(measurement) or self._value_problem(measurement)

    def too_old(self, measurement: Measurement) -> tuple[str, ...]:
        """A line for each device without a sample that is young enough, whatever the sample says."""
        time_s, ok = measurement.time_s, Status.OK
        problems = (
            _sample_problem("encoder", ok, time_s - measurement.encoder_at_s, self._encoder_age_s),
            _sample_problem("force sensor", ok, time_s - measurement.force_at_s, self._force_age_s),
            _sample_problem("drives", ok, time_s - measurement.torque_at_s, self._torque_age_s),
        )
        return tuple(problem.text for problem in problems if problem)

    def motion_is_known(self, measurement: Measurement) -> bool:
        """Whether position and velocity can still be acted on, wherever they are."""
        values = measurement.joint_velocity_rad_s.tolist() + measurement.joint_position_rad.tolist()
        age_s = measurement.time_s - measurement.encoder_at_s
        problem = _sample_problem("encoder", measurement.encoder_status, age_s, self._encoder_age_s)
        return problem is None and all(map(isfinite, values))

    def tracking_problem(
        self, measurement: Measurement, reference_position_rad: FloatArray
    ) -> Problem | None:
        """The first joint that is too far from its reference, or None."""
        for (joint, limit), position, reference in zip(
            self._tracking_limits,
            measurement.joint_position_rad.tolist(),
            reference_position_rad.tolist(),
            strict=True,
        ):
            distance = abs(position - reference)
            if not distance <= limit:
                return Problem(
                    f"joint {joint} is {distance:.4g} rad from its reference, limit {limit:.4g} rad", _LAGS
                )
        return None

    def _sample_problem(self, measurement: Measurement) -> Problem | None:
        time_s = measurement.time_s
        return (
            _sample_problem(
                "encoder", measurement.encoder_status, time_s - measurement.encoder_at_s, self._encoder_age_s
            )
            or _sample_problem(
                "force sensor", measurement.force_status, time_s - measurement.force_at_s, self._force_age_s
            )
            # A drive at the end of its range is no reason to stop: what it may send is limited anyway.
            or _sample_problem(
                "drives",
                Status.OK if measurement.torque_status is Status.SATURATED else measurement.torque_status,
                time_s - measurement.torque_at_s,
                self._torque_age_s,
            )
        )

    def _value_problem(self, measurement: Measurement) -> Problem | None:
        for (joint, low, high, fastest), position, velocity in zip(
            self._motion_limits,
            measurement.joint_position_rad.tolist(),
            measurement.joint_velocity_rad_s.tolist(),
            strict=True,
        ):
            if not low <= position <= high:
                return Problem(
                    f"joint {joint} is at {position:.4g} rad, limits {low:.4g} to {high:.4g} rad", _OUTSIDE
                )
            if not -fastest <= velocity <= fastest:
                return Problem(
                    f"joint {joint} moves at {velocity:.4g} rad/s, limit {fastest:.4g} rad/s", _TOO_FAST
                )
        for torque in measurement.joint_torque_nm.tolist():
            if not -inf < torque < inf:
                return Problem(f"a measured torque is {torque} N m")
        force_n = measurement.force_n
        if not -self._force_n <= force_n <= self._force_n:
            return Problem(f"the contact force is {force_n:.4g} N, limit {self._force_n:.4g} N", _TOO_STRONG)
        return None


def _sample_problem(device: str, status: Status, age_s: float, oldest_s: float) -> Problem | None:
    if status is Status.FAULT:
        return Problem(f"{device}: reports a fault, or its bus has failed", _EXAMINE)
    if status is Status.SATURATED:
        return Problem(f"{device}: at the end of its range", _END_OF_RANGE)
    # Younger than the start of the tick is no fault: the robot judges against the end of its reading.
    if -inf < age_s <= oldest_s:
        return None
    if age_s == inf:
        return Problem(f"{device}: no sample yet", _EXAMINE)
    return Problem(f"{device}: newest sample is {age_s:.4g} s old, limit {oldest_s:.4g} s", _LATE)
