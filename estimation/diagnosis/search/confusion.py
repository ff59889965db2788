"""Which effects the data cannot tell apart."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from estimation.fit.held_out import held_out_blocks
from estimation.fit.standing import Fit
from estimation.fit.trial import Trial
from estimation.diagnosis.search.candidate import TIE, Candidate
from estimation.statistics.serial_covariance import sum_covariance
from robot_io.types import FloatArray, IntArray

SAME = 0.95  # cosine above which two effects look alike beside the model
CLEARLY = 2.576  # standard errors, that one error is above another by chance in 1 of 200 cases
MUCH = 0.2  # of the squared error; a model that leaves this much more, a tenth of the error, is no rival
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


def is_as_small(ours: FloatArray, theirs: FloatArray, run: IntArray) -> bool:
    """Whether one model's error in held-out runs is as small as another's, as far as the data tell.

    Errors come in bursts, where a derived acceleration is off for instance, so the difference of the squared
    errors is weighed by its own scatter and colour (F. X. Diebold, R. S. Mariano, Comparing Predictive
    Accuracy, J. Bus. Econ. Stat. 13 (1995)). That test is blind to a difference that a few places in a few
    runs make, so what it cannot tell is still not as small where much more is left in all.

    Args:
        ours: squared errors on blocks, shape (m,).
        theirs: of the other model, on the same blocks.
        run: that each block belongs to.
    """
    apart = theirs - ours
    if apart.sum() <= TIE * ours.sum():
        return True
    if apart.sum() > MUCH * ours.sum():
        return False
    scatter = sum_covariance((apart - apart.mean())[:, None], run).matrix[0, 0]
    return float(apart.sum()) <= CLEARLY * float(np.sqrt(scatter))


def rivals(
    found: Sequence[Candidate],
    name: str,
    base: Fit,
    step_s: float,
    *,
    together: Callable[[Candidate], Fit],
    by_positions: Callable[[Candidate], Sequence[Fit]],
) -> list[str]:
    """Effects that would have done as well as the one called `name`, best first.

    As well means that they explain the same beside the model, with an error in held-out runs that is as
    small, or larger by no more than chance may make it; of two times shorter than a few samples (a delay, a
    lag), errors do not tell which it is. A derived acceleration is smoothed, which favours what smooths less:
    each may have that which suits it best of those that positions speak for. An effect that merely contains
    this one (a law with one more term) is no rival: the data say that the term is zero.

    Args:
        found: all candidates that were tried beside one model.
        name: the one that was taken.
        base: that model alone.
        step_s: time between samples [s].
        together: fits all parameters together with a candidate's: beside the others as they were, one that
            needs them a little different looks far worse than it is.
        by_positions: the same with the accelerations that positions speak for, if any.
    """
    taken = next(c for c in found if c.effect.name == name)
    best, shortest = taken.search.best, SHORT * step_s
    alike = [
        c
        for c in found
        if c is not taken and likeness(base.trial, best, c.search.best) > SAME and not contains(c, taken)
    ]
    if not alike:
        return []
    ours = together(taken)
    ours_by_positions = cache(lambda: by_positions(taken))

    def as_good(candidate: Candidate) -> bool:
        if _is_time(candidate, shortest) and _is_time(taken, shortest):
            return True
        theirs = together(candidate)
        if _is_as_good(ours, theirs):
            return True
        others = by_positions(candidate)
        return bool(others) and _is_as_good(_least([ours, *ours_by_positions()]), _least([theirs, *others]))

    return [c.effect.name for c in alike if as_good(c)]


def _least(fits: Sequence[Fit]) -> Fit:
    return min(fits, key=lambda fit: fit.trial.held_out)


def _is_as_good(ours: Fit, theirs: Fit) -> bool:
    both = ours.plain.kept & theirs.plain.kept  # where the contact begins may differ
    first, second = (held_out_blocks(fit.plain.frame, fit.trial)[both] ** 2 for fit in (ours, theirs))
    return is_as_small(first, second, ours.plain.frame.run[both])


def _is_time(candidate: Candidate, below_s: float) -> bool:
    """Whether all that an effect has is one time, shorter than this."""
    effect, fitted = candidate.effect, candidate.search.best.parameters
    if len(effect.inner) != 1 or effect.gains or effect.inner[0].unit != "s":
        return False
    return abs(fitted[f"{effect.name}.{effect.inner[0].name}"]) < below_s


def _parameters(candidate: Candidate) -> int:
    """All of them: those without which it would be another effect, and the others that it is fitted with."""
    return len(candidate.effect.inner) + len(candidate.effect.gains)


def contains(rival: Candidate, taken: Candidate) -> bool:
    """Whether the rival has more parameters and can draw what the taken one draws."""
    if _parameters(rival) <= _parameters(taken):
        return False
    added = contribution(taken.search.best, taken.effect.name)
    energy = float(added @ added)
    if energy == 0.0:
        return False
    columns = rival.search.best.columns
    gains = np.linalg.lstsq(columns, added, rcond=None)[0]
    left = added - columns @ gains
    return float(left @ left) < 1e-3 * energy
