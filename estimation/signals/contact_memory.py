"""Memory of an object over several contacts, between which its free surface recovers."""

from collections.abc import Callable

import numpy as np

from palpate.estimation.channel import ChannelData
from palpate.estimation.signals.blocks import block_index, has_one_clock, number_stretches, runs_by_time
from palpate.estimation.signals.cache_by_array import cache_by_array, cache_by_channel_arrays
from palpate.estimation.signals.exponential_memory import relax
from palpate.robot_io.types import BoolArray, FloatArray, IntArray

_MIN_AIR = 20  # samples in free air from which its readings are known
_SIGMAS = 5.0  # standard deviations above the readings in free air from which a reading is a contact


def remaining_strain(  # noqa: PLR0917
    memory: Callable[..., FloatArray],
    strain: FloatArray,
    time_s: FloatArray,
    run: IntArray,
    data: ChannelData,
    pressed: BoolArray,
) -> FloatArray:
    """Return what remains of a strain or elastic force after relaxation in contact and in free air.

    In free air, time passes more slowly, by `ChannelData.recovery_ratio`. For one branch without a damper,
    this is exact; see `free_surface_memory`.

    Args:
        memory: function of a signal, the times (n,) [s], the run numbers (n,) and `independent_runs`; it
            returns what remains of the signal, in its shape.
        strain: strain or elastic force while the object is pressed, shape (n,) or (n, k).
        time_s: times, shape (n,) [s].
        run: run number of each sample, shape (n,).
        data: the channel, which may have more samples.
        pressed: samples in contact, shape (n,), see `pressed_samples`.
    """
    if data.recovery_ratio == 1.0:
        return memory(strain, time_s, run, independent_runs=bool(data.recovers))
    rows, last, clock_s, number = _press_clock(time_s, run, pressed, data.recovery_ratio)
    inside = memory(strain[rows], clock_s, number, independent_runs=False)
    return _with_air(inside, strain, rows, last, 1.0)


def free_surface_memory(
    strain: FloatArray, data: ChannelData, rates: FloatArray, shares: FloatArray
) -> FloatArray:
    """Return the sum of relaxing branches of an elastic force whose free surface recovers between contacts.

    The force is F = E + sum f_i W_i + theta E' with W_i = Z_i - E and Z_i' = E' - Z_i r_i, where theta is
    `ChannelData.retardation_s`. It is zero in free air. Without a damper (theta 0), E therefore follows the
    branches: W_i' = -r_i (W_i - sum f_j W_j), and a single branch with the time constant tau recovers with
    tau / (1 - f). With a damper, E' = -(E + sum f_j W_j) / theta and W_i' = -r_i (W_i + E). The tip leaves
    the surface before it reaches the undeformed position of the surface (T. C. T. Ting, J. Appl. Mech. 33
    (1966)).

    Args:
        strain: elastic force E while the object is pressed, shape (n, k).
        data: the channel, shape (n,).
        rates: relaxation rates r_i, shape (r,) [1/s].
        shares: shares f_i of the branches in the elastic force, shape (r,).

    Returns:
        sum f_i Z_i, shape (n, k).
    """
    rows, last, time_s, number = _press_clock(data.time_s, data.run, pressed_samples(data), 1.0)
    if not len(rows):
        return np.zeros(strain.shape)
    pressed = strain[rows]
    branches = np.stack(
        [relax(pressed, time_s, number, 1.0 / rate, independent_runs=True) for rate in rates.tolist()]
    )
    starts, contact = block_index(number)
    ends = np.append(starts[1:], len(rows)) - 1
    decay = np.exp(-np.outer(rates, time_s - time_s[starts][contact]))
    system = -rates[:, None] * (np.eye(len(rates)) - shares)
    left = (branches[:, ends] - pressed[ends]).swapaxes(0, 1)
    if damped := data.retardation_s > 0.0:  # the elastic force is a state of its own
        elastic = -np.append(shares, 1.0) / data.retardation_s
        system = np.block([[-np.diag(rates), -rates[:, None]], [elastic]])
    exponents, modes = np.linalg.eig(system)
    pauses_s = time_s[starts[1:]] - time_s[ends[:-1]]
    # If the shares exceed 1, the solid is unstable; its state would overflow in a long pause.
    remaining = np.exp(np.outer(pauses_s, np.minimum(exponents.real, 0.0) + 1j * exponents.imag))
    remaining[pauses_s < 0.0] = 0.0  # runs with separate clocks
    recovery = ((modes * remaining[:, None]) @ np.linalg.inv(modes)).real
    carried = np.zeros((len(starts), len(rates), strain.shape[1]))  # state at the start of each contact
    for number_before, recovered in enumerate(recovery):
        state = carried[number_before] * decay[:, ends[number_before], None] + left[number_before]
        if damped:
            state = np.vstack([state, pressed[ends[number_before]]])
        carried[number_before + 1] = (recovered @ state)[: len(rates)]
    branches += carried[contact].swapaxes(0, 1) * decay[..., None]
    return _with_air(np.tensordot(shares, branches, 1), strain, rows, last, shares.sum())


