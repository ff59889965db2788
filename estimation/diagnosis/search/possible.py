"""Whether the parameters of a fitted model make physical sense."""

import numpy as np

from estimation.fit.trial import Bench, Trial
from estimation.effect import Effect
from estimation.signals.runwise import sample_time
from robot_io.types import BoolArray, FloatArray

LEAST_GAIN = 0.02  # of the held-out error; less is not worth a name, whatever its significance
FAR_END = 0.99  # of the upper bound of an inner parameter
LOOSE = 0.05  # of the effort, that a gain may be off its bounds before all parameters are fitted together


def is_possible(effect: Effect, trial: Trial, bench: Bench, loose: float = 0.0) -> bool:
    """Whether the effect's parameters make physical sense, and what makes it what it is is there.

    A gain that the effect could do without may be beyond its bounds by no more than makes the noise.

    Args:
        effect: part of the model.
        trial: of the model.
        bench: where.
        loose: effort, as a share of the whole, that a gain may be beyond its bounds.
    """
    effort = loose * float(np.sqrt(np.mean(trial.target**2)))
    noise = float(np.sqrt(np.mean(trial.residual**2)))
    spread = trial.spread
    for column, parameter in zip(_own_columns(effect, trial).T, effect.gains, strict=True):
        name = f"{effect.name}.{parameter.name}"
        value, slack = trial.parameters[name], 2.0 * spread[name]
        minor = bool(effect.essential) and parameter.name not in effect.essential
        slack += (effort + minor * noise) / max(float(np.sqrt(np.mean(column**2))), 1e-300)
        if not parameter.lower - slack <= value <= parameter.upper + slack:
            return False
    # what ended at the far end of a range that goes by ratio was not found
    if any(p.log and trial.parameters[f"{effect.name}.{p.name}"] > FAR_END * p.upper for p in effect.inner):
        return False
    # no time stamp is better than half a step
    half = 0.5 * sample_time(bench.frame.data.time_s, bench.frame.data.run)
    if any(abs(trial.parameters[f"{effect.name}.{p.name}"]) < half for p in effect.inner if p.unit == "s"):
        return False
    simpler = effect.simpler(_own_columns(effect, trial))
    if simpler.shape[1] == len(effect.gains):
        return True
    others = trial.columns[:, ~_is_own(effect, trial)]
    without = bench.fit(np.column_stack([others, simpler]), trial.target)
    return float(without.sse.sum()) - trial.sse >= LEAST_GAIN * trial.sse


def is_beyond_bounds(trial: Trial, noise: float = 0.0) -> bool:
    """Whether a gain of the model, its base included, is clearly outside its bounds: a spring that pulls.

    Args:
        trial: of the model.
        noise: effort that a gain may be beyond them for, where that is more than a share of the whole.
    """
    effort = max(noise, LOOSE * float(np.sqrt(np.mean(trial.target**2))))
    for (name, gain), column in zip(trial.model.gains.items(), trial.columns.T, strict=True):
        slack = 2.0 * trial.spread[name] + effort / max(float(np.sqrt(np.mean(column**2))), 1e-300)
        if not gain.lower - slack <= trial.parameters[name] <= gain.upper + slack:
            return True
    return False


def _is_own(effect: Effect, trial: Trial) -> BoolArray:
    return np.array([name.startswith(f"{effect.name}.") for name in trial.model.gains], dtype=np.bool_)


def _own_columns(effect: Effect, trial: Trial) -> FloatArray:
    return trial.columns[:, _is_own(effect, trial)]
