"""When a force is a touch: one rule for who controls and for who estimates."""

import math
from dataclasses import dataclass

from control.laws.gains import TouchGains

_NOISE_FACTOR = 6.0  # standard deviations of the free-air force that are no noise any more


def touch_force_n(noise_n: float, least_n: float = 0.0) -> float:
    """Force above the free-air mean from which on there is contact [N], for noise of this standard deviation.

    `least_n` is the touch force of a quieter sensor, see `TouchGains` [N].
    """
    return max(least_n, _NOISE_FACTOR * noise_n)


def release_force_n(touch_n: float, gains: TouchGains) -> float:
    """Force above the free-air mean below which a contact that began at `touch_n` is over [N]."""
    return gains.release_share * touch_n


def free_air_problem(force_n: float, touch_n: float, force_limit_n: float, gains: TouchGains) -> str | None:
    """What is wrong, and what can be done about it; None if nothing is.

    A force in free air is tared away: if an object made it, all forces on it are larger by as much. And
    nothing is noticed of an object before the touch, `touch_n` above it [N].
    """
    limit = f"force_limit_n {force_limit_n:g} N"
    most_n = gains.bias_share * force_limit_n
    if not abs(force_n) <= most_n:
        return (
            f"{force_n:.3g} N in free air, with {limit} at most {most_n:.3g} N: is the tool touched? "
            "If not, tare the force sensor, or allow more (gains.touch.bias_share in the robot file)"
        )
    most_n = gains.limit_share * force_limit_n
    if not touch_n <= most_n:
        return (
            f"a touch counts from {touch_n:.3g} N on, with {limit} at most {most_n:.3g} N: the sensor is "
            "too noisy (or gains.touch.touch_force_n of the robot file too high); a force_limit_n of "
            f"{touch_n / gains.limit_share:.3g} N is enough"
        )
    return None


@dataclass
class RunningMean:
    """Welford's recursion, which keeps its digits when the mean is large (Technometrics 4(3), 1962)."""

    count: int = 0
    mean: float = 0.0
    _squares: float = 0.0

    def add(self, value: float) -> None:
        """Take in one sample."""
        self.count += 1
        before = value - self.mean
        self.mean += before / self.count
        self._squares += before * (value - self.mean)

    @property
    def standard_deviation(self) -> float:
        """Of the samples so far; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0
