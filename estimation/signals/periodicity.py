"""Find the strongest frequency of a signal that was sampled evenly in pieces."""

import numpy as np

from estimation.signals.blocks import blocks, number_pieces
from robot_io.types import FloatArray, IntArray

_SLOWEST = 3.0  # least periods within the longest piece
_FASTEST = 0.4  # most periods in a step
_FINENESS = 10  # frequencies per resolvable one
_SHORTEST, _LONGEST = 10, 16384  # steps in a piece; longer ones are split, to bound memory
_SHORT = 0.1  # of the longest piece; shorter pieces add work and little information
_AROUND = 20 * _FINENESS  # frequencies on either side that a peak is compared with
_Piece = tuple[FloatArray, FloatArray]  # number of samples at each step, and their sum


def strongest_frequency(
    time_s: FloatArray, run: IntArray, signal: FloatArray, step_s: float
) -> tuple[float, float, float] | None:
    """Find the peak of a Lomb-Scargle periodogram with an independent phase in each piece.

    A common phase would make side peaks, closer the farther the pieces are apart. In each piece the samples
    lie on an even grid, so that the sums are Fourier transforms: time and memory grow with the samples, not
    with samples times frequencies.

    Args:
        time_s: increasing within a run [s], shape (n,).
        run: of each sample, shape (n,).
        signal: shape (n,), NaN where it is unknown.
        step_s: time between neighbours [s].

    Returns:
        The frequency [Hz], its share of the variance within pieces, and that share over the median share of
        the frequencies around it; None where all pieces are too short.
    """
    pieces = _pieces(time_s, run, signal, step_s)
    longest = max((len(counts) for counts, _ in pieces), default=0)
    if longest < _SHORTEST:
        return None
    pieces = [piece for piece in pieces if len(piece[0]) >= _SHORT * longest]
    size = 1 << int(np.ceil(np.log2(_FINENESS * longest)))
    number = np.arange(int(np.ceil(_SLOWEST * size / longest)), int(_FASTEST * size))
    power = sum(float(values @ values) for _, values in pieces)
    if not len(number) or power == 0.0:
        return None
    explained = np.zeros(len(number))
    for piece in pieces:
        explained += _explained(piece, number, size)
    best = int(np.argmax(explained))
    around = explained[max(best - _AROUND, 0) : best + _AROUND + 1]
    share, usual = float(explained[best] / power), float(np.median(around) / power)
    return float(number[best] / (size * step_s)), share, share / max(usual, 1e-300)


def _pieces(time_s: FloatArray, run: IntArray, signal: FloatArray, step_s: float) -> list[_Piece]:
    """Gapless pieces from the first to the last known sample, each on its grid of steps."""
    known = np.isfinite(signal)
    pieces: list[_Piece] = []
    for rows in blocks(number_pieces(time_s, run)):
        for first in range(rows.start, rows.stop, _LONGEST):
            chosen = first + np.flatnonzero(known[first : min(first + _LONGEST, rows.stop)])
            if len(chosen):
                place = np.rint((time_s[chosen] - time_s[chosen[0]]) / step_s).astype(np.int64)
                values = signal[chosen] - signal[chosen].mean()
                sums = np.bincount(place, values).astype(np.float64)
                pieces.append((np.bincount(place).astype(np.float64), sums))
    return pieces


def _explained(piece: _Piece, number: IntArray, size: int) -> FloatArray:
    """Sum of squares that a sine of each frequency w explains, by least squares.

    With Y = sum y exp(-i w t) and W = sum exp(-2 i w t) over N samples it is
    2 (N |Y|^2 - Re(Y^2 W*)) / (N^2 - |W|^2): N. R. Lomb, Astrophysics and Space Science 39 (1976).
    """
    counts, values = piece
    count = float(counts.sum())
    swing, twice = np.fft.fft(values, size)[number], np.fft.fft(counts, size)[2 * number]
    own = count * np.abs(swing) ** 2 - (swing**2 * twice.conj()).real
    free = np.maximum(count**2 - np.abs(twice) ** 2, 1e-9 * count**2)
    return np.asarray(2.0 * own / free)
