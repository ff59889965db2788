"""Persistent excitation: a profile that rides on the hold and separates stiffness from damping.

At one frequency w, force over displacement is k + j w c, so several frequencies show both. The profile only
takes force away: it lies between 0 and -2 amplitudes, so that the force limit stays the limit.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from robot_io.file_model import FileModel, Positive
from robot_io.types import FloatArray

_RAMP_SHARE = 0.15  # of the duration, for fading in and out
_PEAK_SAMPLES_PER_PERIOD = 50


class Excitation(FileModel):
    """What to ride on the hold.

    Attributes:
        shape: "multisine" (eight frequencies at once) or "chirp" (one that rises).
        quantity: "force" modulates the desired force; "position" moves the tip by what makes this force.
        amplitude_n: half of the force's peak to peak [N].
        low_hz: lowest frequency [Hz].
        high_hz: highest frequency [Hz].
        duration_s: how long [s].
    """

    shape: Literal["multisine", "chirp"] = "multisine"
    quantity: Literal["force", "position"] = "position"
    amplitude_n: Positive = 1.5
    low_hz: Annotated[Positive, Field(le=100.0)] = 0.5
    high_hz: Annotated[Positive, Field(le=100.0)] = 8.0
    duration_s: Annotated[Positive, Field(le=600.0)] = 4.0

    @model_validator(mode="after")
    def _check_frequencies(self) -> "Excitation":
        if self.low_hz >= self.high_hz:
            raise ValueError(f"low_hz {self.low_hz} must be below high_hz {self.high_hz}")
        if self.low_hz * self.duration_s < 1.0:
            raise ValueError(
                f"duration_s {self.duration_s} is shorter than one period of low_hz {self.low_hz}"
            )
        return self


@dataclass(frozen=True, slots=True)
class ProfilePoint:
    """Profile value between -2 and 0 [-], its rate [1/s] and acceleration [1/s^2]."""

    value: float
    rate_1_s: float
    acceleration_1_s2: float


class Profile:
    """The profile over time: faded in and out, so that value and rate begin and end at zero.

    Args:
        excitation: shape, frequencies and duration.
    """

    def __init__(self, excitation: Excitation) -> None:
        self.duration_s = excitation.duration_s
        self._ramp_s = _RAMP_SHARE * excitation.duration_s
        self._chirp = excitation.shape == "chirp"
        if self._chirp:
            self._rates = np.array([math.tau * excitation.low_hz])
            self._sweep = math.tau * (excitation.high_hz - excitation.low_hz) / excitation.duration_s
            self._phases = np.zeros(1)
            self._scale = 1.0
        else:
            self._rates, self._phases = _multisine(excitation)
            self._sweep = 0.0
            self._scale = 1.0 / self._peak(excitation)

    def at(self, time_s: float) -> ProfilePoint:
        """The profile `time_s` [s] after its start; zero before and afterwards."""
        if not 0.0 < time_s < self.duration_s:
            return ProfilePoint(0.0, 0.0, 0.0)
        wave, wave_rate, wave_acceleration = self._wave(time_s)
        fade, fade_rate, fade_acceleration = self._fade(time_s)
        below = wave - 1.0
        return ProfilePoint(
            fade * below,
            fade_rate * below + fade * wave_rate,
            fade_acceleration * below + 2.0 * fade_rate * wave_rate + fade * wave_acceleration,
        )

    def _wave(self, time_s: float) -> tuple[float, float, float]:
        """The wave between -1 and 1, with its derivatives."""
        angle = self._phases + time_s * (self._rates + 0.5 * self._sweep * time_s)
        rate = self._rates + self._sweep * time_s
        sine, cosine = np.sin(angle), np.cos(angle)
        return (
            self._scale * float(cosine.sum()),
            -self._scale * float(rate @ sine),
            -self._scale * float(rate**2 @ cosine + self._sweep * sine.sum()),
        )

    def _fade(self, time_s: float) -> tuple[float, float, float]:
        """From 0 to 1 at the start and back at the end, with its derivatives."""
        ramp_s = self._ramp_s
        s = min(time_s, self.duration_s - time_s) / ramp_s
        if s >= 1.0:
            return 1.0, 0.0, 0.0
        sign = 1.0 if time_s < 0.5 * self.duration_s else -1.0
        return (
            s**3 * (10.0 + s * (-15.0 + 6.0 * s)),
            sign * 30.0 * s**2 * (1.0 - s) ** 2 / ramp_s,
            60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / ramp_s**2,
        )

    def _peak(self, excitation: Excitation) -> float:
        """Largest magnitude of the unscaled multisine."""
        count = math.ceil(_PEAK_SAMPLES_PER_PERIOD * excitation.high_hz * excitation.duration_s)
        times = np.linspace(0.0, excitation.duration_s, count)[:, None]
        return float(np.abs(np.cos(self._phases + times * self._rates).sum(axis=1)).max())


def _multisine(excitation: Excitation, count: int = 8) -> tuple[FloatArray, FloatArray]:
    """Angular frequencies [rad/s], evenly spaced in ratio, and phases [rad] that keep the peak low.

    Schroeder, IEEE Trans. Information Theory 16(1), 1970.
    """
    rates = math.tau * np.geomspace(excitation.low_hz, excitation.high_hz, count)
    index = np.arange(count)
    return rates, -math.pi * index * (index + 1) / count
