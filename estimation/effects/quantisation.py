"""The sensor has coarse steps."""

import numpy as np
import scipy

from estimation.channel import ChannelData, ChannelKind
from estimation.effect import Inner, Parameter, SensorEffect
from estimation.kinds import Kind
from robot_io.types import FloatArray

_EDGES = (0.5, 1.5)  # that are near enough for noise to reach, in steps
_FURTHEST = 8.5  # standard deviations that noise carries anything; beyond, it is less than rounding
_SMOOTH = 0.5  # noise in steps, from which on the treads are gone
_REACH, _TREAD = 0.2, 0.1  # in steps, about an edge where it is steep; slope elsewhere, so that none is free
_REPEATED = 0.5  # distinct readings of all
_SHARES = (0.01, 0.05, 0.2)  # of a step, of noise


class Quantisation(SensorEffect):
    """reading = step * round((effort + noise) / step), on the average over the noise ahead of the steps.

    Near an edge the noise decides which of two steps is shown; between edges it is not seen at all.
    """

    name = "quantisation"
    kind = Kind.SENSOR_STATICS
    physics = "The converter knows only whole steps."
    equation = "reading = step round((effort + noise)/step), expected"
    source = "B. Widrow, I. Kollár, Quantization Noise (2008)"
    signature = "readings take few values, with flat treads between jumps"
    signals = ("effort",)
    channels = frozenset(ChannelKind)
    inner = (
        Parameter("step", "{effort}", 1e-09, 10000.0, (0.001, 1.0), log=True),
        Parameter("noise", "{effort}", 1e-12, 10000.0, (0.0001, 0.1), log=True),
    )
    confused_with = {
        "deadband": "vary the effort slowly over several steps",
        "saturation": "vary the effort slowly over several steps",
    }
    linear = False

    def applies_to(self, data: ChannelData) -> bool:
        """See `Effect.applies_to`; where hardly a reading comes twice there are no steps to see."""
        return super().applies_to(data) and len(np.unique(data.effort)) < _REPEATED * len(data)

    def sense(self, effort: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        step = inner["step"]
        noise = min(inner["noise"] / step, _SMOOTH)
        steps = effort / step
        whole = np.round(steps)
        steps -= whole
        return np.asarray(step * (whole + _carried_over(steps, noise) - _carried_over(-steps, noise)))

    def starts(self, data: ChannelData) -> tuple[Inner, ...]:
        """See `Effect.starts`: the mean distance between neighbouring readings, and shares of it.

        A single distance would not do: readings that are rounded once more lie at uneven distances.
        """
        levels = np.unique(data.effort)
        if len(levels) < 2:
            return ({"step": 1.0, "noise": _SHARES[0]},)
        apart = np.diff(levels)
        count = np.sum(np.round(apart / np.median(apart)))
        step = max(float(np.ptp(levels) / max(count, 1.0)), 1e-9)
        return tuple({"step": step, "noise": share * step} for share in _SHARES)

    def slope(self, effort: FloatArray, columns: FloatArray, data: ChannelData, inner: Inner) -> FloatArray:
        """See `SensorEffect.slope`: steep about an edge, next to nothing on a tread, one on average.

        What is held on a tread says nothing of the effort, however long it lasts; only where edges are does.
        """
        reach = _REACH * inner["step"]
        ahead, behind = (self.sense(effort + side * reach, data, inner) for side in (1.0, -1.0))
        steepness = _TREAD + (1.0 - _TREAD) * (ahead - behind) / (2.0 * reach)
        return steepness[:, None] * columns


def _carried_over(part: FloatArray, noise: float) -> FloatArray:
    """Edges above `part` that noise carries it over, expected, same shape; both in steps."""
    over = np.zeros_like(part)
    for edge in _EDGES:
        near = part > edge - _FURTHEST * noise
        over[near] += scipy.special.ndtr((part[near] - edge) / noise)
    return over
