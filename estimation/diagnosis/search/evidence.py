"""What speaks for an effect, weighed against chance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelKind
from estimation.fit.standing import Standing
from estimation.diagnosis.search.candidate import Candidate
from estimation.diagnosis.search.possible import LEAST_GAIN, is_beyond_bounds
from estimation.diagnosis.search.surrogates import best_gains, p_value, surrogates
from robot_io.types import FloatArray

# Of the held-out error sample by sample, which is what a user sees; a joint's model has noise in it as well.
LEAST_SAMPLE_GAIN, LEAST_JOINT_SAMPLE_GAIN = 0.01, 0.05
SLIGHT = 0.003  # of the energy that all effects together take away, that each must account for
LEAST_JUDGED_GAIN = 0.0  # of what is new in each sample, which slow data says little about
LEAST_BROAD_GAIN = 0.005
LEAST_FOLDS = 0.6  # share of the folds in which the error must fall
FEW = 6  # blocks, about one touch in each run, that must not decide alone
LEVEL = 0.01  # of false alarms, over all candidates


@dataclass(frozen=True)
class Evidence:
    """What speaks for a candidate.

    Attributes:
        gain: share by which the error in held-out runs falls.
        sample_gain: the same, sample by sample.
        judged_gain: the same, of what is new in each sample.
        folds: share of the folds in which it falls.
        broad_gain: the judged gain without the few blocks that gain most.
        p_value: how often the best of all candidates does as well on noise.
        least_sample_gain: what is asked of `sample_gain`.
    """

    gain: float
    sample_gain: float
    judged_gain: float
    folds: float
    broad_gain: float
    p_value: float
    least_sample_gain: float = LEAST_SAMPLE_GAIN

    @property
    def enough(self) -> bool:
        """Whether the candidate is accepted."""
        gains = (
            (self.gain, LEAST_GAIN),
            (self.sample_gain, self.least_sample_gain),
            (self.judged_gain, LEAST_JUDGED_GAIN),
            (self.broad_gain, LEAST_BROAD_GAIN),
        )
        return (
            all(gain >= least for gain, least in gains)
            and self.folds >= LEAST_FOLDS
            and self.p_value <= LEVEL
        )


def evidence(
    before: Standing, after: Standing, found: Sequence[Candidate], chosen: Candidate, rng: np.random.Generator
) -> Evidence:
    """Weigh a candidate against chance, by the noise that is left once it is in the model.

    Args:
        before: without it.
        after: with it.
        found: all candidates that were tried.
        chosen: the one in question.
        rng: for the surrogates.
    """
    # all parameters fitted together may do better than one effect beside the others as they were
    best = min(chosen.search.held_out, after.trial.scores.held_out, key=np.sum)
    gain, folds = _gain(before, best)
    without = after.judge.fit(before.trial.columns, before.trial.target)
    judged_gain = _fall(without.held_out.sum(), after.judged.held_out)
    broad_gain = _broad(after.judge.whiten(before.trial.residual), after.judge.whiten(after.judged.residual))
    kept = after.plain.kept
    noise = surrogates(after.flexible.residual[kept], after.plain.frame.run[kept], rng)
    starts = (t.columns[kept] for c in found for t in c.search.starts)
    chance = best_gains(noise, before.trial.columns[kept], starts)
    # chance is as strong as the noise, not as all that is still missing
    observed = (before.trial.sse - after.trial.sse) / float(np.sum(after.flexible.residual[kept] ** 2))
    sample_gain = 1.0 - after.rmse / before.rmse
    return Evidence(
        gain,
        sample_gain,
        judged_gain,
        folds,
        broad_gain,
        p_value(observed, chance),
        least_sample_gain(before.data.kind),
    )


def least_sample_gain(kind: ChannelKind) -> float:
    """Share of the error, sample by sample, that an effect must take away."""
    return LEAST_SAMPLE_GAIN if kind is ChannelKind.CONTACT else LEAST_JOINT_SAMPLE_GAIN


def is_slight(start: Standing, before: Standing, held_out: float) -> bool:
    """Whether an effect takes away so little of all that is explained that another may just be imprecise.

    A strong effect that is computed from a motion measured with errors leaves a little of itself behind,
    for which some small effect always has the shape. Beside what fits only with a spring that pulls, nothing
    is slight: that is no strong effect, but one that imitates several.

    Args:
        start: the base model.
        before: the model without the effect.
        held_out: energy left with it.
    """
    little = before.trial.held_out - held_out < SLIGHT * (start.trial.held_out - held_out)
    return little and not is_beyond_bounds(before.trial)


def hopeless(before: Standing, chosen: Candidate) -> Evidence:
    """Evidence for a candidate whose gain is too small for the rest to be weighed: NaN."""
    gain, folds = _gain(before, chosen.search.held_out)
    return Evidence(gain, np.nan, np.nan, folds, np.nan, np.nan)


def _gain(before: Standing, held_out: FloatArray) -> tuple[float, float]:
    """Share by which the error in held-out runs falls, and share of the folds in which it does."""
    better = float(np.mean(held_out < before.trial.scores.held_out))
    return _fall(before.trial.held_out, held_out.sum()), better


def _broad(before: FloatArray, after: FloatArray) -> float:
    """Share by which the error (w,) falls without the blocks that gain most: a few may be an accident."""
    order = np.argsort(before**2 - after**2)[: max(len(before) - FEW, 1)]
    return _fall(float(np.sum(before[order] ** 2)), float(np.sum(after[order] ** 2)))


def _fall(before: float, after: float) -> float:
    return float(1.0 - np.sqrt(after / before)) if before > 0.0 else 0.0
