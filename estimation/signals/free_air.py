"""Find what readings near zero show about a sensor: its zero and drift in free air, and a dead band."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.signals.blocks import blocks, rows_of_runs
from palpate.estimation.signals.cache_by_array import cache_by_channel_arrays
from palpate.robot_io.types import FloatArray, IntArray

_FREE_SHARE = 0.9  # share of the samples before a contact that is used; the last ones may be in contact
_MAX_READINGS = 50  # largest number of readings used at the end of a run
_MIN_READINGS = 5  # least number of readings at the start and at the end of a run
_VISIBLE_BIAS = 0.5  # least bias or drift that counts, relative to the noise
_MIN_SIGMAS = 3.0  # least drift, and least difference between rates, that counts, in standard errors
_PARTS = 8  # parts of a stretch of free air, in which its drift is seen
_COLLINEAR = 1e-6  # share of the time's energy that the motion must leave, so that a drift is seen
_OTHER_RATE = 0.5  # relative difference above which the rate within stretches of free air is another one
# Readings in a dead band lie within this share of its half width about zero, or within so many standard
# deviations of the noise. They must be more frequent than equally large readings beside them by a factor.
_AT_ZERO, _AT_ZERO_SIGMAS, _MORE_AT_ZERO = 0.1, 2.0, 2.0


@dataclass(frozen=True)
class FreeAirZero:
    """Zero of a sensor, from readings in free air."""

    noise: float  # standard deviation of readings in free air, about each run's mean [effort]
    bias: float  # mean of these readings [effort]
    rate: float | None  # drift [effort/s]; None if unknown
    rate_std_err: float  # standard error of the rate [effort/s]
    duration_s: float  # time from the first to the last reading of the channel [s]

    @property
    def is_zero(self) -> bool:
        """Whether readings in free air show no bias."""
        return abs(self.bias) < _VISIBLE_BIAS * self.noise

    @property
    def is_steady(self) -> bool:
        """Whether readings at the ends of runs show no drift over the recording."""
        if self.rate is None:
            return False
        threshold = max(_VISIBLE_BIAS * self.noise, _MIN_SIGMAS * self.rate_std_err * self.duration_s)
        return abs(self.rate) * self.duration_s < threshold


@cache_by_channel_arrays("kind", "time_s", "run", "effort", "position", "velocity", "touching")
def zero_in_free_air(data: ChannelData) -> FreeAirZero | None:
    """Estimate a sensor's zero from runs that begin in free air; if none does, from later free air.

    The rate of its drift follows from the readings at the ends of the runs, unless the readings within these
    stretches have another rate.

    Args:
        data: the channel.

    Returns:
        The zero; None for joints, and if no run has enough readings in free air.
    """
    if data.kind is not ChannelKind.CONTACT:
        return None
    start_readings, elapsed_s, changes, relative_variances = [], [], [], []
    stretches: list[IntArray] = []  # rows in free air at the start and at the end of a run
    for rows in rows_of_runs(data.run):
        in_contact = np.flatnonzero(data.engaged[rows])
        start_rows = rows[: int(_FREE_SHARE * (in_contact[0] if len(in_contact) else len(rows)))]
        if len(start_rows) < _MIN_READINGS:
            continue
        start_readings.append(data.effort[start_rows])
        end_rows = rows[in_contact[-1] + 1 :][-_MAX_READINGS:] if len(in_contact) else start_rows[:0]
        if len(end_rows) >= _MIN_READINGS:
            compared_rows = start_rows[: len(end_rows)]
            elapsed_s.append(data.time_s[end_rows].mean() - data.time_s[compared_rows].mean())
            changes.append(data.effort[end_rows].mean() - data.effort[compared_rows].mean())
            relative_variances.append(2.0 / len(compared_rows))
            later_rows = rows[in_contact[-1] + 1 :]
            stretches += [start_rows, later_rows[int((1.0 - _FREE_SHARE) * len(later_rows)) :]]
    if not start_readings:  # each run's longest stretch in free air, without its ends near the contacts
        for rows in rows_of_runs(data.run):
            engaged = data.engaged[rows]
            free = [rows[block] for block in blocks(engaged) if not engaged[block.start]]
            longest = max(free, key=len, default=rows[:0])
            margin = int((1.0 - _FREE_SHARE) * len(longest)) + 1
            if len(longest) >= 2 * margin + _MIN_READINGS:
                start_readings.append(data.effort[longest[margin:-margin]])
    if not start_readings:
        return None
    noise = float(np.std(np.concatenate([part - part.mean() for part in start_readings])))
    bias, energy = float(np.concatenate(start_readings).mean()), float(np.vdot(elapsed_s, elapsed_s))
    rate = float(np.vdot(elapsed_s, changes)) / energy if energy > 0.0 else None
    rate_std_err = noise * float(np.sqrt(max(relative_variances) / energy)) if energy > 0.0 else np.inf
    if rate is not None:
        within, within_std_err = _rate_within(data, stretches)
        if abs(within - rate) > max(_OTHER_RATE * abs(rate), _MIN_SIGMAS * within_std_err):
            rate, rate_std_err = within, within_std_err
    return FreeAirZero(noise, bias, rate, rate_std_err, float(np.ptp(data.time_s)))


def _rate_within(data: ChannelData, stretches: list[IntArray]) -> tuple[float, float]:
    """Return the rate of the effort within stretches [effort/s], and its standard error.

    A drift continues within each stretch. Forces that depend on the motion, such as that of a bent lever or
    the drag of a liquid, are fitted too: they differ between a stretch before a contact and one after it.
    The error follows from means over parts of the stretches, whose noise is hardly correlated (batch means).
    """
    parts = [np.array_split(rows, _PARTS) for rows in stretches if len(rows) >= 2 * _PARTS]
    if len(parts) < 2:
        return 0.0, np.inf
    means = np.array(
        [
            [[signal[part].mean() for part in of_stretch] for of_stretch in parts]
            for signal in (data.effort, data.time_s, data.position, data.velocity)
        ]
    )
    effort, elapsed_s, *motion = (means - means.mean(axis=2, keepdims=True)).reshape(len(means), -1)
    columns = np.column_stack(motion)
    left, only_time_s = (
        signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0] for signal in (effort, elapsed_s)
    )
    energy = float(only_time_s @ only_time_s)
    if energy <= _COLLINEAR * float(elapsed_s @ elapsed_s):
        return 0.0, np.inf
    rate = float(only_time_s @ left) / energy
    freedom = len(effort) - len(parts) - len(motion) - 1
    return rate, float(np.sqrt(np.sum((left - rate * only_time_s) ** 2) / freedom / energy))


def may_have_dead_band(readings: FloatArray, half_width: float, sigma: float) -> bool:
    """Return whether readings stay at zero, as a dead band makes them, or whether that cannot be seen.

    It cannot be seen if the noise is large, or if no reading is that small. All efforts within the dead band
    read zero, so that zero is much more frequent than readings beside it.

    Args:
        readings: readings under load, shape (n,) [effort].
        half_width: largest effort that reads zero [effort].
        sigma: standard deviation of the noise [effort].
    """
    size, near = np.abs(readings), max(_AT_ZERO * half_width, _AT_ZERO_SIGMAS * sigma)
    if 2.0 * near > half_width:
        return True
    at_zero, beside = np.sum(size <= near), np.sum((size > near) & (size <= 2.0 * near))
    return bool(at_zero >= _MORE_AT_ZERO * beside)
