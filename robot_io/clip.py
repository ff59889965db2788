"""One number held within bounds."""


def clip(value: float, low: float, high: float) -> float:
    """The value, or the bound that it lies beyond; NaN stays NaN.

    Several times as fast as numpy's for the few numbers of an arm.
    """
    return low if value < low else high if value > high else value
