"""Find the samples of each run in contact, and estimate the position of the surface."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.control.laws.touch import touch_force_n
from palpate.control.loop.task import Phase
from palpate.estimation.channel import MIN_STEPS, ChannelData, Surface, Tare
from palpate.estimation.signals.blocks import block_index
from palpate.estimation.statistics.least_squares import solve
from palpate.estimation.statistics.noise import sum_covariance
from palpate.estimation.statistics.uncertainty import common_error_covariance, sandwich
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

# Columns of stored contacts, see `with_surface`.
SURFACE_COLUMN, STEP_COLUMN = "surface_m", "position_step_m"
_MIN_SAMPLES = 3  # least number of consecutive samples of a contact
_FREE_PHASES = (Phase.FREE_AIR, Phase.APPROACH)  # the first of these phases in a run determines its noise


@dataclass(frozen=True)
class Contact:
    """Contact of one run."""

    run: int  # number of the run
    rows: IntArray  # indices of the samples that are certainly in contact, in order of time; may be empty
    # Indices of the last sample before and the first sample after the contact without a contact force; fewer
    # if the run has none.
    free: IntArray
    baseline_n: float  # mean force in free air [N]
    baseline_std_err_n: float  # its standard error, valid for autocorrelated noise [N]
    noise_n: float  # standard deviation of the force in free air [N]


def find_contacts(force_n: FloatArray, run: IntArray, phase: IntArray) -> tuple[Contact, ...]:
    """Find the contact of each run, in order of run number.

    Args:
        force_n: force, positive in compression, shape (n,) [N].
        run: run number of each sample, shape (n,).
        phase: numbers of `palpate.control.loop.task.Phase`, shape (n,).
    """
    contacts = []
    for number in np.unique(run):
        rows = np.flatnonzero(run == number)
        force, phase_in_run = force_n[rows], phase[rows]
        free = force[:_MIN_SAMPLES]
        for before in _FREE_PHASES:  # without a phase in free air, the first half of the approach is used
            samples: FloatArray = force[phase_in_run == before]
            if len(samples) > 2 * _MIN_SAMPLES:
                free = samples if before is Phase.FREE_AIR else samples[: len(samples) // 2]
                break
        baseline_n, noise_n = float(np.mean(free)), float(np.std(free))
        highest_n, retracted = baseline_n, force[phase_in_run == Phase.RETRACT]
        if len(retracted) > 2 * _MIN_SAMPLES:  # the end of the retraction is also in free air
            highest_n = max(baseline_n, float(np.mean(retracted[len(retracted) // 2 :])))
        touching = _drop_short_stretches(force > highest_n + touch_force_n(noise_n))
        inside = np.flatnonzero(touching)[1:-1]
        neighbors = list[int]()
        if len(inside):  # a bounce is not a contact; a single low sample within a contact is noise
            neighbors = [at for at in (inside[0] - 2, inside[-1] + 2) if 0 <= at < len(rows)]
            lifted = _drop_short_stretches(~touching[inside[0] : inside[-1] + 1])
            inside = inside[0] + np.flatnonzero(~lifted)
        deviation = free - np.mean(free)
        std_err_n = float(np.sqrt(sum_covariance(deviation[:, None]).matrix[0, 0])) / len(free)
        around = rows[np.array(neighbors, dtype=np.int64)]
        contacts.append(Contact(int(number), rows[inside], around, baseline_n, std_err_n, noise_n))
    return tuple(contacts)


def contact_rows(force_n: FloatArray, run: IntArray, phase: IntArray) -> BoolArray:
    """Return the mask of all samples that are certainly in contact, shape (n,).

    Args:
        force_n: force, positive in compression, shape (n,) [N].
        run: run number of each sample, shape (n,).
        phase: numbers of `palpate.control.loop.task.Phase`, shape (n,).
    """
    mask = np.zeros(len(force_n), dtype=np.bool_)
    for contact in find_contacts(force_n, run, phase):
        mask[contact.rows] = True
    return mask


def _drop_short_stretches(mask: BoolArray) -> BoolArray:
    """Keep only true samples in stretches of at least `_MIN_SAMPLES` samples."""
    _, row = block_index(mask)
    return np.asarray(mask & (np.bincount(row)[row] >= _MIN_SAMPLES))


_SOFTEST_START = 3.0  # largest assumed power of the depth in the force law near the surface


def find_surface(  # noqa: PLR0917
    tip_m: FloatArray,
    speed_m_s: FloatArray,
    force_n: FloatArray,
    run: IntArray,
    contacts: Sequence[Contact],
    step_m: float,
) -> Surface:
    """Estimate the common surface of runs at one place: the zero of a fit of a spring and a damper.

    The surface is not deeper than the shallowest sample in contact, since the force of an object may begin
    more gradually than that of a spring. It is not above a bound from the last sample in free air: if the
    force of an object grows with a power p of the depth, this sample has the share (x_air / x_max)^p of the
    largest force, and this force is below the threshold of contact. If the press spans only a few encoder
    steps, the samples around the contact alone determine the surface.

    Args:
        tip_m: position of the tip along the press direction; a larger coordinate is deeper, shape (n,) [m].
        speed_m_s: derivative of that position, shape (n,) [m/s].
        force_n: force above that in free air, positive in compression, shape (n,) [N].
        run: run number of each sample, shape (n,).
        contacts: contacts at one place.
        step_m: quantization step of the coordinates; 0 if there is none [m].
    """
    rows = np.concatenate([contact.rows for contact in contacts])
    free = np.concatenate([contact.free for contact in contacts])
    pressed_m, pressed_n = tip_m[rows], force_n[rows]
    first_m, last_m = float(pressed_m.min()), float(pressed_m.max())
    # Half a step below the shallowest sample in contact.
    deepest_m, highest_m, air_m = first_m + step_m / 2, float("-inf"), first_m
    if len(free):
        air_m = min(float(tip_m[free].min()), first_m)
        touch_n = touch_force_n(max(contact.noise_n for contact in contacts))
        share = min(touch_n / float(pressed_n.max()), 0.5) ** (1 / _SOFTEST_START)
        highest_m = air_m - share / (1 - share) * (last_m - air_m) - step_m / 2
    if last_m - first_m < MIN_STEPS * step_m:
        # Uniformly distributed between free air and contact.
        middle_m, width_m = (air_m + first_m) / 2, first_m - air_m + step_m
        return Surface(middle_m, width_m / np.sqrt(12), highest_m, deepest_m)
    columns = np.column_stack([pressed_m - first_m, speed_m_s[rows], np.ones(len(rows))])
    stiffness, _, offset_n = gains = solve(columns, pressed_n)
    if stiffness <= 0.0:
        return Surface(first_m, float("nan"), highest_m, deepest_m)
    residuals = pressed_n - columns @ gains
    covariance = sandwich(columns, residuals, np.ones(len(residuals)), run[rows])
    deeper_m = -float(offset_n / stiffness)
    slope = np.array([-deeper_m, 0.0, -1.0]) / stiffness  # derivative of deeper_m by the gains
    tare = tare_of(contacts)
    matrix = covariance.matrix + common_error_covariance(columns, tare.index(run[rows]), tare.std_err)
    std_err_m = float(np.sqrt(slope @ matrix @ slope))
    return Surface(max(first_m + min(deeper_m, 0.0), highest_m), std_err_m, highest_m, deepest_m)


def tare_of(contacts: Sequence[Contact]) -> Tare:
    """Return the force in free air of each run.

    Args:
        contacts: contacts in order of run number.
    """
    return Tare(
        np.array([contact.run for contact in contacts]),
        np.array([contact.baseline_n for contact in contacts]),
        np.array([contact.baseline_std_err_n for contact in contacts]),
    )


def with_surface(data: ChannelData, position_m: float, step_m: float = 0.0) -> ChannelData:
    """Restore the surface of a stored contact, whose uncertainty follows from its samples.

    Args:
        data: contact of a probing session, with position from the estimated surface and untared force.
        position_m: coordinate of that surface along the press direction [m].
        step_m: resolution of the position, 0 if it is unknown [m].
    """
    data = replace(data, position_step=step_m)
    contacts = find_contacts(data.effort, data.run, data.phase)
    if not any(len(contact.rows) for contact in contacts):
        return data
    above_n = data.effort - tare_of(contacts).of(data.run)
    found = find_surface(data.position, data.velocity, above_n, data.run, contacts, step_m)
    bounds = position_m + found.highest_m, position_m + found.deepest_m
    return replace(data, surface=Surface(position_m, found.std_err_m, *bounds))


def tared(data: ChannelData) -> ChannelData:
    """Subtract the force in free air from that of a contact with an estimated surface.

    Args:
        data: the channel; any other is returned unchanged.
    """
    if data.surface is None or data.tare is not None:
        return data
    tare = tare_of(find_contacts(data.effort, data.run, data.phase))
    return replace(data, effort=data.effort - tare.of(data.run), tare=tare)
