"""Rounds to the steps of a converter."""


def quantise(value: float, step: float) -> float:
    """The multiple of `step` nearest to `value`, both in the same unit; a step of 0 changes nothing."""
    return round(value / step) * step if step else value
