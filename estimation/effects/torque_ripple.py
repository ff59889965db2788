"""Torque ripple: effort that varies periodically with the angle."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from palpate.estimation.channel import JOINTS, ChannelData
from palpate.estimation.effect import AdditiveEffect, Inner, Parameter, start_grid
from palpate.estimation.kinds import Kind
from palpate.estimation.signals.periodicity import harmonics
from palpate.robot_io.types import FloatArray

_LEAST_WAVES = 1.5  # least number of waves within the range of motion; fewer could be any curve
_AT_ONCE = 4096  # samples per batch, so that the waves stay in the processor's cache


class TorqueRipple(AdditiveEffect):
    """effort = sum_m s_m sin(m n q) + c_m cos(m n q): one wave, or a wave with harmonics.

    `suited_to` finds n and the harmonics m in the part of the effort that the motion does not explain, see
    `harmonics`. The cogging of a motor has several harmonics.

    Args:
        multiples: harmonics m, ascending; gains of m = 1 are named sine and cosine, others sine_m and
            cosine_m.
        cycles: additional start value of n [1/rad or 1/m].
    """

    name = "torque_ripple"
    kind = Kind.PERIODIC
    physics = "Magnets, teeth and gear errors make effort rise and fall n times per turn."
    equation = "effort = sum_m s_m sin(m n q) + c_m cos(m n q)"
    source = (
        "J. Holtz, L. Springob, IEEE Trans. Industrial Electronics 43 (1996); Z. Q. Zhu, D. Howe, IEEE "
        "Trans. Energy Conversion 15 (2000): cogging"
    )
    signature = "effort varies periodically with position, equally at any speed and in both directions"
    signals = ("position",)
    channels = JOINTS
    gains: ClassVar[tuple[Parameter, ...]] = (
        Parameter("sine", "{effort}", -1e12, 1e12, (0.001, 5.0)),
        Parameter("cosine", "{effort}", -1e12, 1e12, (0.001, 5.0)),
    )
    inner = (Parameter("cycles", "1/{position}", 0.05, 100000.0, (2.0, 100.0)),)
    confused_with = {
        "joint_spring": "move over a wide range: ripple repeats, but a spring does not",
        "gravity_tilt": "move over a wide range: gravity repeats once per turn, but ripple more often",
        "position_dependent_friction": (
            "compare both directions: ripple keeps its sign, but friction does not"
        ),
        "run_ripple": "go to the same stop before each run: then the wave always begins at the same place",
    }

    def __init__(self, multiples: tuple[int, ...] = (1,), cycles: float | None = None) -> None:
        self._multiples, self._cycles = np.array(multiples, dtype=np.float64), cycles
        if multiples != (1,):
            sine = TorqueRipple.gains[0]
            self.gains = tuple(  # type: ignore[misc]  # how many there are depends on the data
                Parameter(f"{wave}_{m}" if m > 1 else wave, sine.unit, sine.lower, sine.upper, sine.typical)
                for wave in ("sine", "cosine")
                for m in multiples
            )

    def columns(self, data: ChannelData, inner: Inner) -> FloatArray:
        """See `AdditiveEffect.columns`; shape (n, 2 len(multiples))."""
        count, angle = len(self._multiples), inner["cycles"] * data.position
        seen = inner["cycles"] * self._multiples * np.ptp(data.position) >= _LEAST_WAVES * 2.0 * np.pi
        columns, multiples = np.zeros((2 * count, len(data))), self._multiples.astype(int).tolist()
        for first in range(0, len(data), _AT_ONCE):
            rows = slice(first, first + _AT_ONCE)
            powers = {1: np.cos(angle[rows]) + 1j * np.sin(angle[rows])}
            for number in np.flatnonzero(seen).tolist():
                wave = _power(powers, multiples[number])
                columns[number, rows], columns[count + number, rows] = wave.imag, wave.real
        return columns.T

    def suited_to(self, data: ChannelData) -> "TorqueRipple":
        cycles, multiples = harmonics(data)
        return TorqueRipple(multiples, cycles) if multiples else self

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: values near `cycles`; for a single wave also a fine grid of wave numbers."""
        span = data.range_of_motion
        half_wave = np.pi / (span * self._multiples.max())  # half a wave of the shortest from end to end
        starts = (
            [] if self._cycles is None else [self._cycles + part * half_wave for part in (-0.5, 0.0, 0.5)]
        )
        waves = np.arange(2.0, 40.0, 0.4) if self._multiples.tolist() == [1.0] else ()
        return start_grid(cycles=(*starts, *(2.0 * np.pi / span * count for count in waves)))


def _power(powers: dict[int, NDArray[np.complex128]], exponent: int) -> NDArray[np.complex128]:
    """Compute a power by products of cached powers, which is faster than computing sines."""
    if exponent not in powers:
        half = exponent // 2
        powers[exponent] = _power(powers, half) * _power(powers, exponent - half)
    return powers[exponent]