def above_free_surface(
    pushing: FloatArray, elastic: FloatArray, damping: float, data: ChannelData
) -> BoolArray:
    """Return the mask (n,) of samples in which the tip has not yet reached a surface that still recovers.

    The force on a free surface at the depth s is zero, so that E(s) + c s' = 0, and a Kelvin-Voigt object
    recovers with the time constant c / k (T. C. T. Ting, J. Appl. Mech. 33 (1966)). With T(s), the integral
    of c / E over the depth, t + T(s) is constant. The tip reaches the surface when t + T(x) of its own depth
    x exceeds all earlier values.

    Args:
        pushing: force of the object in contact, shape (n,); the tip leaves where it is negative.
        elastic: elastic part E of this force, shape (n,).
        damping: coefficient c of the damper.
        data: the channel with the motion that acts on the object, shape (n,).
    """
    clock, above = np.full(len(data), -np.inf), np.zeros(len(data), dtype=np.bool_)
    deep, logarithm = _by_depth(data.position)
    loaded = elastic[deep] > 0.0
    deep, logarithm = deep[loaded], logarithm[loaded]
    slowness = damping * data.position[deep] / elastic[deep]  # dT / d log x
    steps_s = 0.5 * (slowness[1:] + slowness[:-1]) * np.diff(logarithm)
    clock[deep] = data.time_s[deep] + np.concatenate([[0.0], np.cumsum(steps_s)])
    runs = [np.arange(rows.start, rows.stop) for rows in runs_by_time(data.time_s, data.run)]
    if not data.recovers and has_one_clock(data.time_s, data.run):
        runs = [np.concatenate(runs)]
    for rows in runs:
        latest = np.maximum.accumulate(clock[rows])
        starts, contact = block_index(pushing[rows] < 0.0)
        before = np.append(-np.inf, latest)[starts][contact]
        above[rows] = (latest <= before) & (clock[rows] > -np.inf)
    return above


@cache_by_array
def _by_depth(position: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the rows (d,) below the surface in ascending order of depth, and its logarithm (d,)."""
    deep = np.flatnonzero(position > 0.0)
    deep = deep[np.argsort(position[deep])]
    return deep, np.log(position[deep])


def _with_air(
    inside: FloatArray, strain: FloatArray, rows: IntArray, last: IntArray, share: float
) -> FloatArray:
    """Fill a memory (p, ...) of the rows (p,) in contact with the state in which the last contact ended.

    In free air, this keeps the predicted force below zero.
    """
    left = np.concatenate([np.zeros((1, *strain.shape[1:])), inside - share * strain[rows]])
    memory = left[last]
    memory[rows] = inside
    return np.asarray(memory)


@cache_by_channel_arrays("position", "effort", "run", "touching")
def pressed_samples(data: ChannelData) -> BoolArray:
    """Return the mask (n,) of samples in contact, from the first force above the readings in free air.

    A contact ends where a reading is not above those in free air, after the last one that clearly is.

    Args:
        data: a contact channel.
    """
    engaged = data.engaged
    in_air = data.effort[~engaged]
    if len(in_air) < _MIN_AIR:
        return engaged
    zero = np.median(in_air)
    deviation = 1.4826 * np.median(np.abs(in_air - zero))  # standard deviation of normal noise
    starts, piece = block_index(number_stretches(engaged, data.run))
    rows, loaded = np.arange(len(data)), engaged & (data.effort > zero + _SIGMAS * deviation)
    if not loaded.any():  # a planned motion has no readings
        return engaged
    first = np.minimum.reduceat(np.where(loaded, rows, len(data)), starts)[piece]
    last = np.maximum.reduceat(np.where(loaded, rows, -1), starts)[piece]
    light = np.where(~engaged | (data.effort <= zero), rows, len(data))
    after = np.minimum.accumulate(light[::-1])[::-1]  # the next sample that is not above
    pressed: BoolArray = engaged & (rows >= first) & (rows < np.where(last < 0, 0, after[last]))
    pressed |= False if data.touching is None else data.touching
    pressed.setflags(write=False)  # others are cached by it
    return pressed


@cache_by_array
def _press_clock(
    time_s: FloatArray, run: IntArray, pressed: BoolArray, ratio: float
) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """Order the samples in contact by time, and let time pass more slowly in free air.

    Returns:
        Rows in contact (p,), their number up to each sample (n,), and their times [s] and contacts (p,).
    """
    order = np.concatenate([np.arange(rows.start, rows.stop) for rows in runs_by_time(time_s, run)])
    held, number = pressed[order], number_stretches(pressed[order], run[order])
    steps_s = np.diff(time_s[order], prepend=time_s[order[:1]])
    inside = held & (np.diff(number, prepend=-1) == 0)
    clock_s = np.cumsum(np.where(inside, steps_s, ratio * steps_s))[held]
    last = np.empty_like(order)
    last[order] = np.cumsum(held)
    results = order[held], last, clock_s, number[held]
    for result in results:
        result.setflags(write=False)  # others are cached by it
    return results
