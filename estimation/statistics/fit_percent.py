"""How much of a measurement a model follows, in percent, as control engineers say it."""

import numpy as np

from robot_io.types import FloatArray


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    """100 (1 - |y - ym| / |y - mean(y)|): 100 for a perfect model, 0 for one as good as the mean.

    The normalised root mean square error of system identification (L. Ljung, System Identification, 2nd ed.,
    1999; `compare` of its toolbox).

    Args:
        measured: y, shape (n,); NaN is left out.
        modelled: ym, shape (n,); likewise.

    Returns:
        Below zero for a model that is worse than the mean; NaN where the measurement is constant.
    """
    both = np.isfinite(measured) & np.isfinite(modelled)
    y, ym = measured[both], modelled[both]
    size = float(np.linalg.norm(y - y.mean())) if len(y) else 0.0
    return 100.0 * (1.0 - float(np.linalg.norm(y - ym)) / size) if size > 0.0 else float("nan")
