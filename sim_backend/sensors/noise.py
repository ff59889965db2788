"""White Gaussian noise, drawn in blocks because one draw at a time costs more than a physics step."""

from collections.abc import Sequence

import numpy as np

_BLOCK = 1024


class GaussianNoise:
    """An endless row of independent N(0, std^2) numbers.

    Args:
        std: standard deviation, in the unit of the signal; zero gives zeros.
        generator: its own source of random numbers.
    """

    def __init__(self, std: float, generator: np.random.Generator) -> None:
        self._std = std
        self._generator = generator
        self._block: list[float] = []

    def added_to(self, signal: Sequence[float]) -> Sequence[float]:
        """The signal with the next of these numbers on each of its values."""
        if not self._std:
            return signal
        if len(self._block) < len(signal):
            self._block = self._generator.normal(0.0, self._std, _BLOCK).tolist() + self._block
        draw = self._block.pop
        return [value + draw() for value in signal]
