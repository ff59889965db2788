"""Which effects of a model may be called by their names.

An effect that is not in the library is drawn by others, well or badly. What gives an impostor away is that a
law without a name does better: a wide, shrunken regression on all signals (`estimation.fit.flexible`), which
knows no shape. Names stand where they describe held-out runs as well as that, and leave it little to explain.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from estimation.data.derivatives import grid_step
from estimation.diagnosis.candidates import Candidate, size
from estimation.diagnosis.doubt import SMALL, gained
from estimation.diagnosis.search import LEVEL, NEAR, Search, looked_back
from estimation.effect import SIGNALS, Effect
from estimation.fit.flexible import flexible
from estimation.fit.intervals import final, values
from estimation.fit.readings import Readings
from estimation.fit.standing import Standing

AS_GOOD = 0.9  # of the squared error that names leave, that a law without a name must not get below
MOST = 0.9  # of the squared error that can be explained at all, that names must explain
# signals of effects by the names that a smooth law has for them
_FELT_AS = {"past effort": ("effort",), "other joints": ("joint position", "joint velocity")}
Complete = Callable[[Standing], bool]
_RIVALS = 5  # looked at in the place of an effect; each must explain half of what that does
_SMALL_SHARE = 0.01  # of the squared error that an effect takes away: no law of a real thing is exact
_OWN = 2.0  # times the noise, that an effect's own signals may still explain, or the small share
_SURE = float(ndtri(1.0 - 0.5 * LEVEL) / ndtri(0.975))  # times a 95 % interval: that of `LEVEL`
_WITHIN = 1e-3  # of the energy of what an effect adds, by which curves that are the same may differ


@dataclass(frozen=True)
class Standards:
    """What a model is held against, as mean squares of the error on blocks of held-out runs."""

    base: float  # of the base model
    named: float  # of the model with effects
    nameless: float  # of the base model and a smooth law of all signals
    both: float  # of the model with effects and such a law

    @property
    def is_outdone(self) -> bool:
        """Whether a law without a name does better beside the base model than beside the names.

        By less than a small share of what the names take away says nothing: no law of a real thing is exact.
        """
        by = self.both - self.nameless
        return self.nameless < AS_GOOD * self.both and by > _SMALL_SHARE * (self.base - self.named)

    @property
    def explains_most(self) -> bool:
        """Whether the names take away more of the squared error than they leave."""
        return self.named <= 0.5 * self.base

    @property
    def is_met(self) -> bool:
        """Whether the names do as well as a law without a name, and leave it little to explain."""
        explainable = self.base - min(self.nameless, self.both)
        explained = self.base - self.named
        return self.nameless >= AS_GOOD * self.named and explained >= MOST * explainable


def standards(start: Standing, end: Standing) -> Standards:
    """How well effects and nameless laws describe runs that were held out."""
    counts = [max(int(one.plain.kept.sum()), 1) for one in (start, end)]
    one, other = start.flexible, end.flexible
    left = (one.before, other.before, one.held_out, other.held_out)
    return Standards(
        *(float(held_out.sum()) / count for held_out, count in zip(left, counts * 2, strict=True))
    )


def established(search: Search, end: Standing, readings: Readings, *, complete: bool) -> Standing:
    """The model with those of its effects that stand by themselves; the base model where none does.

    Args:
        search: that led to the model.
        end: base model and effects.
        readings: how the motion was read.
        complete: whether it leaves no more than draws from it do.
    """
    if not search.added(end) or not _may_have_names(search, end, complete=complete):
        return search.start
    some = sufficient_part(search, end, readings)
    less = _without_needless(search, end, readings, complete=complete) if some is end else some
    if less is end or less is search.start:
        return less
    return established(search, looked_back(search, less), readings, complete=complete)


def _may_have_names(search: Search, end: Standing, *, complete: bool) -> bool:
    if not search.is_sensible(end):
        return False
    if complete:
        return True
    held = standards(search.start, end)
    names = search.added(end)
    if held.is_outdone or not all(_follows_its_law(search, end, name, held.both) for name in names):
        return False
    return held.is_met or (held.explains_most and all(_stands_by_itself(search, end, one) for one in names))


def sufficient_part(search: Search, end: Standing, readings: Readings) -> Standing:
    """The first part of a model from which draws gain as much by the whole; some need each other."""
    parts = (search.start, *in_order(search, end)[:-1])
    enough = (part for part in parts if not gained(part, end, readings, search.rng).is_unusual)
    return next(enough, end)


def _without_needless(search: Search, end: Standing, readings: Readings, *, complete: bool) -> Standing:
    """A model less the effects that it does not need, the least telling first."""
    for name in reversed(names_in_order(search, end)):
        before = search.without(end, name)
        is_small = before.rmse - end.rmse < SMALL * (search.start.rmse - end.rmse)
        is_small = is_small or not (complete or _outweighs_the_rest(before, end))
        is_nothing = is_small or _is_below_a_step(search, end, name) or _may_be_nothing(before, end, name)
        needed = not is_nothing and search.is_needed(before, end)
        if needed and gained(before, end, readings, search.rng, name).is_unusual:
            continue
        if search.is_sensible(before):  # or another effect would take over what this one says
            end = before
    return end


def names_in_order(search: Search, end: Standing) -> list[str]:
    """The effects of a model beside the base model's, the most telling first."""
    path = [search.start, *in_order(search, end)]
    return [
        name
        for before, after in pairwise(path)
        for name in set(search.added(after)) - set(search.added(before))
    ]


