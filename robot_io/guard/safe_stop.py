"""Stop of a tripped arm: braking with its weight held up, then lowering at a limited speed."""

from collections.abc import Callable, Sequence
from math import inf, isfinite, sqrt

from robot_io.guard.limits import Limits, SafeState
from robot_io.types import FloatArray, Measurement

GravityModel = Callable[[FloatArray], FloatArray]
"""Joint positions (n,) [rad] to the torques (n,) [N m] that hold the arm still there."""

_MOST_SUPPORT = 1.25  # of the modelled weight: the arm may be heavier than its model, but not by more
_FADE_SHARE, _LAST_SHARE = 0.5, 0.25  # of the lowering time


class SafeStop:
    """Torques of a stop: damping, and support of the arm's weight while it is braked and lowered.

        tau = s g(q) - D v

    s is 1 while braking. Then it falls at a rate of (1 - u / u_set) / T, where u = -g.v / |g| is how fast the
    arm sinks: in the air the arm sinks at u_set, and on a support the torque fades in T, half of the lowering
    time. In the last quarter of that time the rest fades, wherever the arm is. Without a gravity model, or
    after an invalid value of it, s is 0.

    Braking is at most as strong as at the velocity limit, so that a wrong velocity cannot kick, and it is not
    rate-limited, so that a bad torque ends at once.

    Args:
        limits: of the arm.
        safe_state: damping and times.
        gravity_nm: gravity model, or None.

    Attributes:
        duration_s: time from the trip until the torque is to go off [s].
    """

    def __init__(self, limits: Limits, safe_state: SafeState, gravity_nm: GravityModel | None) -> None:
        self._brakes = tuple(
            zip(safe_state.damping_nms_rad, limits.velocity_rad_s, limits.torque_nm, strict=True)
        )
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
        """Compute the torques of one tick.

        Args:
            measurement: its joint positions and velocities are used, and must be known.
            trusted: for each joint whether its velocity can be braked against; else it counts as zero, shape
                (n,).
            stopping_s: time since the trip [s].
            dt_s: time since the last tick [s].

        Returns:
            Shape (n,), within the limits [N m].
        """
        velocities = [
            velocity if known else 0.0
            for velocity, known in zip(measurement.joint_velocity_rad_s.tolist(), trusted, strict=True)
        ]
        weights_nm = self._weights_nm(measurement.joint_position_rad)
        if stopping_s > self._brake_time_s:
            self._support = self._lowered(weights_nm, velocities, stopping_s, dt_s)
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
            except Exception:  # noqa: S110, whatever is wrong with the model: the stop goes on without
                pass
            self._gravity_nm = None
        return [0.0] * len(self._brakes)

    def _lowered(
        self, weights_nm: list[float], velocities_rad_s: list[float], stopping_s: float, dt_s: float
    ) -> float:
        """Compute the support s for this tick."""
        size_nm = sqrt(sum(weight * weight for weight in weights_nm))
        power_w = sum(weight * speed for weight, speed in zip(weights_nm, velocities_rad_s, strict=True))
        sinking_rad_s = -power_w / (size_nm or inf)
        rate = (1.0 - sinking_rad_s / self._sink_rad_s) / self._fade_s
        most = min(_MOST_SUPPORT, max(self.duration_s - stopping_s, 0.0) / self._last_s)
        return min(max(self._support - rate * dt_s, 0.0), most)
