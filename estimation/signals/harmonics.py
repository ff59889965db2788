"""Which waves over position an effort is made of."""

import numpy as np

from estimation.channel import ChannelData
from robot_io.types import FloatArray

_MOST_WAVES = 10
_LEAST_WAVES = 1.5  # within the range of motion; less of a wave could be any curve
_LEAST_SHARE = 0.01  # of what is left, that one more wave must explain
_BINS = 16384
_PER_BIN = 4  # bins that the shortest wave must have
_FINER = 8  # of the spacing of independent waves
_MOST_PARTS = 120  # of the strongest wave, of which all are multiples


def harmonics(data: ChannelData) -> tuple[float, tuple[int, ...]]:
    """The wave number n [1/position] and the multiples of it of which an effort is made.

    What simple motion explains is taken off first. Then the strongest wave is taken, all those found are
    fitted together, and so on, as long as a wave explains 1 % of what is left (orthogonal matching pursuit,
    Pati et al. 1993). Which waves a channel has is chosen on all its runs; how large they are is for the fit.

    Returns:
        n, and multiples in ascending order; (0, ()) where nothing ripples.
    """
    span = float(np.ptp(data.position))
    if span == 0.0:
        return 0.0, ()
    left, waves = _plain(data), list[float]()
    base = left
    while len(waves) < _MOST_WAVES:
        strongest = _strongest(data.position, left, span)
        after = _without(data.position, base, [*waves, strongest])
        if np.sum(after**2) > (1.0 - _LEAST_SHARE) * np.sum(left**2):
            break
        waves.append(strongest)
        left = after
    return _common(waves, 2.0 * np.pi / span)


def _plain(data: ChannelData) -> FloatArray:
    """What linear least squares by motion and direction leaves of the effort, shape (n,)."""
    q, v = data.position, data.velocity
    parts = [np.ones(len(q)), q, np.sin(q), np.cos(q), v, np.sign(v), data.acceleration]
    columns = np.column_stack(parts)
    columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    gains = np.linalg.lstsq(columns, data.effort, rcond=1e-9)[0]
    return np.asarray(data.effort - columns @ gains)


def _strongest(position: FloatArray, left: FloatArray, span: float) -> float:
    """Wave number of the largest peak of the spectrum over position."""
    place = ((position - position.min()) / span * (_BINS - 1)).astype(np.int64)
    count = np.bincount(place, minlength=_BINS)
    total = np.bincount(place, weights=left, minlength=_BINS)
    mean = np.where(count > 0, total / np.maximum(count, 1), 0.0)
    height = np.abs(np.fft.rfft(mean, _FINER * _BINS))
    waves = np.arange(len(height)) / _FINER * (_BINS - 1) / _BINS
    filled = min(int(np.count_nonzero(count)), _BINS)
    height[(waves < _LEAST_WAVES) | (waves > filled / _PER_BIN)] = 0.0
    return float(waves[np.argmax(height)] * 2.0 * np.pi / span)


def _without(position: FloatArray, signal: FloatArray, waves: list[float]) -> FloatArray:
    angle = np.multiply.outer(position, np.array(waves))
    columns = np.hstack([np.sin(angle), np.cos(angle)])
    return np.asarray(signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0])


def _common(waves: list[float], apart: float) -> tuple[float, tuple[int, ...]]:
    """The largest wave number of which all are multiples, within a third of what can be told apart."""
    if not waves:
        return 0.0, ()
    found = np.array(waves)
    for parts in range(1, _MOST_PARTS + 1):
        multiples = np.round(found * parts / found[0])
        if (np.abs(found - multiples * found[0] / parts) < apart / 3.0).all() and multiples.min() > 0:
            break
    return float(found[0] / parts), tuple(sorted({int(m) for m in multiples}))
