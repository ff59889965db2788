"""Which samples of a probing run are in contact, found from the force alone.

The rows are chosen by time, not by force: from the first lasting rise above the free-air noise to the last.
A sensor that was loaded may read more in free air than before, so the noise of the retract counts as well.
Taking every sample with F > 0 instead would keep the positive half of the noise near the surface and bias the
stiffness. The samples at either end, which were chosen for their noise, are left out.
"""

from dataclasses import dataclass, replace

import numpy as np

from control.laws.touch import touch_force_n
from control.loop.task import Phase
from estimation.signals.blocks import block_index
from estimation.statistics.serial_covariance import sum_covariance
from robot_io.types import BoolArray, FloatArray, IntArray

_LASTING = 3  # samples in a row
_FREE = (Phase.FREE_AIR, Phase.APPROACH)  # the first of these that a run has tells its noise


@dataclass(frozen=True)
class Contact:
    """One run's contact."""

    run: int  # its number
    rows: IntArray  # indices of the samples that are surely in contact, in order of time; may be empty
    # Indices of the last sample before and the first after it whose force
    # is no touch; fewer where the run has none.
    free: IntArray
    baseline_n: float  # force in free air [N]
    baseline_std_err_n: float  # its standard error, also where the noise is correlated in time [N]
    noise_n: float  # standard deviation of the force in free air [N]

    def among(self, kept: BoolArray) -> "Contact":
        """The same contact where only some samples are kept, its own among them; mask of shape (n,)."""
        number = np.cumsum(kept) - 1
        return replace(self, rows=number[self.rows], free=number[self.free])


def find_contacts(force_n: FloatArray, run: IntArray, phase: IntArray) -> tuple[Contact, ...]:
    """The contact of each run, in order of run number.

    Args:
        force_n: shape (n,), positive in compression [N].
        run: shape (n,).
        phase: shape (n,), numbers of `control.loop.task.Phase`.
    """
    return tuple(
        _contact_of(int(number), np.flatnonzero(run == number), force_n, phase) for number in np.unique(run)
    )


def contact_rows(force_n: FloatArray, run: IntArray, phase: IntArray) -> BoolArray:
    """Mask of all samples that are surely in contact, shape (n,)."""
    mask = np.zeros(len(force_n), dtype=np.bool_)
    for contact in find_contacts(force_n, run, phase):
        mask[contact.rows] = True
    return mask


def _contact_of(number: int, rows: IntArray, force_n: FloatArray, phase: IntArray) -> Contact:
    free = _free_air(force_n[rows], phase[rows])
    baseline_n, noise_n = float(np.mean(free)), float(np.std(free))
    highest_n = max(baseline_n, _after(force_n[rows], phase[rows], baseline_n))
    touching = _lasting(force_n[rows] > highest_n + touch_force_n(noise_n))
    inside = np.flatnonzero(touching)[1:-1]
    beside = np.zeros(0, dtype=np.int64)
    if len(inside):  # a bounce is no contact, a single low sample within it is noise
        beside = np.array(
            [at for at in (inside[0] - 2, inside[-1] + 2) if 0 <= at < len(rows)], dtype=np.int64
        )
        lifted = _lasting(~touching[inside[0] : inside[-1] + 1])
        inside = inside[0] + np.flatnonzero(~lifted)
    return Contact(number, rows[inside], rows[beside], baseline_n, _mean_std_err(free), noise_n)


def _free_air(force_n: FloatArray, phase: IntArray) -> FloatArray:
    """Force before contact; the first half of the approach, if nothing better is there."""
    for free in _FREE:
        samples: FloatArray = force_n[phase == free]
        if len(samples) > 2 * _LASTING:
            return samples if free is Phase.FREE_AIR else samples[: len(samples) // 2]
    return force_n[:_LASTING]


def _after(force_n: FloatArray, phase: IntArray, before_n: float) -> float:
    """Mean force at the end of the retract; `before_n` if the run has none."""
    retracted: FloatArray = force_n[phase == Phase.RETRACT]
    if len(retracted) <= 2 * _LASTING:
        return before_n
    return float(np.mean(retracted[len(retracted) // 2 :]))


def _mean_std_err(samples: FloatArray) -> float:
    """Standard error of the mean."""
    away = samples - np.mean(samples)
    return float(np.sqrt(sum_covariance(away[:, None]).matrix[0, 0])) / len(samples)


def _lasting(mask: BoolArray) -> BoolArray:
    """Only those true samples that stand in a row of at least `_LASTING`."""
    _, row = block_index(mask)
    return np.asarray(mask & (np.bincount(row)[row] >= _LASTING))
