"""Rounds to the steps of a converter."""

from collections.abc import Sequence


def quantise(values: Sequence[float], step: float) -> list[float]:
    """The multiples of `step` nearest to `values`, all in the same unit; a step of 0 changes nothing."""
    return [round(value / step) * step for value in values] if step else list(values)
