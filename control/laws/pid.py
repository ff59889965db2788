"""PID on every joint, with a filtered derivative and without windup."""

import numpy as np

from robot_io.clip import clip
from robot_io.errors import InputError
from robot_io.types import FloatArray


class Pid:
    """output = kp e + ki integral(e) + kd filtered(de/dt), limited.

    The derivative passes a first-order low-pass (backward Euler). The integral of a joint stands still while
    its output is limited and the error would drive it further (conditional integration). Astrom and Murray,
    "Feedback Systems", Princeton 2008, section 10.4.

    Args:
        joint_count: number of joints n.
        kp: proportional gain [output/rad].
        ki: integral gain [output/(rad s)].
        kd: derivative gain [output s/rad].
        output_limit: largest output either way.
        derivative_filter_s: time constant of the low-pass, 0 for none [s].

    Raises:
        InputError: a gain is negative or the limit is not positive.
    """

    def __init__(
        self,
        joint_count: int,
        *,
        kp: float,
        ki: float,
        kd: float,
        output_limit: float,
        derivative_filter_s: float = 0.0,
    ) -> None:
        if min(kp, ki, kd, derivative_filter_s) < 0.0 or not output_limit > 0.0:
            raise InputError(
                f"PID: gains {kp}, {ki}, {kd} and filter {derivative_filter_s} s must not be negative, "
                f"output limit {output_limit} must be positive"
            )
        self._kp, self._ki, self._kd = kp, ki, kd
        self._limit = output_limit
        self._filter_s = derivative_filter_s
        self._joint_count = joint_count
        self.reset()

    @property
    def integral(self) -> FloatArray:
        """The integral part of the output, shape (n,)."""
        return np.array(self._integral)

    def reset(self) -> None:
        """Forget the past."""
        self._integral = [0.0] * self._joint_count  # times ki, so that a change of gain makes no bump
        self._rate = [0.0] * self._joint_count

    def step(self, error_rad: FloatArray, error_rate_rad_s: FloatArray, dt_s: float) -> FloatArray:
        """Output, shape (n,).

        Args:
            error_rad: reference minus measured, shape (n,) [rad].
            error_rate_rad_s: its rate from the devices' own velocities, shape (n,) [rad/s].
            dt_s: time since the last step [s].
        """
        followed = dt_s / (dt_s + self._filter_s)
        output: list[float] = []  # joint by joint: for a few of them several times as fast as arrays
        errors = zip(error_rad.tolist(), error_rate_rad_s.tolist(), strict=True)
        for joint, (error, error_rate) in enumerate(errors):
            self._rate[joint] += (error_rate - self._rate[joint]) * followed
            growth = error * (self._ki * dt_s)
            wanted = self._kp * error + self._kd * self._rate[joint] + self._integral[joint] + growth
            allowed = clip(wanted, -self._limit, self._limit)
            if not (wanted - allowed) * growth > 0.0:
                self._integral[joint] += growth
            output.append(allowed)
        return np.array(output)
