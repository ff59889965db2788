"""A first answer for one more effect, on means over blocks: the best of a few places, where that leads."""

import numpy as np

from estimation.diagnosis.candidates import extended
from estimation.effect import Effect
from estimation.fit.colour import WHITE
from estimation.fit.frame import Frame, coarse_copy
from estimation.fit.inner_search import look
from estimation.fit.polish import polish
from estimation.fit.standing import Fit, Standing
from estimation.fit.trial import Bench, attempt

_FEW = 6  # places, or somewhat more
_SETTLED = 0.01  # of the energy


def rough_bench(standing: Fit) -> Bench:
    """The bench of a fit with one sample for each block: a trial there costs a fraction.

    Also where the model itself is fitted on blocks: what is added may need samples.
    """
    frame = standing.plain.frame
    rows = np.arange(len(frame))[:, None]
    return Bench(Frame(coarse_copy(frame), rows, frame.run, frame.fold, frame.trusted), WHITE)


def glance(standing: Fit, effect: Effect, rough: Bench) -> Standing:
    """The model of `standing` with one more effect, near the place where a fit would end.

    Args:
        standing: the model without the effect.
        effect: what is added.
        rough: from `rough_bench`.
    """
    known, places = standing.trial.parameters, effect.starts(standing.data)
    places = places[:: max(len(places) // _FEW, 1)]
    tried = [
        look(rough, model, effect, known, places).best for model in extended(standing.trial.model, effect)
    ]
    best = min(tried, key=lambda trial: trial.sse)
    followed = polish(rough, best, _SETTLED)
    trial = attempt(standing.plain, best.model, followed.parameters)
    return Standing(standing.data, standing.plain, trial)
