"""Fit a model to a channel without the project's own fit, to check that an effect recovers the truth."""

import numpy as np
from scipy.optimize import least_squares

from palpate.estimation.channel import ChannelData, ChannelKind
from palpate.estimation.effects import EFFECTS
from palpate.estimation.model import Model

ROUNDS = 4  # of the gains, where a sensor is not linear
KEPT = 2  # starts that are followed to their end


def channel(kind, time_s, position, effort, *, run=None, velocity=None, acceleration=None, **more):
    """A channel of arrays; derivatives by central differences within each run where not given."""
    run = np.zeros(len(time_s), dtype=np.int64) if run is None else run
    v = _slope(position, time_s, run) if velocity is None else velocity
    a = _slope(v, time_s, run) if acceleration is None else acceleration
    name = "contact" if kind is ChannelKind.CONTACT else "joint_1"
    return ChannelData(name, kind, time_s, position, v, a, effort, run, np.full(len(run), -1), **more)


def _slope(signal, time_s, run):
    slope = np.empty(len(signal))
    for number in np.unique(run):
        rows = run == number
        slope[rows] = np.gradient(signal[rows], time_s[rows])
    return slope


def recover(data, base, name):
    """Parameters of the base effects and one more, and the share of the effort's size that is left."""
    effect = EFFECTS[name]().suited_to(data)
    model = Model("m", (*(EFFECTS[other]().suited_to(data) for other in base), effect))
    size = np.sqrt(np.mean(data.effort**2))
    names = list(model.inner)

    def fitted(inner):
        gains = dict.fromkeys(model.gains, 0.0)
        for _ in range(1 if model.is_linear_in_gains else ROUNDS):
            slopes, effort = model.linearize(data, {**gains, **inner})
            lengths = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
            wanted = data.effort - effort + slopes @ np.array(list(gains.values()))
            found = np.linalg.lstsq(slopes / lengths, wanted, rcond=1e-12)[0] / lengths
            gains = dict(zip(gains, found.tolist(), strict=True))
        return {**gains, **inner}

    def residual(inner):
        return (data.effort - model.predict(data, fitted(inner))) / size

    others = {n: p.beginning for n, p in model.inner.items() if not n.startswith(f"{name}.")}
    starts = [{**others, **{f"{name}.{n}": v for n, v in start.items()}} for start in effect.starts(data)]
    starts = [dict(zip(names, (start[n] for n in names), strict=True)) for start in starts]
    best = sorted(starts, key=lambda start: float(np.sum(residual(start) ** 2)))[:KEPT]
    ends = [_follow(model, start, residual) for start in best]
    inner = min(ends, key=lambda end: float(np.sum(residual(end) ** 2)))
    return fitted(inner), float(np.sqrt(np.mean(residual(inner) ** 2)))


def _follow(model, start, residual):
    """Least squares over the inner parameters; in logarithms where they are searched by ratio."""
    by_log = [p.log and start[n] > 0 for n, p in model.inner.items()]
    if not by_log:
        return start

    def back(numbers):
        values = (np.exp(x) if log else x for x, log in zip(numbers, by_log, strict=True))
        return dict(zip(start, map(float, values), strict=True))

    def number(value, log):
        return np.log(max(value, 1e-300)) if log else value

    low, high, at = (
        np.array([number(v, log) for v, log in zip(values, by_log, strict=True)])
        for values in (
            [p.lower for p in model.inner.values()],
            [p.upper for p in model.inner.values()],
            start.values(),
        )
    )
    at = np.clip(at, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    scale = np.where(by_log, 1.0, np.maximum(np.abs(at), 1e-3 * (high - low)))
    found = least_squares(
        lambda numbers: residual(back(numbers)), at, bounds=(low, high), x_scale=scale, diff_step=1e-4
    )
    return back(found.x)
