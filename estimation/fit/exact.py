"""Whether a model leaves no more than the last digits of the numbers: data made without noise."""

import numpy as np

from estimation.fit.standing import Standing

_DIGITS = 1e-7  # of the effort: single precision keeps 6e-8, and the fit's own shrinkage leaves some 1e-9


def is_exact(standing: Standing) -> bool:
    """Whether what is left is smaller than any reader's noise, and has a shape all the same.

    Rounding and the fit's own shrinkage depend on the signals; that is no law of the object.
    """
    effort = standing.data.effort
    return standing.rmse <= _DIGITS * float(np.sqrt(np.mean(effort**2)))
