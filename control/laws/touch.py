"""When a force is a touch: one rule for who controls and for who estimates."""

from control.laws.gains import TouchGains

_NOISE_FACTOR = 6.0  # standard deviations of the free-air force that are no noise any more


def touch_force_n(noise_n: float, least_n: float = 0.0) -> float:
    """Force above the free-air mean from which on there is contact [N].

    Args:
        noise_n: standard deviation of the force in free air [N].
        least_n: the touch force of a quieter sensor, see `TouchGains` [N].
    """
    return max(least_n, _NOISE_FACTOR * noise_n)


def release_force_n(touch_n: float, gains: TouchGains) -> float:
    """Force above the free-air mean below which a contact that began at `touch_n` is over [N]."""
    return gains.release_share * touch_n
