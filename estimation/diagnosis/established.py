"""Which effects of a model may be called by their names.

An effect that is not in the library is drawn by others, well or badly. What gives an impostor away is that a
law without a name does better: a wide, shrunken regression on all signals (`estimation.fit.flexible`), which
knows no shape. Names stand where they describe held-out runs as well as that, and leave it little to explain.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimation.data.derivatives import grid_step
from estimation.diagnosis.candidates import Candidate
from estimation.diagnosis.doubt import SMALL, gained
from estimation.diagnosis.search import Search
from estimation.effect import SIGNALS
from estimation.fit.flexible import flexible
from estimation.fit.readings import Readings
from estimation.fit.standing import Standing
from estimation.fit.trial import Trial
from robot_io.types import FloatArray

AS_GOOD = 0.9  # of the squared error that names leave, that a law without a name must not get below
MOST = 0.9  # of the squared error that can be explained at all, that names must explain
# signals of effects by the names that a smooth law has for them
_FELT_AS = {"past effort": ("effort",), "other joints": ("joint position", "joint velocity")}
_ALIKE = 0.95  # cosine above which two effects explain the same
_WITHIN = 1e-3  # of the energy of what an effect adds, that is left where another law contains it


@dataclass(frozen=True)
class Standards:
    """What a model is held against, as mean squares of the error on blocks of held-out runs.

    Attributes:
        base: of the base model.
        named: of the model with effects.
        nameless: of the base model and a smooth law of all signals.
        both: of the model with effects and such a law.
    """

    base: float
    named: float
    nameless: float
    both: float

    @property
    def is_outdone(self) -> bool:
        """Whether a law without a name does better beside the base model than beside the names."""
        return self.nameless < AS_GOOD * self.both

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
    return Standards(
        start.trial.held_out / counts[0],
        end.trial.held_out / counts[1],
        float(start.flexible.held_out.sum()) / counts[0],
        float(end.flexible.held_out.sum()) / counts[1],
    )


def established(search: Search, end: Standing, readings: Readings, *, complete: bool) -> Standing:
    """The model with those of its effects that stand by themselves; the base model where none does.

    Args:
        search: that led to the model.
        end: base model and effects.
        readings: how the motion was read.
        complete: whether it leaves no more than draws from it do.
    """
    held = standards(search.start, end)
    if not search.is_sensible(end) or not (
        complete
        or held.is_met
        or (held.explains_most and all(_stands_by_itself(search, end, name) for name in search.added(end)))
    ):
        return search.start
    for part in [
        search.start,
        *in_order(search, end)[:-1],
    ]:  # some may need each other, and be nothing together
        if not gained(part, end, readings, search.rng).is_unusual:
            return (
                established(search, part, readings, complete=complete) if part is not search.start else part
            )
    for name in reversed(names_in_order(search, end)):  # the least telling first
        before = search.without(end, name)
        is_small = before.rmse - end.rmse < SMALL * (search.start.rmse - end.rmse)
        is_small = is_small or not (complete or _outweighs_the_rest(before, end))
        needed = not (is_small or _is_below_a_step(search, end, name)) and search.is_needed(before, end)
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


def rivals(search: Search, end: Standing, name: str, readings: Readings) -> list[str]:
    """Effects that the data do not refuse in the place of one, best first.

    An effect that merely contains this one (a law with one more term) is no rival: the data say that the term
    is nothing.
    """
    without = search.without(end, name)
    tried = search.instead(end, name)
    taken = next((one for one in tried if one.effect.name == name), None)
    reach = (1.0 + SMALL) ** 2 * 1.5 * end.trial.held_out
    found = []
    for candidate in tried:
        if candidate is taken or candidate.held_out > reach:
            continue
        if _likeness(without.trial, end.trial, candidate.search.best) < _ALIKE:
            continue
        if taken is not None and _contains(candidate, taken):
            continue
        theirs = search.with_candidate(candidate)
        if not gained(theirs, end, readings, search.rng).is_unusual:
            found.append(candidate.effect.name)
    return found


def _stands_by_itself(search: Search, end: Standing, name: str) -> bool:
    """Whether an effect leaves little in its own signals, and a smooth law of all others does not replace it.

    An impostor leaves structure in the signals of what it stands for: either they are its own, and much there
    is left to explain, or a law of the others explains what it did.
    """
    (effect,) = (one for one in end.trial.model.effects if one.name == name)
    without = search.without(end, name)
    left, before = (one.trial.held_out / max(int(one.plain.kept.sum()), 1) for one in (end, without))
    shares = end.flexible.by_signal
    own = [signal for one in effect.signals for signal in _FELT_AS.get(one, (one,))]
    own += [signal for signal in shares if "recorded" in effect.signals and signal not in SIGNALS]
    still = left * max((shares.get(signal, 0.0) for signal in own), default=0.0)
    if still > (1.0 - MOST) * (before - left):
        return False
    with_it, beside = (
        float(flexible(one.plain, one.trial, own).held_out.sum()) / max(int(one.plain.kept.sum()), 1)
        for one in (end, without)
    )
    return with_it < (1.0 - SMALL) ** 2 * beside


def _outweighs_the_rest(before: Standing, end: Standing) -> bool:
    """Whether an effect takes away more than a smooth law still could: less may be a part of that rest."""
    rest = end.trial.held_out - float(end.flexible.held_out.sum())
    return before.trial.held_out - end.trial.held_out >= rest


def _is_below_a_step(search: Search, end: Standing, name: str) -> bool:
    """Whether an effect adds no more than the reader's rounding does, which looks like a law too."""
    step = grid_step(np.sort(end.data.effort))
    without = search.without(end, name)
    added = np.sqrt(max(without.rmse**2 - end.rmse**2, 0.0))
    return bool(name != "quantisation" and step > 0.0 and added < step / np.sqrt(12.0) and end.rmse < step)


def _likeness(base: Trial, one: Trial, other: Trial) -> float:
    """Cosine between what two models explain beyond a third: 1 where they explain the same."""
    first, second = (base.residual - trial.residual for trial in (one, other))
    lengths = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(first @ second) / lengths if lengths > 0.0 else 0.0


def _contains(rival: Candidate, taken: Candidate) -> bool:
    """Whether the rival has more parameters and can draw what the taken one draws."""
    if _count(rival) <= _count(taken):
        return False
    added = _contribution(taken.search.best, taken.effect.name)
    energy = float(added @ added)
    columns = rival.search.best.columns
    left = added - columns @ np.linalg.lstsq(columns, added, rcond=None)[0]
    return energy > 0.0 and float(left @ left) < _WITHIN * energy


def _count(candidate: Candidate) -> int:
    return len(candidate.effect.inner) + len(candidate.effect.gains)


def _contribution(trial: Trial, effect: str) -> FloatArray:
    """What an effect adds to the prediction on blocks, shape (m,)."""
    names: Sequence[str] = list(trial.model.gains)
    own = [i for i, name in enumerate(names) if name.startswith(f"{effect}.")]
    gains = np.array([trial.parameters[names[i]] for i in own])
    added: FloatArray = trial.columns[:, own] @ gains
    return added
