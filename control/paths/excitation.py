"""Persistent excitation: a profile that is added to the hold and separates stiffness from damping.

At one frequency w, force over displacement is k + j w c, so several frequencies determine both. The profile
only reduces the force, so that the force limit is kept.
"""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from palpate.control.paths.trajectory import PEAK_SPEED, quintic
from palpate.robot_io.files.file_model import FileModel, Positive

_RAMP_SHARE = 0.2  # share of the duration for the fade-in
_PEAK_SAMPLES_PER_PERIOD = 50
_SINE_COUNT = 8  # number of sines in a multisine


class Excitation(FileModel):
    """Settings of a profile that is added to the hold."""

    # "multisine" (eight frequencies at once) or "chirp" (a rising frequency).
    shape: Literal["multisine", "chirp"] = "multisine"
    # "force" modulates the desired force; "position" moves the tip by the distance that gives this force.
    quantity: Literal["force", "position"] = "force"
    amplitude_n: Positive = 1.5  # half of the force's peak to peak [N]
    low_hz: Annotated[Positive, Field(le=100.0)] = 0.5  # lowest frequency [Hz]
    high_hz: Annotated[Positive, Field(le=100.0)] = 8.0  # highest frequency [Hz]
    duration_s: Annotated[Positive, Field(le=600.0)] = 4.0  # duration [s]

    @model_validator(mode="after")
    def _check_frequencies(self) -> "Excitation":
        if self.low_hz >= self.high_hz:
            raise ValueError(f"low_hz {self.low_hz} must be below high_hz {self.high_hz}")
        if self.low_hz * self.duration_s < 1.0:
            raise ValueError(f"duration_s {self.duration_s} is shorter than a period of low_hz {self.low_hz}")
        return self

    @property
    def ramp_s(self) -> float:
        """Duration of fading in [s]."""
        return _RAMP_SHARE * self.duration_s


class Profile:
    """A wave between -1 and 1 minus an offset, faded in so that value, rate and acceleration begin at zero.

    It ends without a fade-out, because the arm moves out of the object next.

    Args:
        excitation: shape, frequencies and duration.
        offset: subtracted from the wave; with 1 the profile is never positive.
    """

    def __init__(self, excitation: Excitation, offset: float = 1.0) -> None:
        self._offset = offset
        self.duration_s = excitation.duration_s
        self._ramp_s = excitation.ramp_s
        self._chirp = excitation.shape == "chirp"
        if self._chirp:
            self._rates = np.array([math.tau * excitation.low_hz])
            self._sweep = math.tau * (excitation.high_hz - excitation.low_hz) / excitation.duration_s
            self._phases = np.zeros(1)
            self._scale = 1.0
        else:
            # Logarithmically spaced, with phases that keep the peak low: Schroeder, IEEE Trans. Information
            # Theory 16(1), 1970.
            index = np.arange(_SINE_COUNT)
            self._rates = math.tau * np.geomspace(excitation.low_hz, excitation.high_hz, _SINE_COUNT)
            self._phases = -math.pi * index * (index + 1) / _SINE_COUNT
            self._sweep = 0.0
            count = math.ceil(_PEAK_SAMPLES_PER_PERIOD * excitation.high_hz * excitation.duration_s)
            times = np.linspace(0.0, excitation.duration_s, count)[:, None]
            self._scale = 1.0 / float(np.abs(np.cos(self._phases + times * self._rates).sum(axis=1)).max())

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Compute the profile (0 or less), its rate [1/s] and acceleration [1/s^2] at a time.

        Args:
            time_s: time since its start [s].
        """
        # The wave between -1 and 1, with its derivatives by time.
        angle = self._phases + time_s * (self._rates + 0.5 * self._sweep * time_s)
        rate = self._rates + self._sweep * time_s
        sine, cosine = np.sin(angle), np.cos(angle)
        wave, wave_rate, wave_acceleration = (
            self._scale * float(cosine.sum()),
            -self._scale * float(rate @ sine),
            -self._scale * float(rate**2 @ cosine + self._sweep * sine.sum()),
        )
        fade, fade_rate, fade_acceleration = quintic(time_s, self._ramp_s)
        shifted_wave = wave - self._offset
        return (
            fade * shifted_wave,
            fade_rate * shifted_wave + fade * wave_rate,
            fade_acceleration * shifted_wave + 2.0 * fade_rate * wave_rate + fade * wave_acceleration,
        )


def position_amplitude_m(
    excitation: Excitation,
    *,
    stiffness_n_m: float,
    damping_n_s_m: float,
    force_limit_n: float,
    speed_limit_m_s: float,
) -> tuple[float, float]:
    """Compute amplitude [m] and offset [-] of a position profile on an object of this compliance.

    The highest frequency determines the force's amplitude. The offset reduces the spring's force by this
    amplitude, so that the sum stays below the limit. Neither wave nor fade-in exceeds the speed limit, and
    the fade-in needs at most a third of the force on the object's damper.

    Args:
        excitation: shape, frequencies and force amplitude.
        stiffness_n_m: stiffness of the object [N/m].
        damping_n_s_m: damping of the object [N s/m].
        force_limit_n: force limit [N].
        speed_limit_m_s: speed limit [m/s].
    """
    rate = math.tau * excitation.high_hz
    impedance_n_m = math.hypot(stiffness_n_m, rate * damping_n_s_m)
    offset = impedance_n_m / stiffness_n_m
    fade_m_s = min(speed_limit_m_s, 0.3 * force_limit_n / max(damping_n_s_m, 1e-9))
    speed_limited_m = min(speed_limit_m_s / rate, fade_m_s * excitation.ramp_s / (PEAK_SPEED * offset))
    return min(excitation.amplitude_n / impedance_n_m, speed_limited_m), offset
