"""Effects that the data cannot tell from one that was named."""

from collections.abc import Sequence

from estimation.diagnosis.search.chain import Chain
from estimation.diagnosis.search.confusion import SAME, likeness, rivals
from estimation.diagnosis.search.possible import LEAST_GAIN
from estimation.diagnosis.search.search import Search
from estimation.diagnosis.search.step import Step
from estimation.signals.runwise import sample_time


def in_place_of(search: Search, chain: Chain, named: Sequence[Step], name: str) -> list[str]:
    """Effects that would do as well in the place of `name`, all others kept, or in the place of all."""
    others = [step.effect for step in named if step.effect != name]
    if others:
        without = search.without(named[-1].standing, name)
        found = search.screen(without)
        alone = _in_place_of_all(search, chain, named)
    else:
        without, found, alone = chain.start, list(chain.ranking), []
    if name not in [candidate.effect.name for candidate in found]:
        return alone
    step_s = sample_time(search.data.time_s, search.data.run)
    as_good = rivals(found, name, without, step_s, together=search.together, by_positions=search.by_positions)
    return list(dict.fromkeys([*as_good, *alone]))


def _in_place_of_all(search: Search, chain: Chain, named: Sequence[Step]) -> list[str]:
    """Single effects that explain what several do together: one cause is as likely as two."""
    end, names = named[-1].standing, {step.effect for step in named}
    found = []
    for candidate in chain.ranking:
        like = likeness(chain.start.trial, end.trial, candidate.search.best) > SAME
        if candidate.effect.name in names or not like:
            continue
        if search.with_candidate(candidate).rmse <= (1.0 + LEAST_GAIN) * end.rmse:
            found.append(candidate.effect.name)
    return found
