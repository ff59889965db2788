"""Clipping of single numbers."""


def clip(value: float, low: float, high: float) -> float:
    """Clip a number to bounds; several times as fast as numpy for the few numbers of an arm.

    Args:
        value: the number; NaN stays NaN.
        low: lower bound.
        high: upper bound.

    Returns:
        The clipped number.
    """
    return low if value < low else high if value > high else value
