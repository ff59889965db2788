"""How alike two signals are."""

import numpy as np

from robot_io.types import FloatArray


def likeness(one: FloatArray, other: FloatArray) -> float:
    """Correlation of two signals (n,), 0 where one of them is constant."""
    if len(one) == 0 or np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])
