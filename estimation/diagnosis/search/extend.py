"""Adds an effect that was asked for, whatever is thought of it."""

from estimation.channel import ChannelData
from estimation.fit.standing import Standing, stand
from estimation.diagnosis.search.screening import try_all
from estimation.effect import Effect
from robot_io.types import BoolArray


def extend(data: ChannelData, standing: Standing, effect: Effect, good: BoolArray | None = None) -> Standing:
    """The model of `standing` with one more effect, fitted from where that did best.

    Also one that made no sense there is fitted from its best trial on: at inner parameters of zero, a speed
    or a time that effort is divided by, it would be nothing that can be fitted.

    Args:
        data: the channel, without a `load` that was derived.
        standing: the model so far.
        effect: in the form that suits the channel.
        good: samples that are fit for use, shape (n,); None for all.
    """
    best = try_all(standing, [effect])[0].search.best
    return stand(data, best.model, best.parameters, good)
