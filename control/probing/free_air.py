"""Whether what the force sensor says in free air leaves a force limit its meaning."""

from control.laws.gains import TouchGains


def free_air_problem(force_n: float, touch_n: float, force_limit_n: float, gains: TouchGains) -> str | None:
    """What is wrong, and what can be done about it; None if nothing is.

    A force in free air is tared away: if an object made it, all forces on it are larger by as much. And
    nothing is noticed of an object before the touch.

    Args:
        force_n: in free air, as the sensor says [N].
        touch_n: from which on above it there is contact, see `control.laws.touch` [N].
        force_limit_n: of the plan [N].
        gains: how much of that each may be.
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