def in_order(search: Search, end: Standing) -> list[Standing]:
    """The models on the way from the base to the end, the most telling effect first."""
    path = [end]
    while search.added(path[0]):
        less = [search.without(path[0], name) for name in search.added(path[0])]
        path.insert(0, min(less, key=lambda one: one.trial.held_out))
    return path[1:]


def rivals(search: Search, end: Standing, name: str, readings: Readings) -> dict[str, Standing]:
    """Models with another effect in the place of one that the data do not refuse, by its name, best first."""
    alone = {one.effect.name: search.with_candidate(one) for one in _rivals(search, end, name, readings)}
    wholes = ((whole, _with_whole(search, end, whole)) for whole in _wholes(search, end, name))
    kept = ((w, made) for w, made in wholes if not gained(made, end, readings, search.rng).is_unusual)
    return alone | {whole.name: made for whole, made in kept}


def _wholes(search: Search, end: Standing, name: str) -> list[Effect]:
    """Effects of which one is a part, and others of the model are the rest."""
    present = {one.name for one in end.trial.model.effects}
    known = (one for one in search.effects if name in one.parts and one.name not in present)
    return [one for one in known if present >= set(one.parts) and one.applies_to(end.data)]


def _with_whole(search: Search, end: Standing, whole: Effect) -> Standing:
    """A model with an effect in the place of all its parts but those of the base model."""
    for part in search.added(end):
        end = search.without(end, part) if part in whole.parts else end
    return search.with_each(end, [whole])


def simplest(search: Search, end: Standing, readings: Readings, is_complete: Complete) -> Standing:
    """The model with each effect exchanged for one of fewer parameters, or of as many that leaves less.

    Of laws that cannot be told apart, the simplest bears the name (W. H. Jefferys, J. O. Berger, American
    Scientist 80 (1992)); it must leave no more than the other did.

    Args:
        search: that led to the model.
        end: base model and effects that are established.
        readings: how the motion was read.
        is_complete: whether a model leaves no more than draws from it do.
    """
    for name in names_in_order(search, end):
        (effect,) = (one for one in end.trial.model.effects if one.name == name)
        made = map(search.with_candidate, _rivals(search, end, name, readings, size(effect)))
        kept = [one for one in made if search.is_better(one, end) and is_complete(one) >= is_complete(end)]
        end = min(kept, key=lambda one: (search.size(one), one.trial.held_out), default=end)
    return end


def _rivals(
    search: Search, end: Standing, name: str, readings: Readings, most: float = np.inf
) -> Iterator[Candidate]:
    """Candidates of at most so many parameters that the data do not refuse in the place of one.

    One that needs more parameters to draw the same curve (a law with one more term) is no rival: the data say
    that the term is nothing.
    """
    without = search.without(end, name)
    others = [one for one in search.instead(end, name) if one.effect.name != name]
    half = 0.5 * (without.trial.held_out + end.trial.held_out)
    for candidate in others[:_RIVALS]:
        if size(candidate.effect) > most or candidate.followed(end.plain) > NEAR * half:
            continue
        theirs = search.with_candidate(candidate)
        if not search.is_sensible(theirs):
            continue
        is_larger = search.size(theirs) > search.size(end) + 1  # one more may be a place or a phase
        if theirs.trial.held_out > half or (is_larger and _is_same_curve(theirs, end, without)):
            continue
        if not gained(theirs, end, readings, search.rng).is_unusual:
            yield candidate


