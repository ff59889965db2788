"""Contact detection: one rule for control and for estimation."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palpate.control.laws.gains import TouchGains


_NOISE_FACTOR = 6.0  # standard deviations of the free-air force that count as contact


def touch_force_n(noise_n: float, least_n: float = 0.0) -> float:
    """Compute the force above the free-air mean from which contact is detected [N].

    Args:
        noise_n: standard deviation of the force in free air [N].
        least_n: touch force of a quieter sensor, see `TouchGains` [N].
    """
    return max(least_n, _NOISE_FACTOR * noise_n)


def release_force_n(touch_n: float, gains: "TouchGains") -> float:
    """Compute the force above the free-air mean below which contact ends [N].

    Args:
        touch_n: touch force [N].
        gains: gains with the share of the touch force.
    """
    return gains.release_share * touch_n


def free_air_problem(force_n: float, touch_n: float, force_limit_n: float, gains: "TouchGains") -> str | None:
    """Describe why no object can be probed with this free-air force, with a remedy; None if one can.

    The force in free air is tared. If an object causes it, all later forces have this error. An object below
    the touch force is not detected.

    Args:
        force_n: mean force in free air [N].
        touch_n: touch force above it [N].
        force_limit_n: force limit of the plan [N].
        gains: gains, with the allowed shares of the force limit.
    """
    limit = f"force_limit_n {force_limit_n:g} N"
    limit_n = gains.bias_share * force_limit_n
    if not abs(force_n) <= limit_n:
        return (
            f"the force in free air is {force_n:.3g} N; with {limit}, at most {limit_n:.3g} N is allowed; "
            "does the tool touch something? If not, tare the force sensor, or raise gains.touch.bias_share "
            "in the robot file"
        )
    limit_n = gains.limit_share * force_limit_n
    if not touch_n <= limit_n:
        return (
            f"a touch would be detected only above {touch_n:.3g} N; with {limit}, at most {limit_n:.3g} N is "
            "allowed; reduce the sensor's noise, lower gains.touch.touch_force_n in the robot file, or raise "
            f"force_limit_n to {touch_n / gains.limit_share:.3g} N"
        )
    return None


@dataclass
class RunningMean:
    """Mean and standard deviation by Welford's recursion (Technometrics 4(3), 1962)."""

    count: int = 0
    mean: float = 0.0
    _squares: float = 0.0

    def add(self, value: float) -> None:
        """Add one sample."""
        self.count += 1
        deviation = value - self.mean
        self.mean += deviation / self.count
        self._squares += deviation * (value - self.mean)

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of the samples so far; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0
