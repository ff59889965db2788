"""Which effects the data cannot tell apart."""

from collections.abc import Sequence

import numpy as np

from estimation.diagnosis.bench.trial import Trial
from estimation.diagnosis.search.selection import TIE, Candidate
from robot_io.types import FloatArray

SAME = 0.95  # cosine above which two effects look alike beside the model
SHORT = 2.0  # samples; what happens within them, a reading at one moment does not tell


def contribution(trial: Trial, effect: str) -> FloatArray:
    """What an effect adds to the prediction on blocks, shape (m,); zero for one without gains."""
    names = list(trial.model.gains)
    own = [i for i, name in enumerate(names) if name.startswith(f"{effect}.")]
    gains = np.array([trial.parameters[names[i]] for i in own])
    added: FloatArray = trial.columns[:, own] @ gains
    return added


def likeness(base: Trial, one: Trial, other: Trial) -> float:
    """Cosine between what two models explain beyond a third: 1 where they explain the same."""
    first, second = (base.residual - trial.residual for trial in (one, other))
    lengths = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(first @ second) / lengths if lengths > 0.0 else 0.0


def rivals(found: Sequence[Candidate], name: str, base: Trial, step_s: float) -> list[str]:
    """Effects that would have done as well as the one called `name`, best first.

    As well means that they explain the same beside the model, with as small an error in held-out runs; of two
    times shorter than a few samples (a delay, a lag), errors do not tell which it is. An effect that merely
    contains this one (a law with one more term) is no rival: the data say that the term is zero.

    Args:
        found: all candidates that were tried beside one model.
        name: the one that was taken.
        base: that model alone.
        step_s: time between samples [s].
    """
    taken = next(c for c in found if c.effect.name == name)
    limit, shortest = (1.0 + TIE) * taken.held_out, SHORT * step_s
    close = [
        c
        for c in found
        if c is not taken and (c.held_out <= limit or (_is_time(c, shortest) and _is_time(taken, shortest)))
    ]
    best = taken.search.best
    return [
        c.effect.name for c in close if likeness(base, best, c.search.best) > SAME and not contains(c, taken)
    ]


def _is_time(candidate: Candidate, below_s: float) -> bool:
    """Whether all that an effect has is one time, shorter than this."""
    effect, fitted = candidate.effect, candidate.search.best.parameters
    if len(effect.inner) != 1 or effect.gains or effect.inner[0].unit != "s":
        return False
    return abs(fitted[f"{effect.name}.{effect.inner[0].name}"]) < below_s


def contains(rival: Candidate, taken: Candidate) -> bool:
    """Whether the rival has more parameters and can draw what the taken one draws."""
    if rival.size <= taken.size:
        return False
    added = contribution(taken.search.best, taken.effect.name)
    energy = float(added @ added)
    if energy == 0.0:
        return False
    columns = rival.search.best.columns
    gains = np.linalg.lstsq(columns, added, rcond=None)[0]
    left = added - columns @ gains
    return float(left @ left) < 1e-3 * energy
