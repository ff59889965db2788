"""What any smooth law could still explain: a wide, shrunken regression on all signals and their past.

It names nothing. It says how much of the error can be explained at all, and by which signals.
"""

from dataclasses import dataclass

import numpy as np

from estimation.channel import ChannelKind
from estimation.diagnosis.frame import Frame
from estimation.diagnosis.moments import Moments, moments_of, score
from estimation.diagnosis.trial import Bench, Trial
from estimation.signals.runwise import low_pass, play, rate, running_max, sample_time
from robot_io.types import BoolArray, FloatArray, IntArray

_KNOTS = 9
_WAVES = 24
_MEMORIES_S = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
_TURNS = (0.01, 0.04, 0.15)  # paths over which a reversal is remembered, as shares of the range
_CONTEXT = frozenset({"joint_position", "joint_velocity", "load"})
_RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1)


@dataclass(frozen=True)
class Flexible:
    """The flexible regression on top of a model.

    Attributes:
        held_out: its squared whitened residuals by fold, shape (folds,).
        residual: its held-out residuals, not whitened, one for each block, shape (m,).
        by_signal: share of the error's energy that each signal alone can explain in held-out runs.
    """

    held_out: FloatArray
    residual: FloatArray
    by_signal: dict[str, float]


def features(frame: Frame, effort: FloatArray) -> dict[str, FloatArray]:
    """Columns (m, k) by the signal that they are functions of.

    Args:
        frame: the channel on its blocks.
        effort: what the model expects, on blocks, shape (m,).
    """
    data, run = frame.data, frame.run
    x, time_s, on = (frame.reduce(s) for s in (data.position, data.time_s, data.engaged.astype(np.float64)))
    v, a, pressed = (
        frame.reduce(s * data.engaged) for s in (data.velocity, data.acceleration, data.position)
    )
    turn = np.tanh(v / (0.02 * _rms(v)))
    past = [pressed - low_pass(pressed, time_s, run, tau) for tau in _MEMORIES_S]
    slope = rate(effort, time_s, run)
    slow = low_pass(effort, time_s, run, 3.0 * sample_time(time_s, run))
    hats_x, hats_e = _hats(x), _hats(effort)
    turns = [_memory(pressed, run, share) for share in _TURNS]
    found = {
        "offset": np.ones((len(x), 1)),
        "time": np.column_stack([time_s - time_s[0], (time_s - time_s[0]) ** 2]),
        "position": np.hstack([hats_x, on[:, None], _hats(running_max(x, run)), *_waves(frame, x)]),
        "velocity": np.column_stack([_hats(v), v[:, None] * hats_x]),
        "direction": np.column_stack([turn, turn[:, None] * hats_x, turn[:, None] * hats_e]),
        "acceleration": _hats(a),
        "past motion": np.column_stack(
            [*past, *(p * np.abs(p) for p in past), *turns, *(np.abs(t) * s for t in turns for s in (x, a))]
        ),
        "effort": np.column_stack(
            [
                hats_e,
                slope,
                effort - slow,
                np.tanh(slope / (0.1 * _rms(slope))),
                *(_memory(effort, run, share) for share in _TURNS),
            ]
        ),
    }
    for name in _CONTEXT & data.context.keys():
        columns = frame.reduce(data.context[name]).reshape(len(x), -1)
        found[name.replace("_", " ")] = np.hstack([_hats(column) for column in columns.T])
    return found


def signals_of(bench: Bench, trial: Trial) -> dict[str, FloatArray]:
    """Columns (m, k) by signal, as of a model that was tried."""
    frame = bench.frame
    return features(frame, frame.reduce(frame.data.effort) - trial.residual)


def flexible(bench: Bench, trial: Trial) -> Flexible:
    """Fit the flexible regression beside the model's own gains, and judge it on the folds held out."""
    frame = bench.frame
    base, target = trial.columns, trial.target
    blocks = signals_of(bench, trial)
    white = bench.whiten(np.column_stack([base, *blocks.values(), target]))
    moments = moments_of(white[:, :-1], white[:, -1], frame.fold[bench.kept], frame.folds)
    own = base.shape[1]
    owner = np.concatenate([[-1] * own, *([i] * b.shape[1] for i, b in enumerate(blocks.values()))])
    ridge, held_out = _best_ridge(moments, owner >= 0)
    before = score(moments.only(owner < 0)).held_out.sum()
    by_signal = {}
    for number, name in enumerate(blocks):
        kept = (owner < 0) | (owner == number)
        alone = _best_ridge(moments.only(kept), owner[kept] >= 0)[1].sum()
        by_signal[name] = float(1.0 - alone / before) if before > 0.0 else 0.0
    residual = _held_out_residual(np.column_stack([base, *blocks.values()]), target, frame, ridge)
    return Flexible(held_out, residual, by_signal)


def _best_ridge(moments: Moments, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    tried = [
        (np.where(free, ridge, 1e-9), score(moments, np.where(free, ridge, 1e-9)).held_out)
        for ridge in _RIDGES
    ]
    return min(tried, key=lambda pair: float(pair[1].sum()))


def _held_out_residual(
    columns: FloatArray, target: FloatArray, frame: Frame, ridge: FloatArray
) -> FloatArray:
    residual = np.empty_like(target)
    width = np.sqrt(np.mean(columns**2, axis=0))
    scaled = columns / np.where(width > 0.0, width, 1.0)
    for fold in range(frame.folds):
        test = frame.fold == fold
        train = ~test & frame.trusted
        system = scaled[train].T @ scaled[train] / train.sum() + np.diag(ridge)
        gains = np.linalg.solve(system, scaled[train].T @ target[train] / train.sum())
        residual[test] = target[test] - scaled[test] @ gains
    return residual


def _memory(signal: FloatArray, run: IntArray, share: float) -> FloatArray:
    """Direction of the last reversal of a signal, in [-1, 1], over a path that is a share of its range."""
    half = share * (float(np.ptp(signal)) or 1.0)
    return (signal - play(signal, run, half)) / half


def _hats(signal: FloatArray) -> FloatArray:
    """Piecewise linear bumps with knots at quantiles, without the one at zero: a constant is not theirs."""
    knots = np.unique(np.quantile(signal, np.linspace(0.0, 1.0, _KNOTS)))
    if len(knots) < 3:
        return signal[:, None]
    place = np.interp(signal, knots, np.arange(len(knots)))
    hats = np.maximum(1.0 - np.abs(place[:, None] - np.arange(len(knots))), 0.0)
    return np.delete(hats, int(np.argmin(np.abs(knots))), axis=1)


def _waves(frame: Frame, position: FloatArray) -> list[FloatArray]:
    """Waves over the range of a joint's position, shape (m, 2 waves); none for a contact."""
    if frame.data.kind is ChannelKind.CONTACT:
        return []
    span = float(np.ptp(position)) or 1.0
    angle = 2.0 * np.pi * (position / span)[:, None] * np.arange(1, _WAVES + 1)
    return [np.sin(angle), np.cos(angle)]


def _rms(signal: FloatArray) -> float:
    return float(np.sqrt(np.mean(signal**2))) or 1.0