def _is_same_curve(one: Standing, other: Standing, without: Standing) -> bool:
    """Whether two models predict the same, beside what both add to a third."""
    here, there, before = (standing.trial.residual for standing in (one, other, without))
    if not len(here) == len(there) == len(before):  # the contact begins elsewhere
        return False
    apart, added = here - there, before - there
    return float(apart @ apart) < _WITHIN * float(added @ added)


def _follows_its_law(search: Search, end: Standing, name: str, noise: float) -> bool:
    """Whether an effect leaves less in its own signals than counts beside the noise or what it takes away."""
    small = _SMALL_SHARE * _taken_away(search, end, name)
    return _left_of_its_own(end, name) <= max(_OWN * noise, small)


def _stands_by_itself(search: Search, end: Standing, name: str) -> bool:
    """Whether an effect leaves little in its own signals, and a smooth law of all others does not replace it.

    An impostor leaves structure in the signals of what it stands for: either they are its own, and much there
    is left to explain, or a law of the others explains what it did.
    """
    if _left_of_its_own(end, name) > (1.0 - MOST) * _taken_away(search, end, name):
        return False
    own = _own(end, name)
    with_it, beside = (
        float(flexible(one.plain, one.trial, one.windows, own).held_out.sum())
        / max(int(one.plain.kept.sum()), 1)
        for one in (end, search.without(end, name))
    )
    return with_it < (1.0 - SMALL) ** 2 * beside


def _taken_away(search: Search, end: Standing, name: str) -> float:
    """Mean square of the error that an effect takes away."""
    return search.without(end, name).held_out_mean_square - end.held_out_mean_square


def _left_of_its_own(end: Standing, name: str) -> float:
    """Mean square of the error that an effect's own signals still explain beside it."""
    by_signal = end.flexible.by_signal
    left = float(end.flexible.before.sum()) / max(int(end.plain.kept.sum()), 1)
    return left * max((by_signal.get(one, 0.0) for one in _own(end, name)), default=0.0)


def _own(end: Standing, name: str) -> list[str]:
    """The signals of an effect, by the names that a smooth law has for them."""
    (effect,) = (one for one in end.trial.model.effects if one.name == name)
    recorded = [one for one in end.flexible.by_signal if "recorded" in effect.signals and one not in SIGNALS]
    return [signal for one in effect.signals for signal in _FELT_AS.get(one, (one,))] + recorded


def _outweighs_the_rest(before: Standing, end: Standing) -> bool:
    """Whether an effect takes away more than a smooth law still could: less may be a part of that rest."""
    return before.trial.held_out - end.trial.held_out >= end.flexible.explained


def _may_be_nothing(before: Standing, end: Standing, name: str) -> bool:
    """Whether each parameter that says how large an effect is may be zero, by its interval at `LEVEL`.

    These are its gains, or the first inner parameter of one without gains: a gap, a compliance, a time. Of an
    effect that takes away more of the squared error than is left, beside what windows took off the motion,
    this says no more than that its parameters make up for each other.
    """
    if end.flexible.before.sum() <= 0.5 * before.flexible.before.sum():
        return False
    (effect,) = (one for one in end.trial.model.effects if one.name == name)
    found = values(*final(end))
    sizes = [found[f"{name}.{one.name}"] for one in effect.gains or effect.inner[:1]]
    return not any(abs(one.value) > 0.5 * _SURE * np.ptp(one.interval) for one in sizes)


def _is_below_a_step(search: Search, end: Standing, name: str) -> bool:
    """Whether an effect adds no more than the reader's rounding does, which looks like a law too."""
    step = grid_step(np.sort(end.data.effort))
    without = search.without(end, name)
    added = np.sqrt(max(without.rmse**2 - end.rmse**2, 0.0))
    return bool(name != "quantisation" and step > 0.0 and added < step / np.sqrt(12.0) and end.rmse < step)
