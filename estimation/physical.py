"""Which gains of a fit make no physical sense, such as a spring that pulls where it is pressed."""

from collections.abc import Iterable, Mapping

import numpy as np

from palpate.estimation.effect import Parameter
from palpate.estimation.estimate import ParameterEstimate
from palpate.robot_io.types import FloatArray

UNPHYSICAL = "the model lacks something, or the sign of effort or motion is turned"  # why
_ROUNDING = 1e-9  # share of the effort below which a gain is one of the last digits of the numbers


def unphysical(
    gains: Mapping[str, Parameter],
    estimates: Iterable[ParameterEstimate],
    columns: FloatArray,
    effort: FloatArray,
) -> dict[str, str]:
    """Gains that lie outside what is physical with their whole intervals, each in words with its value.

    Args:
        gains: by "effect.parameter", in column order.
        estimates: their estimates, and others.
        columns: effort per unit of each gain, shape (n, p).
        effort: what was explained, shape (n,).
    """
    parts = np.sqrt(np.mean(columns**2, axis=0) / max(float(np.mean(effort**2)), 1e-300))
    shares, beyond = dict(zip(gains, parts.tolist(), strict=True)), {}
    for estimate in estimates:
        limits = gains.get(estimate.name)
        if limits is None or abs(estimate.value) * shares[estimate.name] <= _ROUNDING:
            continue
        if (below := estimate.interval[1] < limits.lower) or estimate.interval[0] > limits.upper:
            side = "below" if below else "above"
            beyond[estimate.name] = (
                f"{estimate.name} = {estimate.value:.4g} {estimate.unit} is {side} what is physical"
            )
    return beyond
