"""What any smooth law could still explain: a wide, shrunken regression on all signals and their past.

It names nothing. It says how much of the error can be explained at all, and by which signals.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from estimation.fit.colour import WHITE
from estimation.fit.frame import Frame
from estimation.fit.moments import Moments, held_out_energy, score
from estimation.fit.smooth_signals import features
from estimation.fit.trial import Bench, Trial
from robot_io.types import BoolArray, FloatArray, IntArray

_RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1)
_MOST_SIGNALS = 4  # that are taken one by one
_WORTH = 0.005  # of the energy, that one more signal must take away


@dataclass(frozen=True)
class Flexible:
    """The flexible regression on top of a model."""

    held_out: FloatArray  # its squared whitened residuals by fold, shape (folds,)
    residual: FloatArray  # its held-out residuals, not whitened, one for each block, shape (m,)
    # Share of the error's energy that each signal alone can explain in held-out runs.
    by_signal: dict[str, float]


def signals_of(bench: Bench, trial: Trial) -> dict[str, FloatArray]:
    """Columns (m, k) by signal, as of a model that was tried."""
    frame = bench.frame
    return features(frame, frame.reduce(frame.data.effort) - trial.residual)


def flexible(bench: Bench, trial: Trial, without: Collection[str] = ()) -> Flexible:
    """Fit the flexible regression beside the model's own gains, and judge it on the folds held out.

    It does not know the signals named in `without`.
    """
    frame = bench.frame
    base, target = trial.columns, trial.target
    blocks = {name: block for name, block in signals_of(bench, trial).items() if name not in without}
    columns = np.column_stack([base, *blocks.values()])
    names = list(trial.model.gains)
    moments = bench.moments(columns, target, names)
    own = base.shape[1]
    owner = np.concatenate([[-1] * own, *([i] * b.shape[1] for i, b in enumerate(blocks.values()))])
    before = float(score(moments.only(owner < 0)).held_out.sum())
    alone = [_shrunken(moments, owner, (number,)) for number in range(len(blocks))]
    best = _best(moments, owner, alone, before)
    by_signal = {
        name: 1.0 - one.energy / before if before > 0.0 else 0.0
        for name, one in zip(blocks, alone, strict=True)
    }
    plain = moments if bench.colour is WHITE else Bench(frame, WHITE).moments(columns, target, names)
    residual = _held_out_residual(columns, target, frame, plain, best)
    return Flexible(best.held_out, residual, by_signal)


@dataclass(frozen=True)
class _Tried:
    """A regression on some signals."""

    signals: tuple[int, ...]  # their numbers
    kept: BoolArray  # columns that it has, shape (q,)
    ridge: FloatArray  # shrinkage of those columns
    held_out: FloatArray  # squared whitened residuals by fold, shape (folds,)

    @property
    def energy(self) -> float:
        return float(self.held_out.sum())


def _shrunken(moments: Moments, owner: IntArray, signals: tuple[int, ...]) -> _Tried:
    """The regression on these signals, with the shrinkage that serves best in the folds held out."""
    kept = (owner < 0) | np.isin(owner, signals)
    some, free = moments.only(kept), owner[kept] >= 0
    tried = np.where(free, np.array(_RIDGES)[:, None], 1e-9)
    energy = held_out_energy(some, tried)
    best = int(np.argmin(energy.sum(axis=1)))
    return _Tried(signals, kept, tried[best], energy[best])


def _best(moments: Moments, owner: IntArray, alone: list[_Tried], before: float) -> _Tried:
    """All signals, or only those that help: what time or load say in other runs may mislead in this one."""
    best = _shrunken(moments, owner, ())
    while len(best.signals) < _MOST_SIGNALS:
        more = [
            _shrunken(moments, owner, (*best.signals, n)) if best.signals else alone[n]
            for n in range(len(alone))
            if n not in best.signals
        ]
        found = min(more, key=lambda one: one.energy)
        if found.energy > best.energy - _WORTH * before:
            break
        best = found
    every = _shrunken(moments, owner, tuple(range(len(alone))))
    return min(best, every, key=lambda one: one.energy)


def _held_out_residual(
    columns: FloatArray, target: FloatArray, frame: Frame, plain: Moments, best: _Tried
) -> FloatArray:
    residual = np.empty_like(target)
    columns = columns[:, best.kept]
    width = np.sqrt(np.mean(columns**2, axis=0))
    width[width == 0.0] = 1.0
    scale = np.append(1.0 / width, 1.0)
    products = plain.only(best.kept).products * scale[:, None] * scale
    whole = products.sum(axis=0)
    for fold in range(frame.folds):
        test = frame.fold == fold
        mean = (whole - products[fold]) / np.sum(~test & frame.trusted)
        gains = np.linalg.solve(mean[:-1, :-1] + np.diag(best.ridge), mean[:-1, -1])
        residual[test] = target[test] - columns[test] @ (gains / width)
    return residual
