"""What is left when no known effect explains it: how much, and what it depends on."""

import numpy as np

from estimation.channel import ChannelKind
from estimation.fit.exact import is_exact
from estimation.fit.standing import Standing

LEFT = 0.03  # share of the held-out error that a flexible regression may take away from a complete model
JOINT_LEFT = (
    0.05  # the same sample by sample, for a joint: noise of the derived acceleration is in the model too
)
# Signals that are measured, not derived: what depends on them more than on acceleration is no noise of that.
_MEASURED = ("offset", "time", "position")
_SHARE = 0.4  # of the most telling signal's share; signals with less are not named
_LEAST = 0.01


def is_explained(standing: Standing, floor: float = np.inf) -> bool:
    """Whether no more is left than noise.

    Args:
        standing: the model in question.
        floor: energy on blocks of held-out runs that a flexible regression left beside another model.
    """
    if is_exact(standing) or standing.left_of_blocks(floor) <= LEFT:
        return True
    if standing.data.kind is ChannelKind.CONTACT or standing.left_of_samples(floor) > JOINT_LEFT:
        return False
    share = standing.flexible.by_signal
    return max(share[name] for name in _MEASURED) <= max(1.0 - (1.0 - LEFT) ** 2, share["acceleration"])


def depends_on(standing: Standing) -> list[str]:
    """Signals that the remaining error depends on in held-out runs, the most telling first."""
    shares = {
        name: max(share, standing.flexible_judged.by_signal[name])
        for name, share in standing.flexible.by_signal.items()
    }
    most = max(shares.values(), default=0.0)
    if most < _LEAST:
        return []
    told = [name for name, share in shares.items() if share >= max(_SHARE * most, _LEAST)]
    return sorted(told, key=lambda name: -shares[name])
