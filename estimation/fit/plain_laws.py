"""Plain laws: of so few parameters that what only draws one of them is no evidence for its name."""

import numpy as np

from estimation.effects.contact_offset import ContactOffset
from estimation.fit.inner_search import look, refine
from estimation.fit.standing import Standing
from robot_io.types import FloatArray

# Signals of which any smooth law is plain, with the number of its parameters: a constant, and a trend in time
# with its bend. Of all other signals, the flexible regression has far more.
PLAIN_SIGNALS = {"offset": 1, "time": 2}
_TURN = (
    0.02  # of the usual speed, over which a direction turns: well below it, and above the noise of a speed
)


def left_by_plain_signals(start: Standing) -> list[tuple[int, float]]:
    """Parameters of each plain law of one signal, and the energy in held-out runs that it leaves.

    Args:
        start: the model that it is beside.
    """
    left = start.trial.held_out
    return [(count, (1.0 - start.flexible.by_signal[name]) * left) for name, count in PLAIN_SIGNALS.items()]


def left_by_one_term(start: Standing) -> float:
    """Energy in held-out runs that the best law of one term leaves: a constant, a power or the direction.

    Args:
        start: the model that it is beside.
    """
    x, v = motion(start)
    turn = np.tanh(v / (_TURN * float(np.sqrt(np.mean(v**2))) or 1.0))
    terms = (np.ones(len(x)), x, x**2, x**3, x**5, v, v * np.abs(v), v**3, turn)
    return min(left_with(start, term) for term in terms)


def left_by_another_surface(start: Standing) -> float:
    """Energy in held-out runs that is left if the surface lies where the model does best.

    Where it lies is to be found in every contact, whatever else is missing.

    Args:
        start: the model that it is beside.
    """
    offset, trial = ContactOffset(), start.trial
    if not offset.applies_to(start.data) or offset.name in {effect.name for effect in trial.model.effects}:
        return trial.held_out
    model = trial.model.with_effect(offset)
    looked = look(start.plain, model, offset, trial.parameters, offset.starts(start.data))
    return float(refine(start.plain, model, offset, looked).held_out.sum())


def motion(standing: Standing) -> tuple[FloatArray, FloatArray]:
    """Position and velocity where they act, on blocks (m,)."""
    data, mean = standing.data, standing.plain.frame.reduce
    x, v = (mean(np.where(data.engaged, signal, 0.0)) for signal in (data.position, data.velocity))
    return x, v


def left_with(standing: Standing, terms: FloatArray) -> float:
    """Energy in held-out runs with more columns (m,) or (m, k) beside the model."""
    columns = np.column_stack([standing.trial.columns, terms])
    return float(standing.plain.fit(columns, standing.trial.target).held_out.sum())
