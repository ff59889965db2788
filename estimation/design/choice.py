"""The choice of the next experiment among those that can be done."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.design.discrimination import CLEAR, SMALL
from robot_io.types import FloatArray

NEARLY = 0.9  # of what the best tells, that an experiment tells as well as that


@dataclass(frozen=True)
class Experiment:
    """What could be done next, and how far it is expected to set rivals apart."""

    words: str  # what an experimenter does
    duration_s: float  # how long that takes [s]
    # For each undecided channel, the expected lead of each rival over each other, shape (r, r) each; see
    # `estimation.design.discrimination`.
    leads: tuple[FloatArray, ...]
    evidence: float = 0.0  # what it weighs, where that is known; see `Rivals.evidence`

    @property
    def tells(self) -> float:
        """Share of what is undecided that it is expected to decide: mean over the undecided channels."""
        return sum(map(_share_told, self.leads)) / max(len(self.leads), 1)

    @property
    def separates(self) -> bool:
        """Whether any rival, wherever it is wrong, is expected to fall behind by more than a small share."""
        return any(bool(np.any(one > SMALL)) for one in self.leads)

    def along_with(self, other: "Experiment") -> "Experiment":
        """Combine two experiments, one after the other: the leads of a wrong model add up.

        Args:
            other: the experiment that follows.
        """
        leads = tuple(_together(*both) for both in zip(self.leads, other.leads, strict=True))
        return Experiment(f"{self.words}, and {other.words}", self.duration_s + other.duration_s, leads)


@dataclass(frozen=True)
class Choice:
    """The experiment that was chosen, and why."""

    index: int  # of the experiment among those offered
    experiment: Experiment  # what is done
    reason: str  # one sentence


def choose(offered: Sequence[Experiment]) -> Choice | None:
    """Choose the experiment that tells most; of nearly equal ones, the one with most evidence.

    A rival of many parameters that little evidence speaks against gives way in one place, and comes back by
    another. Where nothing is known of its weight, the shortest is chosen.

    Args:
        offered: feasible experiments with what each is expected to separate.

    Returns:
        None where no experiment is expected to separate anything.
    """
    useful = [number for number, one in enumerate(offered) if one.separates]
    if not useful:
        return None
    most = max(offered[number].tells for number in useful)
    good = [number for number in useful if offered[number].tells >= NEARLY * most]
    index = max(good, key=lambda number: (offered[number].evidence, -offered[number].duration_s))
    chosen, first = offered[index], "with most evidence" if offered[index].evidence else "shortest"
    which = "tells most" if len(good) == 1 else f"{first} of {len(good)} that tell most"
    reason = (
        f"{chosen.words} ({chosen.duration_s:.0f} s): {which}; expected to set apart "
        f"{100 * chosen.tells:.0f} % of what is not told apart"
    )
    return Choice(index, chosen, reason)


def _together(leads: FloatArray, others: FloatArray) -> FloatArray:
    """Leads (r, r) where squared errors, beside those of what is true, add up."""
    left: FloatArray = (1.0 - leads) ** -2.0 + (1.0 - others) ** -2.0 - 1.0
    return 1.0 - np.maximum(left, 1e-3) ** -0.5


def _share_told(leads: FloatArray) -> float:
    """Share of all pairs that are expected to be told apart; a lead that is not clear counts in part."""
    pairs = leads[~np.eye(len(leads), dtype=bool)]
    return float(np.mean(np.clip(pairs / CLEAR, 0.0, 1.0))) if len(pairs) else 0.0
