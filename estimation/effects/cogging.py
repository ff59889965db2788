"""Ripple with several harmonics a turn."""

from typing import ClassVar

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import AdditiveEffect, Inner, Parameter
from estimation.signals.harmonics import harmonics
from robot_io.types import FloatArray

_FIRST = (1, 2, 3)


class Cogging(AdditiveEffect):
    """effort = sum_m s_m sin(m n q) + c_m cos(m n q) over the multiples m that the data shows.

    `suited_to` finds n and the multiples in what the motion leaves of the effort, see `harmonics`.

    Args:
        multiples: m, ascending.
        cycles: where the search for n begins; None for the motion's own range.
    """

    name = "cogging"
    physics = "Magnets against slots pull the rotor at many multiples of a turn at once."
    equation = "effort = sum_m s_m sin(m n q) + c_m cos(m n q)"
    source = "Z. Q. Zhu, D. Howe, IEEE Trans. Energy Conversion 15 (2000): cogging torque in PM machines"
    signature = "a pattern over position that repeats, the same at any speed and in either direction"
    signals = ("position",)
    channels = frozenset({ChannelKind.REVOLUTE, ChannelKind.PRISMATIC})
    inner = (Parameter("cycles", "1/{position}", 0.05, 1e5, (0.5, 10.0), log=True),)
    confused_with: ClassVar[dict[str, str]] = {
        "torque_ripple": "move over a wide range: a single wave has no other multiples",
        "weight": "move over several turns: weight has one wave a turn",
        "position_dependent_friction": "compare both directions: cogging has one sign in both",
    }

    def __init__(self, multiples: tuple[int, ...] = _FIRST, cycles: float | None = None) -> None:
        self._multiples, self._cycles = np.array(multiples, dtype=np.float64), cycles
        self.gains = tuple(  # type: ignore[misc]  # how many there are depends on the data
            Parameter(f"{wave}_{m}", "{effort}", -10000.0, 10000.0, (0.001, 5.0))
            for wave in ("sine", "cosine")
            for m in multiples
        )

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 2 len(multiples))."""
        angle = inner["cycles"] * np.multiply.outer(data.position, self._multiples)
        return np.hstack([np.sin(angle), np.cos(angle)])

    def suited_to(self, data: ChannelData) -> "Cogging":
        """See `Effect.suited_to`."""
        cycles, multiples = harmonics(data)
        return Cogging(multiples, cycles) if multiples else self

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: closely about what was found, or with two to twenty waves within the range."""
        if self._cycles is not None:
            span = float(np.ptp(data.position)) or 1.0
            off = 0.5 / (span * self._multiples.max())
            return tuple({"cycles": float(self._cycles + part * off)} for part in (-1.0, -0.5, 0.0, 0.5, 1.0))
        span = float(np.ptp(data.position)) or 1.0
        return tuple({"cycles": float(waves * 2.0 * np.pi / span)} for waves in np.arange(2.0, 20.0, 0.4))
