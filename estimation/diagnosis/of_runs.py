"""What differs from run to run, beside a model whose search has ended.

Such an effect is a random one: each run has a value of its own, which its first part tells and the rest of
it confirms (C. R. Henderson, Biometrics 31 (1975)). It is tried last and only where runs disagree, since it
would take up a part of anything that changes slowly.
"""

from collections.abc import Iterator

from estimation.diagnosis.objections import disagreement
from estimation.diagnosis.search import Search
from estimation.effects.run_gain import RunGain
from estimation.effects.run_offset import RunOffset
from estimation.fit.standing import Standing

_OF_RUNS = (RunGain, RunOffset)


def vary(search: Search, found: Standing) -> Standing:
    """The model with a gain or a zero for each run where that is all that runs differ in; else as it is.

    Effects that the variation makes needless are left out.

    Args:
        search: of the channel.
        found: the model that its search has led to.
    """
    if disagreement(found.plain.frame, found.trial) is None:
        return found
    varied = search.ordered(
        [one for one in _varied(search, found) if disagreement(one.plain.frame, one.trial) is None]
    )
    return _less(search, varied[0]) if varied and search.is_needed(found, varied[0]) else found


def _varied(search: Search, found: Standing) -> Iterator[Standing]:
    """The model with each of the effects that differ from run to run."""
    for effect in (one() for one in _OF_RUNS):
        if effect.applies_to(found.data):
            start = {f"{effect.name}.share": effect.starts(found.data)[-1]["share"]}
            yield search.fitted(found.trial.model.with_effect(effect), {**found.trial.parameters, **start})


def _less(search: Search, varied: Standing) -> Standing:
    """Without those effects that stood for the difference between runs."""
    for name in search.added(varied):
        less = search.without(varied, name)
        if not search.is_needed(less, varied):
            varied = less
    return varied
