"""Whether what a model leaves in contact is far larger than the sensor's noise, and does not look like noise.

No smooth law of the known signals may explain it, and still it is no noise: a specimen that breathes, hum, a
motor nearby. Free air shows what the sensor's own noise is like.
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelKind
from estimation.data.derivatives import grid_step
from estimation.fit.held_out import held_out_residual
from estimation.fit.standing import Standing
from estimation.diagnosis.judgement.noise_floor import free_air
from estimation.diagnosis.judgement.swinging import strongest_swing
from estimation.signals.runwise import sample_time
from robot_io.types import BoolArray, FloatArray, IntArray

_TIMES = 3.0  # the noise to be expected
_LIKE_NEIGHBOUR = 0.5  # correlation of neighbouring blocks, which noise as in free air does not have
_MORE_ALIKE = 0.2  # than in free air: that of 40 blocks is uncertain by 0.16
_BLOCKS = 40  # in contact and in free air, with fewer of which nothing is said
_PEAK = 0.2  # share of the variance in one frequency that makes it worth naming


@dataclass(frozen=True)
class Excess:
    """What is left in contact and is no noise.

    Attributes:
        contact: root mean square of the residual in contact, on blocks, in the unit of the effort.
        expected: the same of noise as in free air, and of what the steps of force and position make.
        frequency_hz: at which much of it swings; None if it does at none.
    """

    contact: float
    expected: float
    frequency_hz: float | None


def unlike_noise(standing: Standing) -> Excess | None:
    """What a model leaves in contact beyond the sensor's noise, or None if it looks like noise."""
    frame = standing.plain.frame
    data = frame.data
    if data.kind is not ChannelKind.CONTACT:
        return None
    residual = frame.reduce(held_out_residual(frame, standing.trial))
    usable = frame.trusted & np.isfinite(residual)
    pressed = data.engaged[frame.rows]
    contact, air = usable & pressed.all(axis=1), usable & ~pressed.any(axis=1)
    if min(contact.sum(), air.sum()) < _BLOCKS:
        return None
    size = _rms(residual[contact])
    rounding = grid_step(data.effort) / np.sqrt(12.0)
    noise = (_about_run_means(residual, frame.run, air), rounding, _of_position(standing, contact))
    expected = float(np.linalg.norm(noise))
    alike = _neighbours(residual, frame.run, contact)
    if size < _TIMES * expected or alike < _LIKE_NEIGHBOUR:
        return None
    if alike < _neighbours(residual, frame.run, air) + _MORE_ALIKE:
        return None
    return Excess(size, expected, _frequency(standing, residual, contact))


def quiet_floor(standing: Standing) -> float:
    """The error that free air says a complete model would leave; infinite where what is left may be noise."""
    excess = unlike_noise(standing)
    return (free_air(standing.data) or excess.expected) if excess else float("inf")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _about_run_means(residual: FloatArray, run: IntArray, chosen: BoolArray) -> float:
    parts = [residual[chosen & (run == one)] for one in np.unique(run[chosen])]
    return _rms(np.concatenate([part - part.mean() for part in parts]))


def _of_position(standing: Standing, contact: BoolArray) -> float:
    """Force that the unevenness of the measured position makes, whose steps a coarse encoder shows."""
    frame = standing.plain.frame
    position = frame.reduce(frame.data.position)
    step = sample_time(frame.data.time_s, frame.data.run) * frame.rows.shape[1]
    speed = frame.reduce(frame.data.velocity)
    near = contact[1:] & contact[:-1] & (frame.run[1:] == frame.run[:-1])
    if not near.any():
        return 0.0
    uneven = np.diff(position)[near] - 0.5 * (speed[1:] + speed[:-1])[near] * step
    effort = frame.reduce(frame.data.effort)[contact]
    stiffness = float(np.ptp(effort)) / max(float(np.ptp(position[contact])), 1e-12)
    return stiffness * _rms(uneven)


def _neighbours(residual: FloatArray, run: IntArray, chosen: BoolArray) -> float:
    """Correlation of each block with the next."""
    pairs = chosen[1:] & chosen[:-1] & (run[1:] == run[:-1])
    if pairs.sum() < _BLOCKS // 2:
        return 0.0
    one, other = residual[1:][pairs], residual[:-1][pairs]
    return float((one @ other) / max(np.sqrt((one @ one) * (other @ other)), 1e-300))


def _frequency(standing: Standing, residual: FloatArray, contact: BoolArray) -> float | None:
    """At which what is left in contact swings most, if it does much [Hz]."""
    frame = standing.plain.frame
    step_s = sample_time(frame.data.time_s, frame.data.run) * frame.rows.shape[1]
    left = np.where(contact, residual, np.nan)
    found = strongest_swing(frame.reduce(frame.data.time_s), frame.run, left, step_s)
    return found[0] if found and found[1] > _PEAK else None
