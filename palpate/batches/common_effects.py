"""Pooled diagnosis: find effects that are too small to detect in one measurement.

The gain of a candidate effect is the improvement of the logarithmic score on held-out runs. If the effect is
absent, the expected gain is not positive, because its parameters cost some score. A one-sided t test of the
mean gain over measurements therefore keeps its level. Holm's method corrects over all candidates of a
channel.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from scipy.stats import ttest_1samp

from palpate.batches.statistics import holm
from palpate.batches.table import floats, texts
from palpate.robot_io.types import FloatArray

LEVEL = 0.01  # chance of naming an effect where none is missing, for each channel and step
_LEAST_SHARE = 0.01  # smallest share of the squared error of an effect that is named
LEAST = 5  # measurements
_LIKE = 0.05  # p value of a difference from the best candidate, above which a candidate is as good
_MOST_STEPS = 4


@dataclass(frozen=True)
class CommonEffect:
    """Effect that is missing according to all measurements together."""

    channel: str
    effect: str  # its name
    measurements: int  # on which it was tried
    improved: int  # measurements whose held-out error it lowers
    share: float  # share of the squared held-out error that it removes, geometric mean
    p_value: float  # p-value of no gain, corrected over all candidates
    confused_with: tuple[str, ...]  # candidates whose gain does not differ significantly


def find_common_effects(screen: Callable[[dict[str, Any]], pa.Table]) -> tuple[CommonEffect, ...]:
    """Add the effect with the largest gain, step by step, until no gain is significant.

    Args:
        screen: fits candidates to all measurements, in addition to the effects `added` (lists by channel), in
            `channels` (None for all); returns a row with the `gain` of each measurement, channel and
            `candidate`.
    """
    added: dict[str, list[str]] = {}
    chosen: list[CommonEffect] = []
    channels: list[str] | None = None
    for _ in range(_MOST_STEPS):
        results = screen({"added": added, "channels": channels})
        named = texts(results, "channel")
        channels = []
        for channel in dict.fromkeys(filter(None, named)):
            own = results.filter(pa.array([name == channel for name in named]))
            if (effect := best_effect(channel, own)) is not None:
                chosen.append(effect)
                channels.append(channel)
                added = {**added, channel: [*added.get(channel, ()), effect.effect]}
        if not channels:
            break
    return tuple(chosen)


def best_effect(channel: str, results: pa.Table) -> CommonEffect | None:
    """Return the candidate with the largest gain, or None if that is not significant.

    Args:
        channel: name of the channel.
        results: rows of this channel, with `address`, `candidate` and `gain`.
    """
    by_candidate: dict[str, dict[str, float]] = {}
    rows = zip(texts(results, "address"), texts(results, "candidate"), floats(results, "gain"), strict=True)
    for address, candidate, gain in rows:
        if candidate and np.isfinite(gain):
            by_candidate.setdefault(candidate, {})[address] = float(gain)
    most = max(map(len, by_candidate.values()), default=0)
    tried = {name: own for name, own in by_candidate.items() if len(own) >= max(LEAST, most / 2)}
    if not tried:
        return None
    p_values = holm([_p_value_of_mean_gain(list(own.values())) for own in tried.values()])
    gains = {name: float(np.mean(list(own.values()))) for name, own in tried.items()}
    best = max(gains, key=lambda name: gains[name])
    share, p_value = 1.0 - float(np.exp(-2.0 * gains[best])), p_values[list(tried).index(best)]
    if p_value > LEVEL or share < _LEAST_SHARE:
        return None
    alike = []
    for name, own in tried.items():
        ahead = [gain - own[address] for address, gain in tried[best].items() if address in own]
        if name != best and _p_value_of_mean_gain(ahead) > _LIKE:
            alike.append(name)
    values = list(tried[best].values())
    return CommonEffect(
        channel, best, len(values), sum(gain > 0.0 for gain in values), share, p_value, tuple(alike)
    )


def _p_value_of_mean_gain(gains: Sequence[float] | FloatArray) -> float:
    """Return the one-sided p-value of the hypothesis that the mean gain is not positive."""
    if len(gains) < 2 or not np.ptp(gains) > 0.0:
        return 0.0 if len(gains) > 1 and gains[0] > 0.0 else 1.0
    return float(ttest_1samp(gains, 0.0, alternative="greater").pvalue)
