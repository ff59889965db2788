"""Whether the signal was rectified: readings below zero folded up to positive ones, or cut off."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.signals.runwise import apply_per_run
from robot_io.types import BoolArray, FloatArray, IntArray

_FEWEST = 50  # readings within the noise of zero, of which none is below: by chance in 1 of 2^50 cases
# Of the readings in the farther half of that noise, that lie in the nearer. Folded noise is densest at zero:
# 1 and more, by chance 0.8; what thins out towards its least reading had 0.3, where there was enough of it.
_FLAT = 0.6
# Exactly zero, for each reading on the next step: folding lays two steps on that one and leaves zero alone,
# half; cutting lays on zero all that was below.
_MOST_ZEROS = 0.75
# Of a joint's readings, that are exactly zero: more than at a standstill. With fewer different ones than that
# zero is a step as any other.
_OFTEN, _FINE = 0.3, 50
# Times the energy that a law leaves without a constant. What was cut off takes nothing from what is left: 1.0
# to 1.1, also beside an effect at ten times the noise. A dead band takes its width from all of it: 3 and
# more, less where a weight goes through so little of its turn that it looks like a constant.
_WITHOUT_CONSTANT = 1.5
_CLEAR = 4.0  # times the noise, above which no reading is a folded one
_FOLDED = (
    "no reading is below zero, though {count} lie within their noise of it, {noise:.2g} {unit}: "
    "the signal was rectified"
)
_TO_SIGMA = 1.4826 / np.sqrt(6.0)  # of the median bend: normal quantile, and variance of a second difference


def rectified(data: ChannelData) -> str | None:
    """Say why the readings of a joint are those of a rectified signal: half of the law is lost then.

    Where an effort comes within its noise of zero, half of the readings lie below. If none does, and they are
    as dense just above zero as a little farther up, they were folded there. A reading whose least was set to
    zero thins out towards it instead.

    Args:
        data: the channel; a tare that was taken off is put back.

    Returns:
        One sentence, or None if they are not rectified.
    """
    if data.kind is ChannelKind.CONTACT:
        return None
    effort = _as_read(data)
    if len(effort) == 0 or effort.min() < 0.0:
        return None
    if _is_cut_off(data, effort):
        share = float(np.mean(effort == 0.0))
        return (
            f"no reading is below zero, and {100 * share:.0f} % are exactly zero: was the sign "
            "cut off? record the signal with its sign"
        )
    count, noise = _folded(effort, data.run)
    said = _FOLDED.format(count=count, noise=noise, unit=data.kind.effort_unit)
    return f"{said}; record it with its sign" if count else None


def folded_in_contact(data: ChannelData) -> BoolArray:
    """Select readings of a contact so near to zero that the sensor folded their noise there.

    An object can only push, so that what a converter cuts off below zero is but free air's noise. What is
    folded has a mean above zero, which would pass for a bias.

    Args:
        data: the channel.

    Returns:
        Mask of shape (n,).
    """
    effort = _as_read(data)
    if data.kind is not ChannelKind.CONTACT or len(effort) == 0 or effort.min() < 0.0:
        return np.zeros(len(data), dtype=np.bool_)
    count, noise = _folded(effort, data.run)
    return np.asarray(effort <= _CLEAR * noise) if count else np.zeros(len(data), dtype=np.bool_)


def folded(data: ChannelData) -> str | None:
    """Say that a contact's readings near zero were rectified; None if they were not.

    Args:
        data: the channel.
    """
    near = folded_in_contact(data)
    if not near.any():
        return None
    count, noise = _folded(_as_read(data), data.run)
    said = _FOLDED.format(count=count, noise=noise, unit=data.kind.effort_unit)
    share = f"{100 * np.mean(near):.0f} % of the samples, up to {_CLEAR:.0f} times that, are left out"
    return f"{said}, and {share}; record it with its sign"


def _as_read(data: ChannelData) -> FloatArray:
    """The effort (n,) before a tare was taken off."""
    return data.effort if data.tare is None else data.effort + data.tare.of(data.run)


def _folded(effort: FloatArray, run: IntArray) -> tuple[int, float]:
    """How many readings (n,) lie within their noise of zero, and that noise; 0 if they are no folded ones."""
    noise = _TO_SIGMA * float(np.median(np.abs(apply_per_run(_bends, effort, run))))
    near = effort[(effort > 0.0) & (effort <= noise)]
    if len(near) == 0 or noise < 2.0 * near.min():
        return 0, noise  # steps too coarse to say how dense they lie
    step = float(near.min())
    half = step * (np.floor(0.5 * noise / step) + 0.5)  # as many steps in the nearer half as in the farther
    inner = int(np.count_nonzero(near <= half))
    outer = int(np.count_nonzero((effort > half) & (effort <= 2.0 * half - 0.5 * step)))
    zeros, next_to_zero = np.count_nonzero(effort == 0.0), np.count_nonzero(near < 1.5 * step)
    is_folded = inner >= _FLAT * outer and zeros <= _MOST_ZEROS * next_to_zero and len(near) >= _FEWEST
    return len(near) if is_folded else 0, noise


def _is_cut_off(data: ChannelData, effort: FloatArray) -> bool:
    """Whether a joint's readings (n,) lost what was below zero, and nothing of what is above it.

    A dead band that a torque of one sign goes into and out of shows zeros as well, but what it swallows is
    then missing everywhere. Laws are a weight at any tilt, and one with springs that rest where it hangs.
    """
    zero = effort == 0.0
    if np.mean(zero) <= _OFTEN or len(np.unique(effort)) < _FINE:
        return False
    q, v = data.position, data.velocity
    motion, one = [np.sin(q), v, np.sign(v), data.acceleration], np.ones(len(q))
    laws = ([*motion, np.cos(q)], [*motion, q, q**3])
    return any(
        _left(effort, law, ~zero) <= _WITHOUT_CONSTANT * _left(effort, [*law, one], ~zero) for law in laws
    )


def _left(effort: FloatArray, columns: list[FloatArray], rows: BoolArray) -> float:
    """Mean square that columns (n,) leave of an effort (n,) in some rows."""
    matrix, wanted = np.column_stack(columns)[rows], effort[rows]
    gains = np.linalg.lstsq(matrix, wanted, rcond=1e-9)[0]
    return float(np.mean((wanted - matrix @ gains) ** 2))


def _bends(effort: FloatArray) -> FloatArray:
    """Second differences (n,) of a run's effort (n,), zero at its ends."""
    bends = np.zeros(len(effort))
    bends[1:-1] = np.diff(effort, 2)
    return bends
