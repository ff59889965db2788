"""Whether readings below zero were turned round or cut off on their way: a rectified signal."""

import numpy as np

from estimation.channel import ChannelData, ChannelKind
from estimation.signals.runwise import per_run
from robot_io.types import FloatArray

_FEWEST = 50  # readings within the noise of zero, of which none is below: by chance in 1 of 2^50 cases
_FLAT = 0.6  # of the readings in the farther half of that noise, that lie in the nearer
_MOST_ZEROS = 2.0  # for each of these; more are a dead band, or data without noise
# Of a joint's readings, that are exactly zero: more than at a standstill. With fewer different ones than that
# zero is a step as any other.
_OFTEN, _FINE = 0.3, 50
_TO_SIGMA = 1.4826 / np.sqrt(6.0)  # of the median bend: normal quantile, and variance of a second difference


def folded(data: ChannelData) -> str | None:
    """Why the readings are those of a rectified signal; None if they are not.

    Where an effort comes within its noise of zero, half of the readings lie below. If none does, and they are
    as dense just above zero as a little farther up, they were folded or cut off there. A reading whose least
    was set to zero thins out towards it instead. A contact may read zero for long; a joint that moves
    does not.

    Args:
        data: the channel; a tare that was taken off is put back.
    """
    effort = data.effort if data.tare is None else data.effort + data.tare.of(data.run)
    if len(effort) == 0 or effort.min() < 0.0:
        return None
    noise = _TO_SIGMA * float(np.median(np.abs(per_run(_bends, effort, data.run))))
    near = effort[(effort > 0.0) & (effort <= noise)]
    inner = int(np.count_nonzero(near <= 0.5 * noise))
    zeros = int(np.count_nonzero(effort == 0.0))
    if (
        data.kind is not ChannelKind.CONTACT
        and zeros > _OFTEN * len(effort)
        and len(np.unique(effort)) >= _FINE
    ):
        return (
            f"no reading is below zero, and {100 * zeros / len(effort):.0f} % are exactly zero: was the sign "
            "cut off? record the signal with its sign"
        )
    if len(near) < _FEWEST or inner < _FLAT * (len(near) - inner) or zeros > _MOST_ZEROS * len(near):
        return None
    unit = data.kind.effort_unit
    return (
        f"no reading is below zero, though {len(near)} lie within their noise of it, {noise:.2g} {unit}: "
        "what was below was turned round or cut off; record the signal with its sign"
    )


def _bends(effort: FloatArray) -> FloatArray:
    """Second differences (n,) of a run's effort (n,), zero at its ends."""
    bends = np.zeros(len(effort))
    bends[1:-1] = np.diff(effort, 2)
    return bends
