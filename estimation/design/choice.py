"""The choice of the next experiment among those that can be done."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.design.discrimination import CLEAR, SMALL
from robot_io.types import FloatArray


@dataclass(frozen=True)
class Experiment:
    """What could be done next, and how far it is expected to set rivals apart.

    Attributes:
        words: what an experimenter does.
        duration_s: how long that takes [s].
        leads: for each undecided channel, the expected lead of each rival over each other, shape (r, r) each;
            see `estimation.design.discrimination`.
    """

    words: str
    duration_s: float
    leads: tuple[FloatArray, ...]

    @property
    def lead(self) -> float:
        """Expected lead of what is true over the nearest rival, in the channel where that is largest."""
        return max((_over_the_nearest(one) for one in self.leads), default=0.0)

    @property
    def separates(self) -> bool:
        """Whether any rival, wherever it is wrong, is expected to fall behind by more than a small share."""
        return any(bool(np.any(one > SMALL)) for one in self.leads)


@dataclass(frozen=True)
class Choice:
    """The experiment that was chosen, and why.

    Attributes:
        index: of the experiment among those offered.
        experiment: what is done.
        reason: one sentence.
    """

    index: int
    experiment: Experiment
    reason: str


def choose(offered: Sequence[Experiment]) -> Choice | None:
    """The shortest experiment that separates clearly; if none does, the one with the largest expected lead.

    Returns:
        None where no experiment is expected to separate anything.
    """
    useful = [number for number, one in enumerate(offered) if one.separates]
    if not useful:
        return None
    clear = [number for number in useful if offered[number].lead >= CLEAR]
    if clear:
        index = min(clear, key=lambda number: offered[number].duration_s)
        which = f"shortest of {len(clear)} that separate" if len(clear) > 1 else "only one that separates"
        why = f"the {which} clearly"
    else:
        index = max(useful, key=lambda number: rank(offered[number]))
        why = f"the best of {len(offered)}"
    chosen = offered[index]
    reason = (
        f"{chosen.words} ({chosen.duration_s:.0f} s): {why}; what is true is expected to leave an error "
        f"{100 * chosen.lead:.0f} % below its nearest rival's"
    )
    return Choice(index, chosen, reason)


def _over_the_nearest(leads: FloatArray) -> float:
    """Lead over the nearest rival, in the mean over what may be true."""
    others = leads + np.where(np.eye(len(leads), dtype=bool), np.inf, 0.0)
    return float(np.mean(others.min(axis=1))) if len(leads) > 1 else 0.0


def rank(experiment: Experiment) -> tuple[float, float]:
    """How much an experiment tells: pairs that it sets apart, then its lead."""
    return sum(_share_refuted(one) for one in experiment.leads), experiment.lead


def _share_refuted(leads: FloatArray) -> float:
    """Share of all pairs that are expected to be told apart."""
    return float(np.mean(leads[~np.eye(len(leads), dtype=bool)] > SMALL)) if len(leads) > 1 else 0.0
