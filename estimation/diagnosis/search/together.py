"""Two effects that are found only together: one of them alone explains little, or the wrong one does more."""

from estimation.diagnosis.search.candidate import TIE
from estimation.diagnosis.search.evidence import least_sample_gain
from estimation.diagnosis.search.search import Search
from estimation.diagnosis.search.sketch import promising_pairs
from estimation.diagnosis.search.step import Step, confirmed


def pair(search: Search) -> tuple[Step, ...] | None:
    """The simplest pair of effects that explains all and in which each is needed, or None."""
    tried = [
        (pair, search.stand_anew(pair.trial.model, pair.trial.parameters)) for pair in promising_pairs(search)
    ]
    complete = [(pair, end) for pair, end in tried if search.is_explained(end)]
    if not complete:
        return None
    least = min(end.trial.held_out for _, end in complete)
    least_rmse = min(end.rmse for _, end in complete)
    close = [
        (pair, end)
        for pair, end in complete
        if end.trial.held_out <= (1.0 + TIE) * least
        or end.rmse * (1.0 - least_sample_gain(end.data.kind)) <= least_rmse  # too little for another effect
    ]
    for pair, end in sorted(close, key=lambda found: found[0].size):
        steps = confirmed(search, end, [pair.one, pair.other])
        if steps:
            return steps
    return None
